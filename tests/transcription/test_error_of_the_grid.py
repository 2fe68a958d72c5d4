"""A solution says how far its time grid errs, and is none where that matters: against SciPy's integrators."""

import warnings
from itertools import pairwise
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import BSpline

import aleator as al

# What SciPy's own tolerance leaves.
SCIPY = 1e-9


class DoubleIntegrator(al.System):
    """A mass that is pushed along a line, and the square of the push."""

    states = ("x", "v")

    def rhs(self, t, z, u):
        return z.v, u

    def outputs(self, t, z, u):
        return {"x": z.x, "v": z.v, "u2": u**2}


def least_effort(points, steps):
    """Rest to rest over 1 m in 1 s: the least effort is 12, by the push 6 - 12 t."""
    push = al.BSpline(al.Decision(np.zeros(points), -50.0, 50.0), degree=min(3, points - 1))
    return al.Problem(
        DoubleIntegrator(),
        grid=al.Grid(1.0, steps),
        inputs={"u": push},
        minimize=al.integral("u2").mean,
        subject_to=[al.terminal("x").mean.equals(1.0), al.terminal("v").mean.equals(0.0)],
    )


def flown(solution):
    """Where the plan ends and what it costs, by SciPy, knot by knot."""
    points = np.asarray(solution.decisions["inputs.u.free"])
    degree = min(3, len(points) - 1)
    inner = np.linspace(0, 1, len(points) - degree + 1)
    push = BSpline(np.concatenate([np.zeros(degree), inner, np.ones(degree)]), points, degree)
    z = np.zeros(3)
    for first, last in pairwise(inner):
        found = solve_ivp(
            lambda t, z: [z[1], push(t), push(t) ** 2], (first, last), z, rtol=1e-12, atol=1e-12, method="DOP853"
        )
        z = found.y[:, -1]
    return z


@pytest.mark.slow
@pytest.mark.parametrize("steps", [20, 50, 200])
@pytest.mark.parametrize("points", [2, 10, 40, 80])
def test_the_cost_of_a_plan_is_what_it_says_to_the_error_that_it_states(points, steps):
    solution = al.solve(least_effort(points, steps), throw=False)
    end, _, cost = flown(solution)
    stated = solution.certificate.grid_error
    assert abs(solution.objective - cost) <= stated.objective.error + SCIPY * cost
    assert abs(1.0 - end) <= stated.functionals["x(t_f)"].error + SCIPY
    if solution.ok:
        assert abs(solution.objective - cost) <= 1e-3 * cost
    if (points, steps) == (80, 20):
        # More control points than the grid can see: some of the push is free between the instants.
        assert solution.status is al.Status.COARSE
        assert cost < 11


def test_refining_a_grid_that_sees_too_little_of_the_control_gives_the_optimum():
    solution = al.solve(least_effort(80, 20), refine=True)
    assert solution.ok
    assert solution.objective == pytest.approx(12.0, rel=1e-6)
    assert flown(solution)[2] == pytest.approx(12.0, rel=1e-6)
    assert solution.problem.grid.steps > 20


class Swinging(al.System):
    """An undamped oscillator with an uncertain spring."""

    states = ("x", "v")
    stiffness: Any
    start: Any

    def initial(self):
        return {"x": self.start}

    def rhs(self, t, z):
        return z.v, -self.stiffness * z.x

    def outputs(self, t, z):
        return {"x": z.x, "v": z.v}


def swing(steps, **options):
    defaults: dict[str, Any] = {
        "expansion": al.Expansion(order=7),
        "minimize": al.rms("v").mean + al.rms("v").std,
        "subject_to": [al.terminal("x").mean >= 0.1],
    }
    system = Swinging(al.Uniform(40.0, half_width=4.0), al.Decision(1.0, 0.2, 2.0))
    return al.Problem(system, grid=al.Grid(1.0, steps), **(defaults | options))


def exact_rms(stiffness, start):
    """The root mean square of the speed of `start cos(w t)` over a second."""
    w = np.sqrt(stiffness)
    return start * w * np.sqrt(0.5 - np.sin(2 * w) / (4 * w))


@pytest.mark.parametrize("steps", [5, 12, 120])
def test_a_coarse_grid_is_said_to_be_one(steps):
    solution = al.solve(swing(steps), throw=False, accuracy=1e-4)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    values = exact_rms(40.0 + 4.0 * nodes, solution.decisions["start"])
    mean = weights @ values / 2
    std = np.sqrt(weights @ (values - mean) ** 2 / 2)
    error = abs(solution.objective - mean - std)
    assert error <= 1.05 * solution.certificate.grid_error.objective.error + 1e-9 * mean
    assert solution.ok == (steps == 120)
    if not solution.ok:
        assert error > 1e-4 * mean / 2
        assert "refine=True" in solution.why()


def test_an_error_beyond_a_thousandth_of_the_spread_is_warned_of():
    with pytest.warns(al.GridWarning, match=r"'rms\(v\)' is off by .* where .* is tolerated"):
        solution = al.solve(swing(25, subject_to=[]))
    assert solution.ok
    tolerated = solution.certificate.grid_error.functionals["rms(v)"].tolerated
    assert tolerated == pytest.approx(1e-3 * float(solution.moments["rms(v)"].std), rel=1e-2)
    assert "is off by" in str(solution)


def test_a_limit_that_breaks_on_a_finer_grid_makes_the_design_none():
    # Runge-Kutta of order 4 damps the oscillation: on so few steps by more than a per cent.
    limit = (al.terminal("x").mean <= 0.5).named("place")
    limited = swing(8, minimize=-al.value("start"), subject_to=[limit])
    solution = al.solve(limited, throw=False)
    assert not solution.ok
    assert "'place'" in solution.why()
    assert al.solve(limited, refine=True).ok


@pytest.mark.parametrize(
    "integrator",
    [
        al.integrators.Tsit5(rtol=1e-3, atol=1e-4),
        pytest.param(al.integrators.Kvaerno5(rtol=1e-3, atol=1e-4), marks=pytest.mark.slow),
    ],
)
def test_loose_tolerances_of_adaptive_integrators_are_seen_too(integrator):
    loose = swing(20, integrator=integrator, minimize=al.rms("v").mean, subject_to=[])
    solution = al.solve(loose, throw=False, accuracy=1e-6)
    assert not solution.ok
    assert solution.certificate.grid_error.objective.error > 0


ADVISED = {
    "the fourth power": (lambda: swing(25, subject_to=[]), {}, "about 50 "),
    "far off": (lambda: swing(5), {}, "at least 40 "),
    "the largest of the instants": (
        lambda: swing(40, subject_to=[al.peak("v").at_most(5.0, sigmas=2.0)]),
        {},
        "about",
    ),
    "pieces of a spline": (lambda: least_effort(80, 20), {}, "about 154 "),
    "tolerances": (
        lambda: swing(
            20,
            integrator=al.integrators.Tsit5(rtol=1e-3, atol=1e-4),
            minimize=al.rms("v").mean,
            subject_to=[],
        ),
        {"accuracy": 1e-6},
        "steps and smaller tolerances of the integrator",
    ),
    "a search led astray": (lambda: lagging(300.0), {}, "at least 200 "),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name == "tolerances" else name for name in ADVISED]
)
def test_as_many_steps_are_advised_as_refining_takes(name):
    make, options, words = ADVISED[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", al.GridWarning)
        coarse = al.solve(make(), throw=False, **options)
        fine = al.solve(make(), refine=True, **options)
    said, advised, taken = str(coarse.certificate.grid_error), coarse.certificate.grid_error.steps_needed, fine.problem
    assert words in said
    assert str(advised) in said
    assert fine.certificate.grid_error.is_met
    assert taken.grid.steps == advised if "at least" not in said else taken.grid.steps >= advised


class Switched(al.System):
    """`x' = 1` after an instant that no uniform grid contains."""

    states = ("x",)
    gain: Any

    def rhs(self, t, z):
        return (jnp.where(t > 1 / np.pi, self.gain, 0.0),)

    def outputs(self, t, z):
        return {"x": z.x}


def test_a_jump_in_time_is_named_with_its_instant_where_refining_does_not_help():
    problem = al.Problem(Switched(al.Decision(1.0, 0.5, 2.0)), grid=al.Grid(1.0, 10), minimize=al.terminal("x").mean)
    with pytest.raises(al.SolveError, match=r"'x\(t_f\)'|objective") as raised:
        al.solve(problem, refine=True, accuracy=1e-9)
    assert "jump in time, near t = 0.31" in str(raised.value)


@pytest.mark.parametrize("accuracy", [0.0, 1e-12, 1.0, "1%", True, np.nan])
def test_an_accuracy_that_no_arithmetic_gives_is_refused(accuracy):
    with pytest.raises(al.ProblemError, match="expected `accuracy` as a number from 1e-09"):
        al.solve(least_effort(4, 20), accuracy=accuracy)


class Fast(al.System):
    """An oscillator that is known in closed form, too fast for a coarse grid."""

    states = ("x", "v")
    d: Any
    frequency: float = 50.0

    def initial(self):
        return {"x": self.d}

    def rhs(self, t, z):
        return z.v, -((2 * jnp.pi * self.frequency) ** 2) * z.x

    def outputs(self, t, z):
        return {"y": z.x, "loss": (self.d - 3.0) ** 2}


def swinging(frequency, steps):
    return al.Problem(
        Fast(al.Decision(1.0, 0.0, 10.0), frequency),
        grid=al.Grid(1.0, steps),
        minimize=al.terminal("loss").mean,
        subject_to=[al.path("y").at_least(-1.0)],
    )


class Lagging(al.System):
    """A lag that is too fast for its grid: stable, but not for Runge-Kutta's steps."""

    states = ("x",)
    d: Any
    rate: float = 300.0

    def rhs(self, t, z):
        return (-self.rate * (z.x - self.d),)

    def outputs(self, t, z):
        return {"y": z.x, "loss": (self.d - 3.0) ** 2}


def lagging(rate):
    return al.Problem(
        Lagging(al.Decision(1.0, 0.0, 10.0), rate),
        grid=al.Grid(1.0, 100),
        minimize=al.terminal("loss").mean,
        subject_to=[al.path("y").at_least(-1.0)],
    )


@pytest.mark.parametrize(
    "make",
    [lambda: swinging(50.0, 100), lambda: swinging(100.0, 100), lambda: lagging(300.0), lambda: lagging(500.0)],
    ids=["50 Hz", "100 Hz", "3.3 ms", "2 ms"],
)
def test_a_search_that_an_unstable_grid_leads_astray_is_told_so(make):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        solution = al.solve(make(), throw=False)
    # Where it fled to nothing moves, and every grid is exact; or it finds no way there, and calls that infeasible.
    said = [str(one.message) for one in told if one.category is al.GridWarning]
    said += [] if solution.ok else [solution.why()]
    assert any("at the start of the search 100 steps give y(t) as" in one for one in said)


def test_more_steps_find_what_an_unstable_grid_hid():
    assert al.solve(swinging(50.0, 5000)).decisions["d"] == pytest.approx(1.0, rel=2e-3)


def test_a_finer_grid_on_which_a_limit_is_not_a_number_is_no_grid_to_be_solved_on():
    solution = al.solve(swinging(200.0, 100), throw=False)
    assert not solution.ok
    assert "is not a number" in solution.why() or "at the start of the search 100 steps give" in solution.why()


@pytest.mark.parametrize("residual", [lambda d: jnp.cos(d) - 0.3 * d, lambda d: (d - 2) ** 2, lambda d: d * 7.3 - 11.0])
def test_what_does_not_depend_on_time_has_no_error_of_the_grid(residual):
    class Still(al.System):
        states = ("nothing",)
        d: Any

        def rhs(self, t, z):
            return (0.0 * z.nothing,)

        def outputs(self, t, z):
            return {"y": residual(self.d), "loss": (self.d - 3.0) ** 2}

    problem = al.Problem(
        Still(al.Decision(1.0, 0.0, 10.0)),
        grid=al.Grid(1.0, 100),
        minimize=al.terminal("loss").mean,
        subject_to=[al.terminal("y").mean.equals(0.0)],
    )
    solution = al.solve(problem, refine=True)
    assert solution.ok
    assert solution.problem.grid.steps == 100
