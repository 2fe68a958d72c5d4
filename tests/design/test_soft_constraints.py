"""Constraints as penalties: closed forms of their optima, and the hard optima that they tend to."""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from zoo import HALF_WIDTH, LOSS, ONE_STEP, RESPONSE, SPREAD, Gain, bar_problem, optimum

LIMIT, WEIGHT = 2.0, 4.0


class Apart(al.AlgebraicSystem):
    """Several gains that should all be 3, each with a response of its own to the same number."""

    gains: al.Number
    theta: al.Number

    def outputs(self):
        responses = {f"r{i}": gain * self.theta for i, gain in enumerate(self.gains)}
        return {**responses, "loss": jnp.sum((self.gains - 3) ** 2)}


def apart(*limits, own=None):
    """One gain for each limit: a function of the response, as it stands or several."""
    model = Apart(al.Decision(np.ones(len(limits)), 0.01, 10.0), al.Uniform(1.0, half_width=HALF_WIDTH))
    given = [limit(al.output(f"r{i}")) for i, limit in enumerate(limits)]
    return al.Problem(model, minimize=al.output("loss").mean, subject_to=given, decisions=own)


def problem(*limits, grid=ONE_STEP):
    """Choose a gain close to 3, the mean of the response to `theta` around 1, subject to limits."""
    model = Gain(al.Decision(1.0, 0.01, 10.0), al.Uniform(1.0, half_width=HALF_WIDTH))
    return al.Problem(model, grid=grid, minimize=LOSS.mean, subject_to=limits)


def pulled(weight, slope=1.0, limit=LIMIT):
    """The gain that is least by `(g - 3)² + w (slope g - limit)²`."""
    return (3 + weight * slope * limit) / (1 + weight * slope**2)


def test_optima_under_every_kind_of_limit_are_those_of_closed_forms():
    softened = al.soft(
        apart(
            lambda r: r.mean <= LIMIT,
            lambda r: r.mean >= 4.0,
            lambda r: r.at_most(LIMIT, sigmas=2),
            lambda r: r.mean.equals(LIMIT),
            lambda r: al.Constraint(r.mean, lower=1.0, upper=LIMIT),
            lambda r: r.within(1.0, LIMIT),
            lambda r: r.at_most(LIMIT, probability=0.9),
            lambda r: r.mean <= 5.0,
        ),
        weight=WEIGHT,
    )
    assert not softened.constraints
    mean = pulled(WEIGHT)
    expected = [mean, pulled(WEIGHT, limit=4.0), pulled(WEIGHT, slope=1 + 2 * SPREAD), mean, mean, mean]
    expected += [pulled(WEIGHT, slope=1 + 0.8 * HALF_WIDTH), 3.0]
    np.testing.assert_allclose(optimum(softened).decisions["gains"], expected, rtol=1e-5)


@pytest.mark.parametrize("weight", [100.0, 1.0])
def test_exact_penalties_above_the_price_of_a_limit_are_the_limit(weight):
    """`(g - 3)² + w (s g - l)₊`: below its price a limit moves the gain by `s w / 2` towards it, and no further."""
    found = optimum(
        al.soft(
            apart(
                lambda r: r.mean <= LIMIT,
                lambda r: r.mean >= 4.0,
                lambda r: r.mean.equals(LIMIT),
                lambda r: r.at_most(LIMIT, worst_case=True),
                lambda r: r.mean <= 5.0,
            ),
            weight=weight,
            exact=True,
        )
    )
    slopes, ends = np.array([1, -1, 1, 1 + HALF_WIDTH, 0]), np.array([LIMIT, 4.0, LIMIT, LIMIT / (1 + HALF_WIDTH), 3])
    moved = np.where(slopes > 0, np.maximum(3 - slopes * weight / 2, ends), np.minimum(3 - slopes * weight / 2, ends))
    np.testing.assert_allclose(found.decisions["gains"], moved, rtol=1e-5)
    assert found.decisions["r0.excess"] == pytest.approx(moved[0] - LIMIT, abs=1e-5)
    assert found.decisions["r1.excess"] == pytest.approx(4.0 - moved[1], abs=1e-5)


def test_a_limit_at_every_instant_is_integrated_over_time():
    limit = al.path("response").at_most(LIMIT, sigmas=2)
    hard, slope = problem(limit, grid=al.Grid(2.5, 4)), 1 + 2 * SPREAD
    found = optimum(al.soft(hard, "response", weight=WEIGHT))
    assert found.decisions["gain"] == pytest.approx(pulled(2.5 * WEIGHT, slope), rel=1e-6)


def test_soft_limits_tend_to_hard_ones_in_inverse_proportion_to_the_weight():
    """Equation (101) beside (95)."""
    hard, weights = bar_problem(), np.array([1e4, 1e5, 1e6])
    width = optimum(hard).decisions["width"]
    missed = [width - optimum(al.soft(hard, weight=weight)).decisions["width"] for weight in weights]
    assert min(missed) > 0
    np.testing.assert_allclose(np.diff(np.log(missed)) / np.diff(np.log(weights)), -1.0, atol=0.01)


def test_a_decision_of_ones_own_joins_two_limits_to_the_least_largest_value():
    # max(|g - 1|, |g - 4|) is least at 2.5, where it is 1.5.
    level, own = al.value("level"), {"level": al.Decision(1.0, 0.0)}
    ends = apart(lambda r: [[r.mean - level <= end, r.mean + level >= end] for end in (1.0, 4.0)], own=own)
    found = optimum(al.Problem(ends.system, minimize=level, subject_to=ends.constraints, decisions=own))
    assert found.objective == pytest.approx(1.5, rel=1e-6)
    assert found.decisions["gains"] == pytest.approx([2.5], rel=1e-6)


EXACTLY = {"weight": 1.0, "exact": True}
LOW = (RESPONSE.mean <= LIMIT).named("low")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: al.soft(problem(RESPONSE.at_most(1.0, worst_case=True)), weight=1.0), "can only be limited"),
        (lambda: al.soft(al.soft(problem(LOW), **EXACTLY), **EXACTLY), r"no number called 'low\.excess' yet.*soft onc"),
    ],
)
def test_what_cannot_be_softened_is_refused(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()
