"""Guesses of states: where simultaneous programs start whose simulation at the initial decisions is useless."""

from typing import Any

import numpy as np
import pytest
import xarray
from collocated_problems import Swing, states_at_start

import aleator as al
from aleator.transcription import transcribe
from zoo import LOSS, ONE_STEP, RESPONSE, SPREAD, block_problem, gain_problem, optimum

DURATION = 3.0


def swing_up(intervals: int = 60, length: Any = 1.0, points: int = 30, **options: Any) -> al.Problem:
    """From rest below to rest above, by torques that cannot hold the pendulum level: at rest nothing happens at all."""
    defaults: dict[str, Any] = {
        "grid": al.Grid(DURATION, intervals),
        "inputs": {"torque": al.BSpline(al.Decision(np.zeros(points), -5.0, 5.0), degree=3)},
        "minimize": al.integral("effort").mean,
        "subject_to": [al.terminal("angle").mean.equals(np.pi), al.terminal("rate").mean.equals(0.0)],
    }
    return al.Problem(Swing(length), **(defaults | options))


def turning(t: float) -> dict[str, float]:
    """Half a turn at a constant rate."""
    return {"angle": np.pi * t / DURATION, "rate": np.pi / DURATION}


def way(guess: Any = None) -> al.Simultaneous:
    return al.Simultaneous(al.schemes.GaussLegendre(2), guess=guess)


@pytest.fixture(scope="module")
def swung():
    return al.solve(swing_up(), transcription=way(turning), between=1, throw=False, accuracy=0.1)


@pytest.mark.slow
def test_a_swing_up_takes_fewer_iterations_from_a_guess_and_fewer_still_from_a_solution(swung):
    assert swung.ok
    scratch = optimum(swing_up(), transcription=way())
    assert swung.objective == pytest.approx(scratch.objective, rel=1e-6)
    assert 2 * swung.effort.iterations < scratch.outcome.iterations
    for steps in (60, 90):
        again = optimum(swing_up(steps), transcription=way(swung))
        assert again.objective == pytest.approx(swung.objective, rel=1e-3)
        assert again.outcome.iterations < swung.effort.iterations


TIMES = np.array([0.0, 0.4 * DURATION, DURATION])
COLUMNS = {"angle": np.pi * TIMES / DURATION, "rate": np.full(3, np.pi / DURATION)}
TABLES = {
    "a dict": {"time": TIMES, **COLUMNS},
    "an xarray.Dataset": xarray.Dataset({name: ("time", one) for name, one in COLUMNS.items()}, {"time": TIMES}),
    "a NumPy array": np.array(
        list(zip(TIMES, *COLUMNS.values(), strict=True)), [("time", float), ("angle", float), ("rate", float)]
    ),
    "a function that returns the states in order": lambda t: tuple(turning(t).values()),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_starts_where_a_function_does(name):
    problem = swing_up(10, length=al.Uniform(1.0, half_width=0.1), expansion=al.Expansion(order=1))
    states, times = states_at_start(problem, TABLES[name])
    expected = np.stack([np.pi * times / DURATION, np.full(len(times), np.pi / DURATION)], axis=1)
    np.testing.assert_allclose(states, np.broadcast_to(expected, states.shape), rtol=1e-14, atol=1e-14)


def pushed(mass: Any = 1.0, points: int = 5) -> al.Problem:
    force = al.BSpline(al.Decision(np.zeros(points), -50.0, 50.0), degree=3)
    return block_problem(mass, inputs={"force": force})


@pytest.fixture(scope="module")
def moved():
    return al.solve(pushed(), transcription=al.Simultaneous(), between=1)


@pytest.mark.slow
def test_decisions_that_a_solution_has_are_where_a_program_starts(moved):
    """The force in another spline is fitted; a decision of another name keeps its own start."""
    problem = pushed(al.Decision(1.0, 0.5, 2.0), points=9)
    given = al.Simultaneous(guess=moved)
    first = problem.placements.named(given.first(problem))
    assert first["mass"] == 1.0
    assert first["inputs.force.free"][[0, -1]] == pytest.approx([6.0, -6.0], rel=1e-6)  # the push is 6 - 12 t
    transcribed = transcribe(problem, given)
    np.testing.assert_array_equal(transcribed.decisions(transcribed.program.start), given.first(problem))
    # On the same grid each realisation begins at the states of the solution.
    states, times = states_at_start(pushed(), moved)
    np.testing.assert_allclose(states[0, :, 0], 3 * times**2 - 2 * times**3, atol=1e-6)


# --- Robust problems started from the answer to their deterministic ones ---------------------------------------------


def test_an_answer_at_the_means_starts_the_robust_problem_unless_there_is_none():
    """No spread is as large as is asked where nothing is uncertain."""
    limits = [RESPONSE.at_most(2.0, sigmas=1.0), (RESPONSE.std >= 0.1).named("spread")]
    spread = al.Problem(gain_problem().system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=limits)
    for problem, starts in ((gain_problem(), True), (spread, False)):
        found = al.solve(problem, deterministic_first=True)
        assert found.ok
        before = found.effort.at_means
        assert before is not None
        assert before.starts is starts
        assert ("started nothing" in str(found)) is not starts
    assert found.decisions["gain"] == pytest.approx(2.0 / (1 + SPREAD), rel=1e-6)


def test_a_problem_without_distributions_is_solved_once_and_one_start_is_given_at_most():
    found = al.solve(gain_problem(theta=1.0), deterministic_first=True)
    assert found.ok
    assert found.effort.at_means is None
    with pytest.raises(al.ProblemError, match="either `warm_start` or `deterministic_first`"):
        al.solve(gain_problem(theta=1.0), warm_start=found, deterministic_first=True)
