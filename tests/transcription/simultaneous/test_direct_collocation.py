"""Problems solved by direct collocation: known optima, and the answers of the other transcription."""

from typing import Any

import numpy as np
import pytest
from collocated_problems import crane, oscillator

import aleator as al
from algebraic_models import tolerance_problem


class Block(al.System):
    """`x'' = gain u`, from rest to one metre away, at rest again."""

    states = ("x", "v")

    gain: Any = 1.0

    def rhs(self, t, z, u):
        return z.v, self.gain * u

    def outputs(self, t, z, u):
        return {"x": z.x, "v": z.v, "u²": u**2}


def move(gain: Any = 1.0, intervals: int = 20, **options: Any) -> al.Problem:
    defaults: dict[str, Any] = {
        "grid": al.Grid(1.0, intervals),
        "inputs": {"u": al.BSpline(al.Decision(np.zeros(5), -50.0, 50.0), degree=3)},
        "minimize": al.integral("u²").mean,
        "subject_to": [al.terminal("x").mean.equals(1.0), al.terminal("v").mean.equals(0.0)],
    }
    return al.Problem(Block(gain=gain), **(defaults | options))


EXACT = [
    al.schemes.HermiteSimpson(),
    al.schemes.Radau(3),
    al.schemes.GaussLegendre(2),
    al.schemes.MultipleShooting(2),
]


@pytest.mark.parametrize("scheme", EXACT)
def test_least_effort_to_move_a_block_is_12(scheme):
    solution = al.solve(move(), transcription=al.Simultaneous(scheme))
    assert solution.objective == pytest.approx(12.0, rel=1e-10)


def test_an_uncertain_gain_spreads_the_end_by_its_own_spread():
    spread = 0.3
    solution = al.solve(move(gain=al.Uniform(2.0, half_width=2.0 * spread)), transcription=al.Simultaneous())
    assert solution.objective == pytest.approx(12.0 / 2.0**2, rel=1e-10)
    assert solution.moments["x(t_f)"].std == pytest.approx(spread / np.sqrt(3), rel=1e-10)


def test_the_trapezoid_is_coarse_and_says_so():
    solution = al.solve(move(), transcription=al.Simultaneous(al.schemes.Trapezoid()), throw=False)
    assert solution.status is al.Status.COARSE
    assert "exceeds its bound" in solution.why()


def test_least_time_to_move_a_block():
    """Two metres between rests with |u| <= 1 take 2 sqrt(2) s, full ahead then full astern; a spline cannot jump."""
    problem = al.Problem(
        Block(),
        grid=al.Grid(al.Decision(4.0, 1.0, 10.0), 40),
        inputs={"u": al.BSpline(al.Decision(np.zeros(41), -1.0, 1.0), degree=1)},
        minimize=al.objectives.final_time(),
        subject_to=[al.terminal("x").mean.equals(2.0), al.terminal("v").mean.equals(0.0)],
    )
    solution = al.solve(problem, transcription=al.Simultaneous(al.schemes.GaussLegendre(2)), throw=False)
    least = 2 * np.sqrt(2.0)
    assert least < solution.objective < 1.01 * least
    assert solution.certificate.stationarity < 1e-6


PROBLEMS = {
    "a spread within limits": lambda: oscillator(),
    "a worst case": lambda: oscillator(subject_to=[al.peak("x").at_most(0.3, worst_case=True)]),
    "a limit with a probability": lambda: oscillator(subject_to=[al.path("x").at_most(0.14, probability=0.95)]),
    "a swinging load": lambda: crane(40),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PROBLEMS)
def test_both_transcriptions_give_the_same_answer(name):
    problem = PROBLEMS[name]()
    usual, other = (al.solve(problem, transcription=one, accuracy=1e-2) for one in (al.Sequential(), al.Simultaneous()))
    assert other.ok
    assert other.objective == pytest.approx(usual.objective, rel=5e-5)
    np.testing.assert_allclose(other.vector, usual.vector, rtol=1e-3, atol=1e-3)
    for one, same in zip(other.constraints, usual.constraints, strict=True):
        assert (one.name, one.text, np.shape(one.values)) == (same.name, same.text, np.shape(same.values))
        assert np.sum(one.multipliers) == pytest.approx(np.sum(same.multipliers), rel=1e-2, abs=1e-4)
    assert other.moments.keys() == usual.moments.keys()
    assert other.statistics.keys() == usual.statistics.keys()


class Unstable(al.System):
    """An inverted pendulum near its top: what is shot forward grows by e^(rate T)."""

    states = ("x", "v")

    rate: Any = 4.0

    def rhs(self, t, z, u):
        return z.v, self.rate**2 * z.x + u

    def outputs(self, t, z, u):
        return {"x": z.x, "v": z.v, "u²": u**2}

    def initial(self):
        return {"x": 0.1}


def test_what_cannot_be_simulated_at_the_start_can_be_solved():
    """From rest at 0.1 to rest at 0 in 8 s: e^32 times what errs at the start shows at the end."""
    problem = al.Problem(
        Unstable(),
        grid=al.Grid(8.0, 120),
        inputs={"u": al.BSpline(al.Decision(np.zeros(60), -500.0, 500.0), degree=3)},
        minimize=al.integral("u²").mean,
        subject_to=[al.terminal("x").mean.equals(0.0), al.terminal("v").mean.equals(0.0)],
    )
    solution = al.solve(problem, transcription=al.Simultaneous(), throw=False, between=1)
    # Of the mode that grows, z = v + rate x, the least effort over all time is 2 rate z²; the other one dies out.
    rate, start = 4.0, 0.1
    assert solution.certificate.violation < 1e-6  # relative to what states are, not to e^32
    assert solution.objective == pytest.approx(2 * rate * (rate * start) ** 2, rel=1e-2)


def test_algebraic_systems_are_refused():
    with pytest.raises(al.ProblemError, match=r"Hardening, which is algebraic. Use al\.Sequential"):
        al.solve(tolerance_problem(), transcription=al.Simultaneous())


EFFORT = al.integral("effort").mean
OVER_TIME = {
    "a spread": EFFORT + 1e3 * al.time_integral(al.path("angle").variance),
    "in a norm": EFFORT + al.objectives.norm(al.time_integral(al.path("x").mean), al.terminal("x").std),
    "coefficient by coefficient": EFFORT + al.objectives.coefficient_power({"force": "v"}, smoothing=0.1),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OVER_TIME)
def test_statistics_over_time_are_those_of_shooting(name):
    problem = crane(120, minimize=OVER_TIME[name])
    usual, other = (al.solve(problem, transcription=one, accuracy=0.1) for one in (al.Sequential(), al.Simultaneous()))
    assert other.objective == pytest.approx(usual.objective, rel=1e-6)
    assert other.statistics.keys() == usual.statistics.keys()
    for text, one in usual.statistics.items():
        np.testing.assert_allclose(other.statistics[text], one, rtol=1e-3, atol=1e-3)


def test_a_spread_over_time_in_closed_form():
    """A block that is pushed by one moves by `gain t² / 2`: its variance is that of the gain times `t⁴ / 4`."""
    push = al.BSpline(al.Decision(np.ones(4), 1.0, 2.0), degree=3)
    problem = move(
        gain=al.Uniform(2.0, half_width=0.6),
        minimize=al.time_integral(al.path("x").variance),
        subject_to=[],
        inputs={"u": push},
    )
    solution = al.solve(problem, transcription=al.Simultaneous())
    assert solution.objective == pytest.approx(0.6**2 / 3 / 20, rel=1e-5)  # Simpson's rule on 40 halves of steps


@pytest.mark.parametrize("scheme", ["Radau", 3, al.schemes.Radau])
def test_what_is_no_scheme_is_refused(scheme):
    with pytest.raises(al.ProblemError, match=r"Simultaneous: scheme: expected .*al\.schemes\.HermiteSimpson"):
        al.Simultaneous(scheme)


@pytest.mark.slow
def test_fresh_systems_are_simulated_as_finely_as_the_mesh_is():
    """On the ten steps of its grid the crane's simulation errs by more than its terminal limits allow."""
    solution = al.solve(crane(10), transcription=al.Simultaneous(error=1e-6))
    assert solution.certificate.opinion.agrees


class Divided(al.System):
    """An output that is not a number where the state starts."""

    states = ("x",)

    def rhs(self, t, z, u):
        return (u,)

    def outputs(self, t, z, u):
        return {"x": z.x, "ratio": z.x / z.x}


def test_a_model_that_is_not_finite_at_the_start_is_told():
    problem = al.Problem(
        Divided(),
        grid=al.Grid(1.0, 4),
        inputs={"u": al.BSpline(al.Decision(np.zeros(4), -1.0, 1.0))},
        minimize=al.integral("ratio").mean,
        subject_to=[al.terminal("x").mean.equals(1.0)],
    )
    with pytest.raises(al.SimulationError, match="ratio"):
        al.solve(problem, transcription=al.Simultaneous())
