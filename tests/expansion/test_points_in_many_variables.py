"""The default points in many variables: where columns of large prime bases would depend on each other."""

import math

import pytest

import aleator as al
from zoo import cases

DISTRIBUTIONS = {"uniform": al.Uniform.bounds(1.0, 3.0), "normal": al.Normal(2.0, 0.5)}
STDS = {"uniform": 1 / math.sqrt(3), "normal": 0.5}


@pytest.mark.parametrize(
    ("kind", "variables", "order"),
    cases([("normal", 12, 2), ("uniform", 100, 1), ("uniform", 9, 2), ("normal", 30, 1)], 2),
)
def test_a_linear_function_of_many_variables_is_expanded_to_rounding_at_a_small_condition_number(
    kind, variables, order
):
    model = {f"x{i}": DISTRIBUTIONS[kind] for i in range(variables)}
    expanded = al.expand(lambda at: sum(at.values()), model, al.Expansion(order))
    assert float(expanded.mean) == pytest.approx(2.0 * variables, rel=1e-12)
    assert float(expanded.std) == pytest.approx(STDS[kind] * math.sqrt(variables), rel=1e-12)
    assert float(expanded.collocation.condition_number) < 6.0
