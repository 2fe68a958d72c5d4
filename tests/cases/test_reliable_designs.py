"""The short column (Kuschel and Rackwitz 1997; Dakota, dakota_rbdo_short_column)."""

import pytest

import aleator as al
from zoo import algebraic

pytestmark = pytest.mark.slow


@algebraic
def section(b, h, strength, loads):
    """A rectangular section of some yield stress under a moment and a normal force."""
    bending = 4 * loads["M"] / (b * h**2 * strength)
    return {"g": 1 - bending - (loads["P"] / (b * h * strength)) ** 2, "area": b * h}


def column(b, h):
    loads = al.correlated({"P": al.Normal(500.0, 100.0), "M": al.Normal(2000.0, 400.0)}, {("P", "M"): 0.5})
    return section(b, h, al.LogNormal(mean=5.0, std=0.5), loads)


def margin(column):
    return column.outputs()["g"]


def test_the_lightest_column_that_fails_as_seldom_as_wanted():
    # Exact by Gauss-Hermite over the loads, given which the probability is that of one lognormal number.
    wanted = 0.0062096653
    problem = al.Problem(
        column(al.Decision(5.0, 5.0, 15.0), al.Decision(15.0, 15.0, 25.0)),
        minimize=al.output("area").mean,
        subject_to=[al.output("g").probability(below=0.0) <= wanted],
    )
    solution = al.solve(problem)
    assert solution.objective == pytest.approx(216.20456, rel=3e-3)
    assert solution.at_bounds == ("h",)
    sample = al.references.monte_carlo(margin, column(solution.decisions["b"], solution.decisions["h"]), 10**6)
    found = sample.probability(below=0.0)
    assert abs(found.value - wanted) < 3 * found.standard_error
