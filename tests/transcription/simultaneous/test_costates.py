"""Costates and switching functions against closed forms: what a push of a state, or of an input, would change."""

from typing import Any

import numpy as np
import pytest
from collocated_problems import Regulated

import aleator as al
from zoo import block_problem, cases, optimum

EFFORT = al.integral("effort").mean


def costates_of(problem: al.Problem, way: al.Simultaneous, least: float | None = None) -> tuple[Any, Any, Any]:
    """Costates, switching functions and states at the optimum of a program, which may be known."""
    found = optimum(problem, transcription=way)
    assert least is None or found.objective == pytest.approx(least, rel=1e-10)
    point = found.outcome.point
    return *found.transcribed.costates_at(point, found.outcome.multipliers), found.transcribed.states_at(point)


def pushed(scheme: Any, steps: int, least: float | None = None, **options: Any) -> tuple[Any, Any, Any]:
    options = {"inputs": {"force": al.Control(0.0, degree=1)}, "minimize": 0.5 * EFFORT} | options
    return costates_of(block_problem(steps=steps, **options), al.Simultaneous(scheme), least)


@pytest.mark.parametrize(
    "scheme",
    cases([al.schemes.Radau(3), al.schemes.MultipleShooting(2)]),
)
def test_least_effort_to_move_a_block(scheme):
    """From rest to rest in one second, u = 6 - 12 t: with J = 6 (1 - x)², a push of x costs -12 a metre."""
    costates, switching, states = pushed(scheme, 10, least=6.0)
    assert costates["x"] == pytest.approx(np.full((1, 11), -12.0), abs=1e-6)
    assert costates["v"][0] == pytest.approx(12 * costates.times - 6, abs=1e-6)
    # The control is as free as the best one is, so that nothing is left to gain at any point.
    assert switching["force"] == pytest.approx(np.zeros(len(switching.times)), abs=1e-5)
    nodes = np.isin(np.round(states.times, 9), np.round(costates.times, 9))
    times = states.times[nodes]
    assert states["x"][0, nodes] == pytest.approx(3 * times**2 - 2 * times**3, abs=1e-6)
    assert states["v"][0, nodes] == pytest.approx(6 * times - 6 * times**2, abs=1e-6)


def test_the_switching_function_of_the_fastest_block_changes_sign_half_way():
    """p_v = 2 t / T - 1 with T = 2 √d, and p_x = -1 / √d: what the time is shorter for each metre that is given."""
    steps, away = 10, 1e-4
    costates, switching, _ = pushed(
        al.schemes.HermiteSimpson(),
        steps,
        inputs={"force": al.Control(0.0, -1.0, 1.0, degree=0)},
        minimize=al.objectives.final_time(),
        grid=al.Grid(al.Decision(4.0, 1.0, 10.0), steps),
    )
    times, duration = switching.times, costates.times[-1]
    assert duration == pytest.approx(2.0, rel=2e-3)
    assert costates["x"] == pytest.approx(np.full((1, steps + 1), -1.0), abs=away)
    assert costates["v"][0] == pytest.approx(2 * costates.times / duration - 1, abs=2 * away)
    assert switching["force"] == pytest.approx(2 * times / duration - 1, abs=2 * away)


def regulated(lag: Any = 1.0, first: float = 1.0, **options: Any) -> al.Problem:
    control = {"u": al.Control(0.0, degree=1)}
    cost = al.integral("cost").mean
    return al.Problem(Regulated(lag, first), grid=al.Grid(2.0, 40), inputs=control, minimize=cost, **options)


@pytest.mark.slow
def test_costates_of_all_realisations_add_up_to_a_push_of_all():
    lag, push = al.Uniform(1.0, half_width=0.4), 1e-3

    def problem(first: float) -> al.Problem:
        return regulated(lag, first, expansion=al.Expansion(order=2))

    costates, _, _ = costates_of(problem(1.0), al.Simultaneous())
    assert len(costates.germs) > 1
    before, after = (optimum(problem(1.0 + by), transcription=al.Simultaneous()).objective for by in (-push, push))
    assert costates["x"][:, 0].sum() == pytest.approx((after - before) / (2 * push), rel=1e-6)


@pytest.mark.slow
def test_a_solution_tells_costates_of_a_search_that_was_finished_alone():
    def solved(strongest: float) -> al.Solution:
        control = al.Control(0.0, -strongest, strongest, degree=1)
        problem = block_problem(inputs={"force": control}, minimize=0.5 * EFFORT)
        return al.solve(problem, transcription=al.Simultaneous(), between=1, throw=False)

    known, weak = solved(50.0), solved(0.1)
    assert known.costates["x"] == pytest.approx(np.full((1, 11), -12.0), abs=1e-6)
    assert known.switching["force"] == pytest.approx(np.zeros(len(known.switching.times)), abs=1e-5)
    assert known.mesh_states["x"][0, -1] == pytest.approx(1.0)
    assert not weak.ok
    assert weak.costates is None
    assert weak.switching is None
