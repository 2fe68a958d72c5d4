"""Answers at which decisions have not moved: maxima, saddles, flat starts, and models without derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from zoo import algebraic

pytestmark = pytest.mark.filterwarnings("ignore")

RESPONSES = {
    "maximum": lambda a, b, size: (a**2 - 0.25) ** 2,
    "falling": lambda a, b, size: -(a**2),
    "cosine": lambda a, b, size: jnp.cos(a),
    "symmetric": lambda a, b, size: (a - 1.0) ** 2 + (b**2 - 1.0) ** 2,
    "dead": lambda a, b, size: 1.0 - jnp.maximum(0.0, a - 0.4),
    "minimum": lambda a, b, size: (a - 0.25) ** 2,
    "round": lambda a, b, size: (jnp.round(a) - 7.0) ** 2,
    "stopped": lambda a, b, size: (jax.lax.stop_gradient(a) - 7.0) ** 2,
    "far": lambda a, b, size: (a / size - 3.0) ** 2,
    "product": lambda a, b, size: a * b + a**4 + b**4,
    "alike": lambda a, b, size: (a - b) ** 4 - (a - b) ** 2 + (a + b - 1.0) ** 2,
}
LIMITED = {
    "a": lambda a, size: a,
    "far": lambda a, size: a / size,
    "clip": lambda a, size: jnp.clip(a, 0.0, 1.0),
    "over": lambda a, size: jnp.maximum(a - 1.5, 0.0),
    "fixed": lambda a, size: 2.0 + 0.0 * a,
}


@algebraic
def choice(a, b, response, limit, size):
    """A response of two numbers, and a function that is limited, each the sum of those with a weight: which is data."""
    y = sum(w * one(a, b, size) for w, one in zip(response, RESPONSES.values(), strict=True))
    return {"y": y, "limit": sum(w * one(a, size) for w, one in zip(limit, LIMITED.values(), strict=True))}


def weights(names, name):
    return [float(one == name) for one in names]


def answer(kind, a, b=(0.0, -2.0, 2.0), limit=None, lower=-1e9, upper=1e9, size=1.0, **options):
    model = choice(al.Decision(*a), al.Decision(*b), weights(RESPONSES, kind), weights(LIMITED, limit), size)
    limits = [al.Constraint(al.output("limit").mean, lower=lower, upper=upper, name="limit")] if limit else []
    return al.solve(al.Problem(model, minimize=al.output("y").mean, subject_to=limits), **options)


def test_a_start_at_a_maximum_is_left():
    for kind, most, best in (("maximum", 2.0, 0.0), ("cosine", 3.0, np.cos(3.0))):
        solution = answer(kind, (0.0, -most, most))
        assert solution.ok
        assert solution.objective == pytest.approx(best, abs=1e-6)


def test_a_start_at_a_bound_on_a_line_of_symmetry_or_where_the_model_is_flat_is_left():
    assert answer("falling", (0.0, 0.0, 1.0)).objective == pytest.approx(-1.0)
    assert answer("dead", (0.0, -1.0, 1.0)).objective == pytest.approx(0.4)
    solution = answer("symmetric", (0.3, -2.0, 2.0))
    assert solution.objective == pytest.approx(0.0, abs=1e-8)
    assert abs(solution.decisions["b"]) == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize("start", [0.0, 1.0])
def test_a_symmetry_of_two_decisions_is_left_whether_they_have_moved_or_not(start):
    # Along a = b both have a minimum where across it they have a maximum.
    assert answer("product", (start, -2.0, 2.0), b=(start, -2.0, 2.0)).objective == pytest.approx(-0.125, rel=1e-8)
    assert answer("alike", (start, -2.0, 2.0), b=(start, -2.0, 2.0)).objective == pytest.approx(-0.25, rel=1e-8)


def test_a_start_at_the_minimum_stays_there_and_a_decision_that_nothing_depends_on_is_named():
    solution = answer("minimum", (0.25, -1.0, 1.0), b=(0.3, 0.0, 1.0))
    assert solution.decisions["a"] == 0.25
    assert solution.idle == ("b",)


@pytest.mark.parametrize("kind", ["round", "stopped"])
def test_a_decision_whose_derivative_was_lost_is_refused_by_name(kind):
    with pytest.raises(al.ProblemError, match=r"changes with 'a', but all its derivatives tried are zero"):
        answer(kind, (2.0, 0.0, 10.0))


def test_a_decision_that_has_to_grow_by_orders_of_magnitude_is_no_proof_that_nothing_is_feasible():
    size = 1e8
    solution = answer("far", (0.0,), limit="far", upper=2.0, size=size)
    assert solution.decisions["a"] == pytest.approx(2 * size, rel=1e-5)


def test_a_start_where_a_constraint_saturates_is_no_proof_that_nothing_is_feasible():
    solution = answer("far", (8.0, 0.0, 10.0), limit="clip", upper=0.5)
    assert solution.decisions["a"] == pytest.approx(0.5, rel=1e-5)


def test_a_constraint_that_is_flat_at_the_start_alone_is_not_refused():
    # The solver may not find the way there, but it is not told that there is none.
    solution = answer("minimum", (0.5, 0.0, 4.0), limit="over", lower=0.2, start={"a": 2.0})
    assert solution.decisions["a"] == pytest.approx(1.7)
    with pytest.raises(al.ProblemError, match="whatever the decisions are"):
        answer("minimum", (0.5, 0.0, 4.0), limit="fixed", upper=1.0)


class Shifted(al.AlgebraicSystem):
    """A number that a decision shifts."""

    number: al.Number
    shift: al.Number

    def outputs(self):
        return {"sum": self.number + self.shift, "square": self.shift**2}


def test_a_probability_that_is_zero_at_the_start_is_no_proof_that_nothing_is_feasible():
    """Nine tenths of the numbers between 0.1 and 0.3 are above 0.12."""
    problem = al.Problem(
        Shifted(al.Uniform(0.2, half_width=0.1), al.Decision(0.2)),
        minimize=al.output("square").mean,
        subject_to=[al.output("sum").probability(above=1.0) >= 0.9],
    )
    assert al.solve(problem).decisions["shift"] == pytest.approx(0.88, rel=1e-6)
