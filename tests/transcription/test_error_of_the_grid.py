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
from aleator.solution import Deviation, GridError
from zoo import Decay, block_problem

SCIPY = 1e-9  # what SciPy's own tolerance leaves


# --- The push of a block, by a spline of many points ---------------------------------------------------------------


def least_effort() -> al.Problem:
    """Rest to rest over 1 m in 1 s: the least effort is 12, by the push 6 - 12 t."""
    push = al.BSpline(al.Decision(np.zeros(24), -50.0, 50.0), degree=3)
    return block_problem(steps=5, inputs={"force": push})


def flown(solution):
    """Where the plan ends and what it costs, by SciPy, knot by knot."""
    points = np.asarray(solution.decisions["inputs.force.free"])
    inner = np.linspace(0, 1, len(points) - 2)
    push = BSpline(np.concatenate([np.zeros(3), inner, np.ones(3)]), points, 3)
    z, exact = np.zeros(3), {"rtol": 1e-12, "atol": 1e-12, "method": "DOP853"}
    for ends in pairwise(inner):
        z = solve_ivp(lambda t, z: [z[1], push(t), push(t) ** 2], ends, z, **exact).y[:, -1]
    return z


def states_its_error(solution):
    end, _, cost = flown(solution)
    error = solution.certificate.grid_error
    assert abs(solution.objective - cost) <= error.objective.error + SCIPY * cost
    assert abs(1.0 - end) <= error.functionals["x(t_f)"].error + SCIPY
    return cost


@pytest.mark.slow
def test_a_grid_that_sees_too_little_of_a_control_is_coarse_and_as_many_steps_as_it_advises_give_the_optimum():
    coarse = al.solve(least_effort(), throw=False)
    assert "grid is too coarse" in coarse.verdict
    assert states_its_error(coarse) < 11  # some of the push is free between the instants
    fine = al.solve(least_effort(), refine=True)
    assert states_its_error(fine) == pytest.approx(12.0, rel=1e-6)
    assert fine.objective == pytest.approx(12.0, rel=1e-6)
    said = coarse.certificate.grid_error
    assert said.steps_needed % 21 == 0  # the ends of the spline's pieces
    assert f"{said.steps_needed} steps, or refine=True" in str(said)
    assert fine.problem.grid.steps >= said.steps_needed


# --- Steps that are advised ----------------------------------------------------------------------------------------


def off(objective: float, functional: float = 0.0, **options: Any) -> GridError:
    """An error of a grid of 20 steps, in parts of what is tolerated."""
    deviations = {"x": Deviation(functional, 1.0, order=options.pop("order", 4))}
    return GridError(20, 10, "", 1e-3, Deviation(objective, 1.0), deviations, **options)


@pytest.mark.parametrize(
    ("error", "steps", "words"),
    [
        (off(0.9), 20, "seen on 10 times"),
        (off(81.0), 72, "use about 72 steps"),  # three times as many by the fourth power, and a fifth more
        (off(1e9), 160, "use at least 160 steps"),
        (off(0.5, 16.0, order=2), 96, "'x' is off by 16"),
        (off(81.0, by_tolerances=True), 72, "and smaller tolerances of the integrator"),
        (off(np.nan), 160, "off by nan"),
    ],
)
def test_as_many_steps_are_advised_as_the_order_of_convergence_asks_for(error, steps, words):
    assert error.steps_needed == steps
    assert words in str(error)
    assert error.is_met is (steps == 20)


# --- A mass on a spring: released, or struck by a pulse --------------------------------------------------------------


HEIGHT, WIDTH, DAMPING, END = 1e4, 0.0038, 0.4, 4.0
"""Of a pulse of force per mass (N/kg, s); of the damper (1/s); of time (s)."""


class Mount(al.System):
    """A mass on a spring and a damper, released from a place; a narrow pulse of force strikes it."""

    states = ("x", "v")

    stiffness: al.Number
    start: al.Number = 0.0
    damping: al.Number = 0.0
    height: al.Number = 0.0
    centre: al.Number = 1.0

    def initial(self):
        return {"x": self.start}

    def rhs(self, t, z):
        pulse = self.height * jnp.exp(-0.5 * ((t - self.centre) / WIDTH) ** 2)
        return z.v, pulse - self.damping * z.v - self.stiffness * z.x

    def outputs(self, t, z):
        return {"x": z.x, "v": z.v, "loss": (self.start - 3.0) ** 2}


def swing(limit: float = 50.0) -> al.Problem:
    """The longest way to begin from, on eight steps for each oscillation."""
    mount = Mount(al.Uniform(40.0, half_width=4.0), al.Decision(1.0, 0.2, 2.0))
    v, place = al.rms("v"), (al.terminal("x").mean <= limit).named("place")
    minimize = v.mean + v.std - 10.0 * al.value("start")
    return al.Problem(
        mount, grid=al.Grid(1.0, 8), minimize=minimize, subject_to=[place], expansion=al.Expansion(order=4)
    )


def test_a_coarse_grid_is_said_to_be_one_with_an_error_that_is_no_less_than_the_true_one():
    solution = al.solve(swing(), throw=False)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    w = np.sqrt(40.0 + 4.0 * nodes)
    values = 2.0 * w * np.sqrt(0.5 - np.sin(2 * w) / (4 * w))  # the rms of the speed of 2 cos(w t) over a second
    mean = weights @ values / 2
    exact = mean + np.sqrt(weights @ (values - mean) ** 2 / 2) - 20.0
    stated = solution.certificate.grid_error.objective.error
    assert abs(solution.objective - exact) <= 1.05 * stated < 20 * abs(solution.objective - exact)
    assert "grid is too coarse" in solution.verdict
    assert "refine=True" in solution.why()


def test_an_error_beyond_a_part_of_the_spread_is_warned_of_where_a_spread_stands_in_the_problem():
    with pytest.warns(al.GridWarning, match=r"'rms\(v\)' is off by .* where .* is tolerated"):
        solution = al.solve(swing(), accuracy=0.05)
    assert solution.ok
    functionals = solution.certificate.grid_error.functionals
    assert functionals["rms(v)"].tolerated == pytest.approx(10 * 0.05 * float(solution.moments["rms(v)"].std), rel=0.1)
    # Of the place a mean is limited, by 50, and nobody asks for its spread.
    assert functionals["x(t_f)"].tolerated == pytest.approx(0.05 * 50.0)
    assert "is off by" in str(solution)


@pytest.mark.filterwarnings("ignore")
def test_a_limit_that_breaks_on_a_finer_grid_makes_the_design_none():
    # Runge-Kutta of order 4 damps the oscillation: on so few steps by more than a per cent.
    solution = al.solve(swing(0.5), throw=False, accuracy=0.01)
    assert not solution.ok
    assert "'place'" in solution.certificate.grid_error.broken
    assert "'place'" in solution.why()


@pytest.mark.slow
def test_a_search_that_an_unstable_grid_leads_astray_is_told_so():
    problem = al.Problem(
        Mount((2 * np.pi * 50.0) ** 2, al.Decision(1.0, 0.0, 10.0)),
        grid=al.Grid(1.0, 100),
        minimize=al.terminal("loss").mean,
        subject_to=[al.path("x").at_least(-1.0)],
    )
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        solution = al.solve(problem, throw=False)
    # Where it fled to nothing moves, and every grid is exact; or it finds no way there, and calls that infeasible.
    said = [str(one.message) for one in told if one.category is al.GridWarning]
    said += [] if solution.ok else [solution.why()]
    assert any("at the start of the search 100 steps give x(t) as" in one for one in said)


def struck(centre: float, limit: Any) -> al.Solution:
    stiffness = al.Uniform(al.Decision(60.0, 4.0, 400.0), half_width=1.0)
    mount = Mount(stiffness, damping=DAMPING, height=HEIGHT, centre=centre)
    problem = al.Problem(mount, grid=al.Grid(END, 40), minimize=al.value("stiffness.mean"), subject_to=[limit])
    return al.solve(problem, throw=False)


def moved(stiffness, centre):
    """The motion by SciPy, which no step carries past the pulse."""

    def rhs(t, z):
        return [z[1], HEIGHT * np.exp(-0.5 * ((t - centre) / WIDTH) ** 2) - DAMPING * z[1] - stiffness * z[0]]

    exact = {"max_step": WIDTH / 4, "rtol": 1e-9, "atol": 1e-9, "t_eval": np.linspace(0.0, END, 4001)}
    return solve_ivp(rhs, (0.0, END), [0.0, 0.0], **exact).y[0]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_pulse_between_the_steps_is_no_solution_though_the_limit_holds_by_luck():
    centre = 1.0042
    solution = struck(centre, al.terminal("x").at_most(5.0).named("end"))
    true = moved(float(solution.vector[0]), centre)[-1]
    # Not a part of the truth is seen.
    assert abs(float(np.max(solution.constraints[0].values)) - true) > 0.25 * max(5.0, abs(true))
    assert "grid is too coarse" in solution.verdict
    assert not solution.certificate.grid_error.broken
    for words in ("'end'", "do not tell whether it holds", "refine=True"):
        assert words in solution.why()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_limit_that_only_the_grid_breaks_is_told_to_be_one_of_the_grid():
    # An instant in the pulse makes it stronger, so that no spring seems stiff enough.
    solution = struck(1.0, al.rms("x").at_most(2.5).named("ride"))
    assert solution.status is al.Status.INFEASIBLE
    assert np.sqrt(np.mean(moved(400.0, 1.0) ** 2)) < 2.5
    assert "Perhaps for its grid" in solution.why()
    assert "'ride'" in solution.why()


@pytest.mark.slow
def test_loose_tolerances_of_adaptive_integrators_are_seen_and_tightened():
    problem = al.Problem(
        Decay(5.0, al.Decision(2.0, 1.0, 3.0)),
        grid=al.Grid(1.0, 4),
        integrator=al.integrators.Tsit5(rtol=1e-3, atol=1e-4),
        minimize=al.terminal("x").mean,
    )
    solution = al.solve(problem, throw=False, accuracy=1e-6)
    assert not solution.ok
    assert "steps and smaller tolerances of the integrator" in str(solution.certificate.grid_error)
    fine = al.solve(problem, refine=True, accuracy=1e-6)
    assert fine.objective == pytest.approx(np.exp(-5.0), rel=2e-6)


class Swung(al.System):
    """An oscillator under a push whose mean is zero, as its own is on every grid."""

    states = ("x", "v")

    push: al.Number
    cost: al.Number

    def rhs(self, t, z):
        return z.v, 100.0 * (self.push - z.x)

    def outputs(self, t, z):
        return {"x": z.x, "cost": self.cost + 0.0 * t}


def test_the_error_of_a_spread_is_told_where_the_mean_has_none():
    model = Swung(al.Uniform(0.0, half_width=1.0), al.Decision(1.5, 1.0, 2.0))
    limit, cost = (al.terminal("x").std <= 5.0).named("x"), al.terminal("cost").mean
    with pytest.warns(al.GridWarning, match=r"'x\(t_f\)' is off by"):
        found = al.solve(al.Problem(model, grid=al.Grid(3.0, 40), minimize=cost, subject_to=[limit]))
    off = abs(float(found.moments["x(t_f)"].std) - (1 - np.cos(30.0)) / np.sqrt(3))
    assert off <= found.certificate.grid_error.functionals["x(t_f)"].error <= 3 * off
