"""Constraints as penalties: closed forms of their optima, and the hard optima that they tend to."""

from typing import ClassVar

import numpy as np
import pytest
from scipy.optimize import brentq

import aleator as al
from tiny_models import HALF_WIDTH, LOSS, ONE_STEP, RESPONSE, SPREAD, Gain, gain_problem

WAYS = {"shooting": al.Sequential(), "collocation": al.Simultaneous(al.schemes.GaussLegendre(1))}
LIMIT, WEIGHT = 2.0, 4.0


def problem(*limits, theta=None, grid=ONE_STEP):
    """Choose a gain close to 3, the mean of the response to `theta` around 1, subject to limits."""
    theta = al.Uniform(1.0, half_width=HALF_WIDTH) if theta is None else theta
    return al.Problem(Gain(al.Decision(1.0, 0.01, 10.0), theta), grid=grid, minimize=LOSS.mean, subject_to=limits)


def pulled(weight, slope=1.0, limit=LIMIT):
    """The gain that is least by `(g - 3)² + w (slope g - limit)²`."""
    return (3 + weight * slope * limit) / (1 + weight * slope**2)


PULLED = {
    "an upper limit": (RESPONSE.mean <= LIMIT, pulled(WEIGHT)),
    "a lower limit": (RESPONSE.mean >= 4.0, pulled(WEIGHT, limit=4.0)),
    "a limit with a spread": (RESPONSE.at_most(LIMIT, sigmas=2), pulled(WEIGHT, slope=1 + 2 * SPREAD)),
    "an equality": (RESPONSE.mean.equals(LIMIT), pulled(WEIGHT)),
    "both sides of a range": (al.Constraint(RESPONSE.mean, lower=1.0, upper=LIMIT), pulled(WEIGHT)),
    "a range in two constraints": (RESPONSE.within(1.0, LIMIT), pulled(WEIGHT)),
    "a limit with a probability": (
        RESPONSE.at_most(LIMIT, probability=0.9),
        pulled(WEIGHT, slope=1 + 0.8 * HALF_WIDTH),
    ),
    "a limit that holds": (RESPONSE.mean <= 5.0, 3.0),
}


@pytest.mark.parametrize("name", PULLED)
def test_the_optimum_is_that_of_the_closed_form(name):
    limit, expected = PULLED[name]
    softened = al.soft(problem(limit), weight=WEIGHT)
    assert not softened.constraints
    assert al.solve(softened).decisions["gain"] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_a_limit_at_every_instant_is_integrated_over_time(way):
    response, slope = al.path("response"), 1 + 2 * SPREAD
    softened = al.soft(problem(response.at_most(LIMIT, sigmas=2), grid=al.Grid(2.5, 4)), "response", weight=WEIGHT)
    found = al.solve(softened, transcription=way).decisions["gain"]
    assert found == pytest.approx(pulled(2.5 * WEIGHT, slope), rel=1e-6)


def test_only_the_constraints_named_become_penalties():
    both = problem((RESPONSE.mean <= LIMIT).named("soft"), (RESPONSE.mean >= 2.5).named("hard"))
    softened = al.soft(both, "soft", weight=WEIGHT)
    assert softened.names == ("hard",)
    assert both.names == ("soft", "hard")
    assert al.solve(softened).decisions["gain"] == pytest.approx(2.5, rel=1e-6)
    twice = al.soft(softened, "hard", weight=2.0)
    expected = (3 + WEIGHT * LIMIT + 2.0 * 2.5) / (1 + WEIGHT + 2.0)
    assert al.solve(twice).decisions["gain"] == pytest.approx(expected, rel=1e-6)


def test_soft_limits_tend_to_hard_ones_in_inverse_proportion_to_the_weight():
    """Equation (101) beside (95), and (94) beside (93)."""
    for one in (gain_problem(LIMIT), al.deterministic(gain_problem(LIMIT))):
        hard = al.solve(one).decisions["gain"]
        weights = np.array([1e2, 1e3, 1e4])
        missed = [al.solve(al.soft(one, weight=weight)).decisions["gain"] - hard for weight in weights]
        assert min(missed) > 0
        np.testing.assert_allclose(np.diff(np.log(missed)) / np.diff(np.log(weights)), -1.0, atol=0.01)


def test_a_tolerance_under_a_soft_limit_is_that_of_its_derivative():
    """Equation (124): `1/h + w (g h/√3 - c)₊²` for a gain `g` of 1, at the root of its derivative."""
    theta = al.Uniform(1.0, half_width=al.Decision(0.1, 0.01, 0.9))
    cost = al.cost.reciprocal("theta.half_width", bias=0.0, scale=1.0)
    limit, weight = 0.2, 50.0
    hard = al.Problem(Gain(1.0, theta), grid=ONE_STEP, minimize=cost, subject_to=[RESPONSE.std <= limit])
    found = al.solve(al.soft(hard, weight=weight)).decisions["theta.half_width"]

    def slope(h):
        return -1 / h**2 + 2 * weight / np.sqrt(3) * (h / np.sqrt(3) - limit)

    assert found == pytest.approx(brentq(slope, 0.35, 0.9), rel=1e-6)


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize("weight", [0.5, 1.5, 2.5, 100.0])
def test_an_exact_penalty_above_the_price_of_a_limit_is_the_limit(weight, way):
    # `(g - 3)² + w (g - 2)₊`: the limit's price is 2, below which the gain is 3 - w/2.
    softened = al.soft(problem(RESPONSE.mean <= LIMIT), weight=weight, exact=True)
    found = al.solve(softened, transcription=way)
    gain = max(3.0 - weight / 2, LIMIT)
    assert found.decisions["gain"] == pytest.approx(gain, rel=1e-6)
    assert found.decisions["response.excess"] == pytest.approx(gain - LIMIT, abs=1e-6)


@pytest.mark.parametrize(
    ("limit", "weight", "expected"),
    [
        (RESPONSE.mean >= 4.0, 10.0, 4.0),
        (RESPONSE.mean >= 4.0, 1.0, 3.5),
        (RESPONSE.mean.equals(LIMIT), 10.0, LIMIT),
        (RESPONSE.mean.equals(LIMIT), 1.0, 2.5),
        (al.path("response").at_most(LIMIT, sigmas=2), 100.0, LIMIT / (1 + 2 * SPREAD)),
        (RESPONSE.mean <= 5.0, 10.0, 3.0),
        (RESPONSE.at_most(LIMIT, worst_case=True), 100.0, LIMIT / (1 + HALF_WIDTH)),
        (RESPONSE.at_most(LIMIT, worst_case=True), 1.0, 3.0 - (1 + HALF_WIDTH) / 2),
    ],
)
def test_exact_penalties_of_every_kind_of_limit(limit, weight, expected):
    found = al.solve(al.soft(problem(limit, grid=al.Grid(2.5, 4)), weight=weight, exact=True))
    assert found.decisions["gain"] == pytest.approx(expected, rel=1e-6)


def test_an_exact_penalty_reads_as_mathematics_and_leaves_the_other_limits():
    both = problem((RESPONSE.mean <= LIMIT).named("top"), RESPONSE.mean >= 0.5)
    softened = al.soft(both, "top", weight=3.0, exact=True)
    text = str(softened)
    assert "μ[loss(t_f)] + 3 top.excess" in text
    assert "top: μ[response(t_f)] − top.excess ≤ 2" in text
    assert softened.names == ("top", "response")
    assert al.solve(softened).decisions["gain"] == pytest.approx(LIMIT, rel=1e-6)


def test_a_decision_of_ones_own_joins_two_limits_to_the_least_largest_value():
    # max(|g - 1|, |g - 4|) is least at 2.5, where it is 1.5.
    level = al.value("level")
    gain = Gain(al.Decision(1.0, 0.01, 10.0), al.Uniform(1.0, half_width=HALF_WIDTH))
    limits = [
        abs_side
        for target in (1.0, 4.0)
        for abs_side in (RESPONSE.mean - level <= target, RESPONSE.mean + level >= target)
    ]
    least = al.Problem(
        gain, grid=ONE_STEP, minimize=level, subject_to=limits, decisions={"level": al.Decision(1.0, 0.0)}
    )
    for way in WAYS.values():
        found = al.solve(least, transcription=way)
        assert found.objective == pytest.approx(1.5, rel=1e-6)
        assert found.decisions["gain"] == pytest.approx(2.5, rel=1e-6)


def test_the_text_is_the_penalty_as_mathematics():
    text = str(al.soft(problem(RESPONSE.mean <= LIMIT, al.path("response").mean.equals(1.0)), weight=WEIGHT))
    assert "μ[loss(t_f)] + 4 (max(μ[response(t_f)] − 2, 0))² + 4 ∫(μ[response(t)] − 1)² dt" in text


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            lambda: al.soft(problem(RESPONSE.mean <= 1.0), weight=1.0, exact="yes"),
            "soft: exact: expected True or False",
        ),
        (lambda: al.soft(problem(), weight=1.0), "no constraints that could become penalties"),
        (lambda: al.soft(problem(RESPONSE.mean <= 1.0), "nobody", weight=1.0), "no constraint 'nobody'"),
        (lambda: al.soft(problem(RESPONSE.at_most(1.0, worst_case=True)), weight=1.0), "can only be limited"),
        (
            lambda: al.soft(problem(al.path("response").at_most(1.0, worst_case=True)), weight=1.0),
            r"'max\[response\(t\)\]' is the worst case",
        ),
    ],
)
def test_what_cannot_be_softened_is_refused(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()


@pytest.mark.parametrize("weight", [1e3, 1e9, 1e12])
def test_penalties_of_any_weight_are_solved_to_their_own_minimum(weight):
    # x'' = u at the control points of one line: least effort from rest to 1 at rest takes 12; penalties ask for less.
    class Block(al.System):
        states = ("x", "v")

        def rhs(self, t, z, u):
            return z.v, u

        def outputs(self, t, z, u):
            return {"x": z.x, "v": z.v, "effort": u**2}

    line = al.BSpline(al.Decision(np.array([1.0, -1.0]), -50.0, 50.0), degree=1)
    ends = (al.terminal("x").mean.equals(1.0).named("X"), al.terminal("v").mean.equals(0.0).named("V"))
    hard = al.Problem(
        Block(), grid=al.Grid(1.0, 20), inputs={"u": line}, minimize=al.integral("effort").mean, subject_to=ends
    )
    found = al.solve(al.soft(hard, weight=weight))
    # The multipliers of the hard optimum are (24, 12): the penalised one is lower by (24² + 12²) / 4w to first order.
    assert found.objective == pytest.approx(12.0 - (24**2 + 12**2) / (4 * weight), rel=1e-3)


def test_weights_carry_units_so_that_penalties_join_any_objective():
    class Beam(al.AlgebraicSystem):
        unknowns = ()
        units: ClassVar = {"mass": "kg", "stress": "MPa"}
        a: al.Number

        def outputs(self):
            return {"mass": self.a, "stress": 4.0 / self.a}

    limit = (al.output("stress").mean <= 1.0).named("stress")
    beam = al.Problem(Beam(al.Decision(1.0, 0.1, 9.0)), minimize=al.output("mass").mean, subject_to=[limit])
    # a + (4/a - 1)²: its slope is 1 - 8 (4/a - 1) / a².
    expected = brentq(lambda a: 1 - 8 * (4 / a - 1) / a**2, 1.0, 4.0)
    assert al.solve(al.soft(beam, weight=1.0)).decisions["a"] == pytest.approx(expected, rel=1e-6)
    assert al.solve(al.soft(beam, weight=5.0, exact=True)).decisions["a"] == pytest.approx(4.0, rel=1e-6)
    front = al.trade_off(
        al.Problem(beam.system, minimize=al.output("mass").mean),
        {"mass": al.output("mass").mean, "stress": al.output("stress").mean + al.output("stress").std},
        4,
    )
    np.testing.assert_allclose(np.prod(front.values, axis=1), 4.0, rtol=1e-6)


def test_the_name_of_a_slack_that_is_taken_is_refused():
    limit = (RESPONSE.mean <= LIMIT).named("low")
    once = al.soft(problem(limit), "low", weight=1.0, exact=True)
    with pytest.raises(al.ProblemError, match=r"no number called 'low\.excess' yet.*soft once.*\.named"):
        al.soft(once, "low", weight=1.0, exact=True)
    owned = al.Problem(
        Gain(al.Decision(1.0, 0.01, 10.0), al.Uniform(1.0, half_width=HALF_WIDTH)),
        grid=ONE_STEP,
        minimize=LOSS.mean,
        subject_to=[limit],
        decisions={"low.excess": al.Decision(7.0, 0.0, 9.0)},
    )
    with pytest.raises(al.ProblemError, match=r"no number called 'low\.excess' yet"):
        al.soft(owned, "low", weight=1.0, exact=True)


@pytest.mark.parametrize(("most", "gain"), [(0.9, 2.75), (0.5, 2.5)])
def test_a_slack_with_a_bound_can_be_searched_and_is_hard_beyond_it(most, gain):
    # `(g - 3)² + w (g - 2)` is least at 3 - w/2.
    limit = (RESPONSE.mean <= LIMIT).named("low")
    search = al.solvers.DifferentialEvolution(evaluations=400, population=24)
    with pytest.raises(al.ProblemError, match=r"'low\.excess' has none.*most="):
        al.solve(al.soft(problem(limit), weight=0.5, exact=True), search)
    found = al.solve(al.soft(problem(limit), weight=0.5, exact=True, most=most), search)
    assert found.decisions["gain"] == pytest.approx(gain, rel=1e-6)
    with pytest.raises(al.ProblemError, match="soft: most: expected it with exact=True alone"):
        al.soft(problem(limit), weight=0.5, most=most)
