"""Guesses of states: where simultaneous programs start whose simulation at the initial decisions is useless."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from collocated_problems import crane
from test_direct_collocation import move
from test_known_optima import Bead, cycloid_time, spline

import aleator as al
from aleator.transcription import transcribe
from tiny_models import oscillator_problem


class Pendulum(al.System):
    """A point mass of a kilogram on a rod, turned by a torque."""

    states = ("angle", "rate")

    length: Any = 1.0

    def rhs(self, t, z, torque):
        return z.rate, torque / self.length**2 - 9.81 / self.length * jnp.sin(z.angle)

    def outputs(self, t, z, torque):
        return {"angle": z.angle, "rate": z.rate, "torque²": torque**2}


DURATION = 3.0


def swing_up(intervals: int = 80, length: Any = 1.0, high: float = 5.0, **options: Any) -> al.Problem:
    """From rest below to rest above, by torques that cannot hold the pendulum level: at rest nothing happens at all."""
    defaults: dict[str, Any] = {
        "grid": al.Grid(DURATION, intervals),
        "inputs": {"torque": al.BSpline(al.Decision(np.zeros(40), -high, high), degree=3)},
        "minimize": al.integral("torque²").mean,
        "subject_to": [al.terminal("angle").mean.equals(np.pi), al.terminal("rate").mean.equals(0.0)],
    }
    return al.Problem(Pendulum(length), **(defaults | options))


def turning(t: float) -> dict[str, float]:
    """Half a turn at a constant rate."""
    return {"angle": np.pi * t / DURATION, "rate": np.pi / DURATION}


def brachistochrone() -> al.Problem:
    """At the initial decisions the wire is level, so that the bead never moves."""
    return al.Problem(
        Bead(),
        grid=al.Grid(al.Decision(2.0, 0.5, 10.0), 30),
        inputs={"angle": spline(np.full(12, np.pi / 2), 0.0, np.pi, degree=3)},
        minimize=al.objectives.final_time(),
        subject_to=[al.terminal("x").mean.equals(10.0), al.terminal("y").mean.equals(-5.0)],
    )


def solved(problem: al.Problem, guess: Any = None, **options: Any) -> al.Solution:
    way = al.Simultaneous(al.schemes.GaussLegendre(2), guess=guess)
    return al.solve(problem, transcription=way, between=1, throw=False, accuracy=0.1, **options)


def states_at_start(problem: al.Problem, guess: Any) -> tuple[np.ndarray, np.ndarray]:
    """The states of all realisations at the first point of a program, and the instants, s."""
    found = transcribe(problem, al.Simultaneous(guess=guess))
    states = found.states_at(found.program.start)
    assert states is not None
    return np.stack(list(states.values.values()), axis=2), states.times


def test_a_brachistochrone_whose_simulation_rests_is_found_in_fewer_iterations_from_a_straight_line():
    problem = brachistochrone()
    found = solved(problem, lambda t: {"x": 5.0 * t, "y": -2.5 * t, "v": 5.0 * t})
    assert found.ok
    assert found.objective == pytest.approx(cycloid_time(10.0, 5.0), rel=1e-6)
    assert found.effort.iterations < solved(problem).effort.iterations


@pytest.fixture(scope="module")
def swung():
    return solved(swing_up(), turning)


@pytest.mark.slow
def test_a_swing_up_takes_fewer_iterations_from_a_guess_and_fewer_still_from_a_solution(swung):
    scratch = solved(swing_up())
    assert swung.ok
    assert swung.objective == pytest.approx(scratch.objective, rel=1e-6)
    again, warm, finer = solved(swing_up(), swung), solved(swing_up(), warm_start=swung), solved(swing_up(120), swung)
    for one in (again, warm, finer):
        assert one.ok
        assert one.objective == pytest.approx(swung.objective, rel=1e-3)
        assert one.effort.iterations < swung.effort.iterations
    assert 3 * swung.effort.iterations < scratch.effort.iterations


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
    same, _ = states_at_start(problem, turning)
    np.testing.assert_allclose(states, same, rtol=1e-14, atol=1e-14)
    expected = np.stack([np.pi * times / DURATION, np.full(len(times), np.pi / DURATION)], axis=1)
    np.testing.assert_allclose(states, np.broadcast_to(expected, states.shape), rtol=1e-14, atol=1e-14)


def test_a_table_is_kept_as_it_was_given():
    table = {"time": TIMES, "angle": np.zeros(3), "rate": np.zeros(3)}
    way = al.Simultaneous(guess=table)
    table["angle"] += 1.0
    transcribed = transcribe(swing_up(4), way)
    assert not transcribed.program.start[transcribed.layout.numbers.states].any()


def test_states_of_a_solution_are_those_of_its_realisations():
    """A block that is pushed from rest moves by its gain, which is `2 + 0.6 xi`."""
    solution = al.solve(move(gain=al.Uniform(2.0, half_width=0.6)), transcription=al.Simultaneous())
    gains = 2.0 + 0.6 * solution.states.germs[:, 0]
    x = solution.states["x"]
    np.testing.assert_allclose(x / gains[:, None], np.broadcast_to(x[0] / gains[0], x.shape), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(solution.states.times[[0, -1]], [0.0, 1.0])
    with pytest.raises(al.ProblemError, match=r"expected one of \['x', 'v'\]; received 'w'"):
        solution.states["w"]
    assert al.solve(move()).states is None


@pytest.mark.slow
def test_a_solution_by_shooting_gives_each_realisation_its_own_simulation():
    """On another grid, with other knots: the states are those of the crane simulated with the solution's force."""
    simulated = al.solve(crane(20), accuracy=0.1)
    problem = crane(30)
    states, _ = states_at_start(problem, simulated)
    usual = transcribe(crane(240))
    exact = usual.outputs(simulated.vector)
    for k, name in enumerate(("x", "v", "angle", "rate")):
        np.testing.assert_allclose(states[:, ::2, k], exact[name][:, ::8], atol=5e-3)
    assert np.ptp(states[:, :, 2], axis=0).max() > 0.01  # ropes of different lengths swing differently


@pytest.mark.slow
def test_realisations_start_from_the_nearest_ones_or_from_the_mean():
    robust = al.solve(crane(), transcription=al.Simultaneous(), accuracy=0.1)
    same, _ = states_at_start(crane(), robust)
    known = np.stack(list(robust.states.values.values()), axis=2)
    np.testing.assert_allclose(same, known, atol=1e-12)
    third, _ = states_at_start(crane(expansion=al.Expansion(order=3)), robust)
    distances = [np.abs(known - one).max(axis=(1, 2)).min() for one in third]
    assert max(distances) < 1e-12
    plain, _ = states_at_start(al.deterministic(crane()), robust)
    np.testing.assert_allclose(plain[0], known.mean(axis=0), atol=1e-12)
    mean = al.solve(al.deterministic(crane()), transcription=al.Simultaneous(), accuracy=0.1)
    spread, _ = states_at_start(crane(), mean)
    expected = np.stack(list(mean.states.values.values()), axis=2)
    np.testing.assert_allclose(spread, np.broadcast_to(expected, spread.shape), atol=1e-12)


def test_decisions_that_a_solution_has_are_where_a_program_starts(swung):
    """The torque in another spline is fitted; a decision of another name keeps its own start, or what is given."""
    more = {"torque": al.BSpline(al.Decision(np.zeros(79), -5.0, 5.0), degree=3)}
    problem = swing_up(length=al.Decision(1.0, 0.5, 2.0), inputs=more)
    way = al.Simultaneous(guess=swung)
    first = problem.placements.named(way.first(problem))
    assert first["length"] == 1.0
    free = next(value for name, value in first.items() if name != "length")
    assert np.abs(free).max() > 1.0
    transcribed = transcribe(problem, way)
    np.testing.assert_array_equal(transcribed.decisions(transcribed.program.start), way.first(problem))


def test_a_guess_is_no_answer(swung):
    """Whatever the guess was, the model is judged: here it is stopped before it could move."""
    found = solved(swing_up(), turning, solver=al.solvers.Ipopt(max_iterations=1))
    assert not found.ok
    assert found.certificate.violation > 1e-3


def test_equal_transcriptions_have_the_same_guess():
    assert al.Simultaneous() == al.Simultaneous()
    assert al.Simultaneous(guess=turning) != al.Simultaneous()


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
        al.solve(swing_up(4), transcription=al.Simultaneous(guess=guess))


def test_a_solution_with_other_states_is_refused():
    other = al.solve(oscillator_problem(), throw=False)
    with pytest.raises(al.ProblemError, match=r"a solution of a system with the states 'angle', 'rate'; received one"):
        al.solve(swing_up(4), transcription=al.Simultaneous(guess=other))


def test_a_solution_that_is_not_finite_is_refused(swung):
    missing = {name: np.full_like(one, np.nan) for name, one in swung.states.values.items()}
    broken = replace(swung.states, values=missing)
    with pytest.raises(al.ProblemError, match="a solution with finite states"):
        al.solve(swing_up(4), transcription=al.Simultaneous(guess=replace(swung, states=broken)))
