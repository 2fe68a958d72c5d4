"""Limits on probabilities, which are 0 or 1 far from their bound, from any start, against closed forms."""

import pytest
from scipy import stats

import aleator as al
from zoo import algebraic

LEVEL = 0.01
# Bolts that hold 16 each, and are to hold 4 more than a load of mean 100 and standard deviation 5.
SCORE = stats.norm.ppf(1 - LEVEL)
EXACT = (104 + 5 * SCORE) / 16
SLOPE = -5 / 16 / stats.norm.pdf(SCORE)  # of the count by the level

RESERVE = al.output("reserve")
LIMITS = {
    "below": (RESERVE.probability(below=4.0) <= LEVEL, -SLOPE),
    "above": (RESERVE.probability(above=4.0) >= 1 - LEVEL, SLOPE),
    "its complement": (1 - 2 * RESERVE.probability(below=4.0) >= 1 - 2 * LEVEL, SLOPE / 2),
}


@algebraic
def joint(bolts, load):
    return {"reserve": 16 * bolts - load}


def solved(bolts, limit):
    model = joint(bolts, al.Normal(100.0, 5.0))
    return al.solve(al.Problem(model, minimize=al.value("bolts"), subject_to=[limit]))


@pytest.mark.parametrize("start", [3.0, 7.0, 20.0])
@pytest.mark.parametrize("written", LIMITS)
def test_the_least_size_that_keeps_a_limit_on_a_probability(written, start):
    limit, price = LIMITS[written]
    solution = solved(al.Decision(start, 2.0, 40.0), limit)
    (result,) = solution.constraints
    assert solution.decisions["bolts"] == pytest.approx(EXACT, rel=1e-6)
    assert result.holds
    assert result.text == str(limit)
    assert float(result.multipliers.sum()) == pytest.approx(price, rel=1e-5)
    assert solution.statistics[limit.expression.atoms[0].text()] == (
        pytest.approx(1 - LEVEL if written == "above" else LEVEL, rel=1e-6)
    )


@pytest.mark.parametrize("start", [3, 20, 38])
def test_the_fewest_whole_numbers_that_keep_a_limit_on_a_probability(start):
    solution = solved(al.Integer(start, 2, 40), LIMITS["below"][0])
    assert solution.decisions["bolts"] == 8.0
    assert solution.constraints[0].values == pytest.approx(stats.norm.sf((16 * 8 - 104) / 5), rel=1e-5)


def test_a_limit_on_a_probability_that_nothing_meets_is_named():
    limit = LIMITS["below"][0].named("holds")
    with pytest.raises(al.SolveError, match="infeasible"):
        solved(al.Decision(3.0, 2.0, 6.0), limit)
    problem = al.Problem(
        joint(al.Decision(3.0, 2.0, 6.0), al.Normal(100.0, 5.0)), minimize=al.value("bolts"), subject_to=[limit]
    )
    conflict = al.conflict(problem)
    assert conflict.names == ("holds",)
    # The quantile's threshold would have to fall to what 6 bolts reach.
    assert conflict.limits[0].relaxed == pytest.approx(16 * (EXACT - 6), rel=1e-5)
