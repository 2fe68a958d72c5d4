"""Costates and switching functions against closed forms: what a push of a state, or of an input, would change."""

from typing import Any

import numpy as np
import pytest

import aleator as al

SCHEMES = {
    "trapezoid": (al.schemes.Trapezoid(), 2e-3),
    "Hermite and Simpson": (al.schemes.HermiteSimpson(), 1e-5),
    "Radau": (al.schemes.Radau(3), 1e-5),
    "Gauss": (al.schemes.GaussLegendre(2), 1e-5),
    "segments": (al.schemes.MultipleShooting(2), 1e-5),
}


class Block(al.System):
    """A unit mass on a rail, from rest."""

    states = ("x", "v")

    def rhs(self, t, z, u):
        return z.v, u

    def outputs(self, t, z, u):
        return {"x": z.x, "v": z.v, "u²/2": u**2 / 2}


class Regulated(al.System):
    """`x' = -x / τ + u`."""

    states = ("x",)
    lag: al.Number = 1.0
    first: float = 1.0

    def rhs(self, t, z, u):
        return (-z.x / self.lag + u,)

    def outputs(self, t, z, u):
        return {"cost": z.x**2 + u**2}

    def initial(self):
        return {"x": self.first}


def moved(control: Any, minimize: Any, grid: al.Grid, distance: float) -> al.Problem:
    return al.Problem(
        Block(),
        grid=grid,
        inputs={"u": control},
        minimize=minimize,
        subject_to=[al.terminal("x").mean.equals(distance), al.terminal("v").mean.equals(0.0)],
    )


def regulated(lag: Any = 1.0, first: float = 1.0, **options: Any) -> al.Problem:
    return al.Problem(
        Regulated(lag=lag, first=first),
        grid=al.Grid(2.0, 40),
        inputs={"u": al.Control(0.0, degree=1)},
        minimize=al.integral("cost").mean,
        **options,
    )


def pushed(scheme: Any, steps: int) -> tuple[al.results.Costates, al.results.Switching]:
    problem = moved(al.Control(0.0, degree=1), al.integral("u²/2").mean, al.Grid(1.0, steps), 1.0)
    solution = al.solve(problem, transcription=al.Simultaneous(scheme), throw=False)
    assert solution.costates is not None
    assert solution.switching is not None
    return solution.costates, solution.switching


@pytest.mark.parametrize("name", [name for name in SCHEMES if name != "trapezoid"])
def test_least_effort_to_move_a_block(name):
    """From rest to rest in one second, u = 6 - 12 t: with J = 6 (1 - x)², a push of x costs -12 a metre."""
    costates, switching = pushed(SCHEMES[name][0], 20)
    assert costates["x"] == pytest.approx(np.full((1, 21), -12.0), abs=1e-6)
    assert costates["v"][0] == pytest.approx(12 * costates.times - 6, abs=1e-6)
    # The control is as free as the best one is, so that nothing is left to gain at any point.
    assert switching["u"] == pytest.approx(np.zeros(len(switching.times)), abs=1e-5)


def test_costates_of_the_trapezoidal_rule_are_of_its_order():
    errors = [np.abs(pushed(al.schemes.Trapezoid(), steps)[0]["x"] + 12).max() for steps in (10, 20)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("degree", [0, 1])
def test_the_switching_function_of_the_fastest_block_changes_sign_half_way(degree):
    """p_v = 2 t / T - 1 with T = 2 √d, and p_x = -1 / √d: what the time is shorter for each metre that is given."""
    distance, steps = 2.0, 11 if degree else 10
    problem = moved(
        al.Control(0.0, -1.0, 1.0, degree=degree),
        al.objectives.final_time(),
        al.Grid(al.Decision(4.0, 1.0, 10.0), steps),
        distance,
    )
    solution = al.solve(problem, transcription=al.Simultaneous())
    costates, switching = solution.costates, solution.switching
    assert costates is not None
    assert switching is not None
    times, duration = switching.times, solution.objective
    away = 5e-3 if degree else 1e-4
    assert costates["x"] == pytest.approx(np.full((1, steps + 1), -1 / np.sqrt(distance)), abs=away)
    assert costates["v"][0] == pytest.approx(2 * costates.times / duration - 1, abs=2 * away)
    assert switching["u"] == pytest.approx(2 * times / duration - 1, abs=2 * away)
    first, last = times < 0.45 * duration, times > 0.55 * duration
    assert (switching["u"][first] < 0).all()
    assert (switching["u"][last] > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", SCHEMES)
def test_a_regulated_lag_has_the_costate_of_its_riccati_equation(name):
    """`-P' = 1 - 2 P - P²` backwards from zero: the costate is 2 P x."""
    scheme, away = SCHEMES[name]
    solution = al.solve(regulated(), transcription=al.Simultaneous(scheme), throw=False)
    costates, states = solution.costates, solution.states
    assert costates is not None
    assert states is not None
    grown = np.tanh(np.sqrt(2) * (2.0 - costates.times))
    riccati = grown / (np.sqrt(2) + grown)
    at_nodes = states["x"][0, np.isin(np.round(states.times, 9), np.round(costates.times, 9))]
    assert costates["x"][0] == pytest.approx(2 * riccati * at_nodes, abs=100 * away if "trap" in name else 20 * away)
    assert solution.objective == pytest.approx(riccati[0], rel=2e-3)


def test_a_search_that_was_not_finished_tells_no_costates():
    weak = al.Control(0.0, -0.1, 0.1)
    problem = moved(weak, al.integral("u²/2").mean, al.Grid(1.0, 4), 1.0)
    solution = al.solve(problem, transcription=al.Simultaneous(), between=1, throw=False)
    assert not solution.ok
    assert solution.costates is None
    assert solution.switching is None


def test_no_switching_function_is_told_that_lacks_an_integral_of_statistics():
    problem = moved(al.Control(0.0, -9.0, 9.0, degree=1), al.time_integral(al.path("u²/2").mean), al.Grid(1.0, 4), 1.0)
    solution = al.solve(problem, transcription=al.Simultaneous(), between=1, throw=False)
    assert solution.costates is not None
    assert solution.switching is not None
    assert not solution.switching.values


def test_states_are_told_by_their_own_names():
    solution = al.solve(
        moved(al.Control(0.0, degree=1), al.integral("u²/2").mean, al.Grid(1.0, 4), 1.0),
        transcription=al.Simultaneous(),
    )
    assert solution.states is not None
    times = solution.states.times
    assert solution.states["x"][0] == pytest.approx(3 * times**2 - 2 * times**3, abs=1e-6)
    assert solution.states["v"][0] == pytest.approx(6 * times - 6 * times**2, abs=1e-6)


def test_costates_of_all_realisations_add_up_to_a_push_of_all():
    lag = al.Uniform(1.0, half_width=0.4)

    def optimum(first: float) -> al.Solution:
        return al.solve(regulated(lag, first, expansion=al.Expansion(order=2)), transcription=al.Simultaneous())

    push, (before, middle, after) = 1e-3, (optimum(1.0 + push) for push in (-1e-3, 0.0, 1e-3))
    assert middle.costates is not None
    assert len(middle.costates.germs) > 1
    found = middle.costates["x"][:, 0].sum()
    assert found == pytest.approx((after.objective - before.objective) / (2 * push), rel=1e-6)


def test_costates_do_not_depend_on_where_the_mesh_is_fine():
    coarse, fine = (al.solve(regulated(), transcription=al.Simultaneous(error=error)) for error in (1e-5, 1e-9))
    assert coarse.costates is not None
    assert fine.costates is not None
    assert len(fine.costates.times) > len(coarse.costates.times)
    shared = np.interp(coarse.costates.times, fine.costates.times, fine.costates["x"][0])
    assert coarse.costates["x"][0] == pytest.approx(shared, abs=2e-4)


def test_where_states_are_simulated_there_are_none():
    solution = al.solve(regulated())
    assert solution.costates is None
    assert solution.switching is None
