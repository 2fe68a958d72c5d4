"""Problems solved by direct collocation: known optima, and the answers of the other transcription."""

import numpy as np
import pytest
from collocated_problems import move, turned

import aleator as al
from zoo import Hardening, optimum


def test_an_uncertain_mass_spreads_the_end_by_its_own_spread():
    """What a mass moves is the mean of its inverse times what one kilogram does."""
    lower, upper = 0.5, 1.5
    problem = move(al.Uniform(1.0, half_width=0.5), expansion=al.Expansion(order=8))
    solution = al.solve(problem, transcription=al.Simultaneous())
    mean = np.log(upper / lower)
    assert solution.objective == pytest.approx(12.0 / mean**2, rel=1e-5)
    spread = np.sqrt(1 / (lower * upper) - mean**2) / mean
    assert solution.moments["x(t_f)"].std == pytest.approx(spread, rel=1e-4)
    # States are those of its realisations, each of which moves by the inverse of its mass.
    masses = 1.0 + 0.5 * solution.states.germs[:, 0]
    x = solution.states["x"]
    np.testing.assert_allclose(x * masses[:, None], np.broadcast_to(x[0] * masses[0], x.shape), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(solution.states.times[[0, -1]], [0.0, 1.0])
    with pytest.raises(al.ProblemError, match=r"expected one of \['x', 'v'\]; received 'w'"):
        solution.states["w"]


def test_the_trapezoid_is_coarse_and_says_so():
    solution = al.solve(move(), transcription=al.Simultaneous(al.schemes.Trapezoid()), throw=False)
    assert solution.status is al.Status.COARSE
    assert "exceeds its bound" in solution.why()


EFFORT, ANGLE = al.integral("effort").mean, al.path("angle")
PROBLEMS = {
    "a spread within limits": {},
    "a limit with a probability": {"subject_to": [al.terminal("angle").at_least(1.0, probability=0.95)]},
    "a worst case": {"subject_to": [al.terminal("angle").at_least(1.0, worst_case=True)]},
    "a spread over time": {"minimize": EFFORT + 1e3 * al.time_integral(ANGLE.variance)},
    "in a norm": {"minimize": EFFORT + al.objectives.norm(al.time_integral(ANGLE.mean), al.terminal("angle").std)},
    "coefficient by coefficient": {
        "minimize": EFFORT + al.objectives.coefficient_power({"torque": "rate"}, smoothing=0.1)
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PROBLEMS)
def test_both_transcriptions_give_the_same_answer(name):
    problem = turned(60, **PROBLEMS[name])
    usual, other = (
        al.solve(problem, transcription=one, accuracy=1e-2, between=1) for one in (al.Sequential(), al.Simultaneous())
    )
    assert other.ok
    assert other.objective == pytest.approx(usual.objective, rel=5e-5)
    np.testing.assert_allclose(other.vector, usual.vector, rtol=1e-2, atol=1e-2)
    for one, same in zip(other.constraints, usual.constraints, strict=True):
        assert (one.name, one.text, np.shape(one.values)) == (same.name, same.text, np.shape(same.values))
        assert np.sum(one.multipliers) == pytest.approx(np.sum(same.multipliers), rel=1e-2, abs=1e-2)
    assert other.moments.keys() == usual.moments.keys()
    for text, one in usual.statistics.items():
        np.testing.assert_allclose(other.statistics[text], one, rtol=1e-3, atol=1e-3)


@pytest.mark.slow
def test_a_spread_over_time_in_closed_form():
    """A block that a newton pushes moves by `t² / 2 m`: its variance is that of 1 / m times `t⁴ / 4`."""
    push = al.BSpline(al.Decision(np.ones(4), 1.0, 2.0), degree=3)
    problem = move(
        al.Uniform(1.0, half_width=0.5),
        minimize=al.time_integral(al.path("x").variance),
        subject_to=[],
        inputs={"force": push},
        expansion=al.Expansion(order=8),
    )
    variance = 1 / 0.75 - np.log(3.0) ** 2
    found = optimum(problem, transcription=al.Simultaneous())
    assert found.objective == pytest.approx(variance / 20, rel=1e-4)  # Simpson's rule on 40 halves of steps


def test_algebraic_systems_are_refused():
    problem = al.Problem(Hardening(al.Decision(1.0, 0.5, 2.0)), minimize=al.output("x").mean)
    with pytest.raises(al.ProblemError, match=r"Hardening, which is algebraic. Use al\.Sequential"):
        al.solve(problem, transcription=al.Simultaneous())


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
        inputs={"u": al.Control(0.0, -1.0, 1.0)},
        minimize=al.integral("ratio").mean,
        subject_to=[al.terminal("x").mean.equals(1.0)],
    )
    with pytest.raises(al.SimulationError, match="ratio"):
        al.solve(problem, transcription=al.Simultaneous())
