"""Decisions: their validation and their place in the decision vector."""

import jax.numpy as jnp
import numpy as np
import pytest

from aleator._core.errors import ProblemError
from aleator.uncertainty import Decision, placements


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Decision(1.0, lower=2.0, upper=0.0), "lower bound must not exceed.*lower=2.0, upper=0.0"),
        (lambda: Decision(3.0, 0.0, 2.0), r"between its bounds \[0.0, 2.0\]; received 3.0"),
        (lambda: Decision(-1.0, 0.0, 2.0), r"between its bounds \[0.0, 2.0\]; received -1.0"),
        (lambda: Decision(float("nan")), "finite value; received nan"),
        (lambda: Decision(float("inf")), "finite value; received inf"),
        (lambda: Decision(None), "expected numbers.*received None"),
        (lambda: Decision(1.0, lower=float("nan")), "received lower=nan"),
        (lambda: Decision(1.0, upper=float("nan")), "upper=nan"),
        (lambda: Decision(1.0, lower=float("inf")), "between its bounds|lower bound"),
        (lambda: Decision(np.ones(3), lower=np.zeros(2)), r"shape \(3,\); received \(2,\)"),
        (lambda: Decision(1.0, upper=np.ones(2)), r"shape \(\); received \(2,\)"),
        (lambda: Decision(np.ones((2, 3)), upper=np.ones(3)), r"shape \(2, 3\); received \(3,\)"),
        (lambda: Decision(np.array([1.0, 5.0]), 0.0, 2.0), "between its bounds"),
        (lambda: Decision(np.array([1.0, np.nan])), "finite"),
        (lambda: Decision(np.ones(2), lower=np.array([0.0, 3.0]), upper=2.0), "lower bound must not exceed"),
        (lambda: Decision("fast"), "expected numbers.*received 'fast'"),
        (lambda: Decision([[1.0], [1.0, 2.0]]), "expected numbers"),
        (lambda: Decision(1.0, {}), "expected numbers"),
    ],
)
def test_a_decision_that_makes_no_sense_is_refused_with_what_was_received(make, message):
    with pytest.raises(ProblemError, match=message):
        make()


def test_a_decision_may_start_on_its_bound_and_be_fixed_by_equal_bounds():
    assert Decision(2.0, 2.0, 2.0).lower == 2.0


def test_a_decision_is_unbounded_unless_told():
    assert (Decision(2).lower, Decision(2).upper) == (-np.inf, np.inf)


def test_bounds_of_an_array_may_be_one_for_all_or_one_each():
    places = placements({"x": Decision(np.array([1.0, 2.0]), lower=0.0, upper=np.array([3.0, 4.0]))})
    assert places.vector("lower").tolist() == [0.0, 0.0]
    assert places.vector("upper").tolist() == [3.0, 4.0]


def test_changing_the_array_it_was_made_from_does_not_change_a_decision():
    start = np.array([1.0, 2.0])
    decision = Decision(start, lower=start - 1)
    start[:] = 100.0
    assert decision.initial.tolist() == [1.0, 2.0]
    assert decision.lower.tolist() == [0.0, 1.0]


def test_array_decisions_fill_the_vector_and_are_named_entry_by_entry():
    places = placements({"a": Decision(7.0), "b": Decision(np.arange(6.0).reshape(2, 3)), "c": Decision(jnp.ones(1))})
    assert places.size == 8
    assert places.vector("initial").tolist() == [7, 0, 1, 2, 3, 4, 5, 1]
    assert places.entry_names() == ("a", "b[0]", "b[1]", "b[2]", "b[3]", "b[4]", "b[5]", "c[0]")
    named = places.named(np.arange(10.0, 18.0))
    assert named["a"] == 10.0
    assert named["b"].tolist() == [[11, 12, 13], [14, 15, 16]]
    assert named["c"].tolist() == [17]


def test_a_model_without_decisions_has_an_empty_vector():
    assert placements({"a": 1.0}).vector("initial").shape == (0,)
