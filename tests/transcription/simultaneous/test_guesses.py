"""Guesses of states: where simultaneous programs start whose simulation at the initial decisions is useless."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray
from collocated_problems import Swing, move, states_at_start, turned
from test_known_optima import Bead, cycloid_time, spline

import aleator as al
from aleator.transcription import transcribe
from zoo import gain_problem, optimum

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


def test_a_brachistochrone_whose_simulation_rests_is_found_in_fewer_iterations_from_a_straight_line():
    """At the initial decisions the wire is level, so that the bead never moves."""
    problem = al.Problem(
        Bead(),
        grid=al.Grid(al.Decision(2.0, 0.5, 10.0), 30),
        inputs={"angle": spline(np.full(12, np.pi / 2), 0.0, np.pi, degree=3)},
        minimize=al.objectives.final_time(),
        subject_to=[al.terminal("x").mean.equals(10.0), al.terminal("y").mean.equals(-5.0)],
    )
    guessed = optimum(problem, transcription=way(lambda t: {"x": 5.0 * t, "y": -2.5 * t, "v": 5.0 * t}))
    assert guessed.objective == pytest.approx(cycloid_time(10.0, 5.0), rel=1e-6)
    scratch = way().solver.solve(transcribe(problem, way()).program)
    assert guessed.outcome.iterations < scratch.iterations


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
    "a dict in another order": {"rate": COLUMNS["rate"].tolist(), "angle": COLUMNS["angle"].tolist(), "time": TIMES},
    "an xarray.Dataset": xarray.Dataset({name: ("time", one) for name, one in COLUMNS.items()}, {"time": TIMES}),
    "a NumPy array": np.array(
        list(zip(TIMES, *COLUMNS.values(), strict=True)), [("time", float), ("angle", float), ("rate", float)]
    ),
    "a function that returns the states in order": lambda t: tuple(turning(t).values()),
    "a function that returns an array": lambda t: np.array(list(turning(t).values())),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_starts_where_a_function_does(name):
    problem = swing_up(10, length=al.Uniform(1.0, half_width=0.1), expansion=al.Expansion(order=1))
    states, times = states_at_start(problem, TABLES[name])
    expected = np.stack([np.pi * times / DURATION, np.full(len(times), np.pi / DURATION)], axis=1)
    np.testing.assert_allclose(states, np.broadcast_to(expected, states.shape), rtol=1e-14, atol=1e-14)


def test_a_table_is_kept_as_it_was_given_and_equal_transcriptions_have_the_same_guess():
    table = {"time": TIMES, "angle": np.zeros(3), "rate": np.zeros(3)}
    given = al.Simultaneous(guess=table)
    table["angle"] += 1.0
    transcribed = transcribe(swing_up(10), given)
    assert not transcribed.program.start[transcribed.layout.numbers.states].any()
    assert al.Simultaneous() == al.Simultaneous()
    assert al.Simultaneous(guess=turning) != al.Simultaneous()


@pytest.mark.slow
def test_a_solution_by_shooting_gives_each_realisation_its_own_simulation():
    """On another grid: the states are those of the pendulum simulated with the solution's torque."""
    simulated = al.solve(turned(20), accuracy=0.1, between=1)
    states, _ = states_at_start(turned(30), simulated)
    exact = transcribe(turned(240)).outputs(simulated.vector)
    for k, name in enumerate(("angle", "rate")):
        np.testing.assert_allclose(states[:, ::2, k], np.asarray(exact[name])[:, ::8], atol=5e-3)
    assert np.ptp(states[:, :, 0], axis=0).max() > 0.01  # pendulums of different lengths swing differently


@pytest.mark.slow
def test_realisations_start_from_the_nearest_ones_or_from_the_mean():
    robust = al.solve(turned(), transcription=al.Simultaneous(), accuracy=0.1, between=1)
    same, _ = states_at_start(turned(), robust)
    known = np.stack(list(robust.states.values.values()), axis=2)
    np.testing.assert_allclose(same, known, atol=1e-12)
    third, _ = states_at_start(turned(expansion=al.Expansion(order=3)), robust)
    assert max(np.abs(known - one).max(axis=(1, 2)).min() for one in third) < 1e-12
    plain, _ = states_at_start(al.deterministic(turned()), robust)
    np.testing.assert_allclose(plain[0], known.mean(axis=0), atol=1e-12)
    mean = al.solve(al.deterministic(turned()), transcription=al.Simultaneous(), accuracy=0.1, between=1)
    spread, _ = states_at_start(turned(), mean)
    expected = np.stack(list(mean.states.values.values()), axis=2)
    np.testing.assert_allclose(spread, np.broadcast_to(expected, spread.shape), atol=1e-12)


@pytest.fixture(scope="module")
def moved():
    return al.solve(move(intervals=10), transcription=al.Simultaneous(), between=1)


def test_decisions_that_a_solution_has_are_where_a_program_starts(moved):
    """The force in another spline is fitted; a decision of another name keeps its own start."""
    more = {"force": al.BSpline(al.Decision(np.zeros(9), -50.0, 50.0), degree=3)}
    problem = move(al.Decision(1.0, 0.5, 2.0), 10, inputs=more)
    given = al.Simultaneous(guess=moved)
    first = problem.placements.named(given.first(problem))
    assert first["mass"] == 1.0
    assert first["inputs.force.free"][[0, -1]] == pytest.approx([6.0, -6.0], rel=1e-6)  # the push is 6 - 12 t
    transcribed = transcribe(problem, given)
    np.testing.assert_array_equal(transcribed.decisions(transcribed.program.start), given.first(problem))
    # On the same grid each realisation begins at the states of the solution.
    states, times = states_at_start(move(intervals=10), moved)
    np.testing.assert_allclose(states[0, :, 0], 3 * times**2 - 2 * times**3, atol=1e-6)


def test_a_guess_is_no_answer(moved):
    """Whatever the guess was, the model is judged: here it is stopped before it could move."""
    problem, guess = swing_up(10), al.Simultaneous(guess=turning)
    found = al.solve(problem, al.solvers.Ipopt(max_iterations=1), transcription=guess, throw=False, between=1)
    assert not found.ok
    assert found.certificate.violation > 1e-3


REFUSED = {
    "a number": (3.0, r"guess: expected a function of time, a table with 'time' and each state, or a Solution"),
    "a table without instants": ({"angle": [0.0, 1.0]}, r"expected the instants of a table as 'time'"),
    "instants that go back": ({"time": [0.0, 2.0, 1.0]}, r"'time': expected .* in ascending order"),
    "too few values": ({"time": TIMES, "angle": [0.0, 1.0]}, r"'angle': expected a value for each of 3 instants"),
    "a table that ends early": (
        {"time": TIMES / 2, **COLUMNS},
        r"expected a table from 0 to 3 s, .* received one from 0 to 1\.5 s",
    ),
    "a state that is missing": (
        {"time": TIMES, "angle": np.zeros(3)},
        r"expected all of \['angle', 'rate'\]; received none for \['rate'\]",
    ),
    "an unknown state": (lambda t: {"angel": t, "rate": t}, r"there is no state 'angel'.*Did you mean 'angle'\?"),
    "a wrong shape": (lambda t: {"angle": [t, t], "rate": t}, r"'angle': expected one number; received \[0\.0, 0\.0\]"),
    "not a number": (
        {"time": TIMES, "angle": [0.0, np.nan, 1.0], "rate": np.zeros(3)},
        r"at t = .* s, 'angle': expected finite numbers",
    ),
    "text": (lambda t: {"angle": "up", "rate": t}, r"'angle': expected real numbers; received 'up'"),
    "too few states": (lambda t: (t,), r"expected the states 'angle', 'rate', by name or in that order"),
    "nothing": (lambda t: None, r"expected the states 'angle', 'rate', by name or in that order; received None"),
    "a function that fails": (lambda t: 1 / 0, r"guess raised ZeroDivisionError at t = 0 s: division by zero"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_guess_is_refused_in_one_sentence(name):
    guess, sentence = REFUSED[name]
    with pytest.raises(al.ProblemError, match=sentence):
        al.solve(swing_up(10), transcription=al.Simultaneous(guess=guess))


def test_solutions_with_other_states_or_without_finite_ones_are_refused(moved):
    with pytest.raises(al.ProblemError, match=r"a solution of a system with the states 'angle', 'rate'; received one"):
        al.solve(swing_up(10), transcription=al.Simultaneous(guess=al.solve(gain_problem())))
    missing = {name: np.full_like(one, np.nan) for name, one in moved.states.values.items()}
    broken = replace(moved, states=replace(moved.states, values=missing))
    with pytest.raises(al.ProblemError, match="a solution with finite states"):
        al.solve(move(), transcription=al.Simultaneous(guess=broken))
