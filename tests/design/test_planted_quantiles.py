"""Limits that hold with a probability bound the quantile of their own tail."""

import pytest

import aleator as al
from aleator.statistics import Quantile

X = al.terminal("x")


@pytest.mark.parametrize(
    ("limit", "level"), [(X.at_most(2.0, probability=0.99), 0.99), (X.at_least(-2.0, probability=0.99), 0.01)]
)
def test_a_limit_with_a_probability_is_one_on_the_quantile_that_so_many_systems_keep_to(limit, level):
    (atom,) = limit.expression.atoms
    assert isinstance(atom.kind, Quantile)
    assert atom.kind.level == pytest.approx(level)
    assert limit.expression.factors == (1.0,)
    assert (limit.lower, limit.upper) == ((-float("inf"), 2.0) if level > 0.5 else (-2.0, float("inf")))
