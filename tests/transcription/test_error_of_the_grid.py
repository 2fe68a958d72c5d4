"""A solution says how far its time grid errs, and is none where that matters: against SciPy's integrators."""

from typing import Any

import numpy as np
import pytest

import aleator as al
from aleator.solution import Deviation, GridError

# --- Steps that are advised ----------------------------------------------------------------------------------------


def off(objective: float, functional: float = 0.0, **options: Any) -> GridError:
    """An error of a grid of 20 steps, in parts of what is tolerated."""
    deviations = {"x": Deviation(functional, 1.0, order=options.pop("order", 4))}
    return GridError(20, 10, Deviation(objective, 1.0), deviations, **options)


@pytest.mark.parametrize(
    ("error", "steps", "words"),
    [
        (off(0.9), 40, "objective off by 9.0e-01"),
        (off(81.0), 72, "use about 72 steps"),  # three times as many by the fourth power, and a fifth more
        (off(1e9), 160, "use at least 160 steps"),
        (off(0.5, 16.0, order=2), 96, "'x' is off by 16"),
        (off(81.0, by_tolerances=True), 72, "and smaller tolerances of the integrator"),
        (off(np.nan), 160, "off by nan"),
    ],
)
def test_as_many_steps_are_advised_as_the_order_of_convergence_asks_for(error, steps, words):
    assert error.next_steps == steps
    assert words in str(error)
    assert error.is_met is (steps == 40)


# --- A mass on a spring ----------------------------------------------------------------------------------------------


class Mount(al.System):
    """A unit mass on a spring, released from a place."""

    states = ("x", "v")

    stiffness: al.Number
    start: al.Number

    def initial(self):
        return {"x": self.start}

    def rhs(self, t, z):
        return z.v, -self.stiffness * z.x

    def outputs(self, t, z):
        return {"x": z.x, "v": z.v}


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
