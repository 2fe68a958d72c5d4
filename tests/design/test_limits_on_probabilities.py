"""Limits on probabilities, which are 0 or 1 far from their bound, from any start, against closed forms."""

import pytest
from scipy import optimize, stats

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


# The mean `d` of a normal number, with no more than a tenth of all systems beyond a limit.
Y, Z = al.output("y"), al.output("z")
BEYOND = Y.probability(above=2.0)
NINE_TENTHS = stats.norm.ppf(0.9)


@algebraic
def shifted(d, x, spread):
    return {"y": d + spread * x, "z": 2 * d - spread * x}


def largest(limit, start, spread=1.0):
    model = shifted(al.Decision(start, -100.0, 100.0), al.Normal(0.0, 1.0), spread)
    return al.solve(al.Problem(model, minimize=-al.value("d"), subject_to=[limit]), throw=False)


@pytest.mark.parametrize("start", [-60.0, 0.0, 60.0])
@pytest.mark.parametrize(
    ("limit", "exact"),
    [
        (BEYOND**2 <= 0.01, 2 - NINE_TENTHS),
        (BEYOND.equals(0.1), 2 - NINE_TENTHS),
        (al.expressions.maximum(BEYOND, Y.probability(below=-2.0)) <= 0.1, 2 - NINE_TENTHS),
        (
            BEYOND + Z.probability(above=3.0) <= 0.1,
            optimize.brentq(lambda d: stats.norm.sf(2 - d) + stats.norm.sf(3 - 2 * d) - 0.1, -3, 3),
        ),
    ],
    ids=["squared", "equal", "the larger of two", "summed"],
)
def test_probabilities_in_any_expression_are_limited_from_any_start(limit, exact, start):
    assert float(largest(limit, start).decisions["d"]) == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("start", [-30.0, 0.0, 60.0])
@pytest.mark.parametrize("spread", [0.05, 0.3])
def test_a_probability_between_two_thresholds_is_limited_from_any_start(spread, start):
    solution = largest(Y.probability(above=-1.5, below=1.5) >= 0.9, start, spread)
    assert solution.ok
    assert float(solution.decisions["d"]) == pytest.approx(1.5 - spread * NINE_TENTHS, rel=1e-6)


@pytest.mark.parametrize("limit", [BEYOND <= 1.0, 1 - BEYOND >= 0.0, Y.probability(below=2.0) >= 0.0])
def test_a_limit_that_each_probability_keeps_excludes_nothing(limit):
    solution = largest(limit, 0.0)
    assert float(solution.decisions["d"]) == pytest.approx(100.0)
    assert solution.constraints[0].text == str(limit)
