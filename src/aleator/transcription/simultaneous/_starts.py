"""Where a simultaneous program starts: at states as simulated, or by a guess of them; all else follows from these."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.border import refusal
from aleator._core.compilation import Compiled, Use
from aleator._core.errors import AleatorError, ProblemError, SimulationError
from aleator.design import Problem, deterministic, grid_at, unsolved
from aleator.dynamics import ONLY_STATES, STATES, System, initial_state, named
from aleator.solution import Solution
from aleator.transcription._warm_start import started_from
from aleator.transcription.simultaneous._evaluations import evaluated_at, first_crossing
from aleator.transcription.simultaneous._guesses import (
    WHO,
    Guess,
    OverTime,
    Table,
    flat_states,
    interpolated,
    listed,
    over_time,
)
from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._pointwise import grid_in
from aleator.transcription.simultaneous._program import Assembled
from aleator.uncertainty import realise

# Steps of a simulation in each of the grid: points of a mesh between instants are interpolated.
_FINER = 4
# States that grow by more than this after the first tenth of the time are those of a system that runs away.
_BEGINNING, _MOST_GROWTH = 10, 1e4


class Course(NamedTuple):
    """The states of one phase over the fraction of its duration.

    - `states`: shape (realisations, places, states); `duration`: shape (realisations, 1), s, where an event ends each
      realisation; else nothing, shape (realisations, 0).
    """

    states: Float[np.ndarray, "realisations places states"]
    duration: Float[np.ndarray, "realisations durations"]


def _simulated(
    problem: Problem, points: Float[Array, "realisations germs"], decisions: Float[Array, " n"]
) -> list[tuple[Array, list[Array]]]:
    """The states of each phase at the instants of its grid, and how long it lasts where an event ends it."""

    def one(germ: Array) -> list[tuple[Array, list[Array]]]:
        record, phases = realise(problem.simulation, germ, decisions).record(ONLY_STATES), []
        for phase in problem.simulation.phases:
            (key,), grid = named({phase: {STATES: None}}), record.grid.of(f"{phase}.")
            states = record.history[key] if key in record.history else jnp.zeros((grid.steps + 1, 0))
            phases.append((states, [] if grid.until is None else [jnp.asarray(grid.duration)]))
        return phases

    return jax.vmap(one)(points)


def _resting(
    problem: Problem, points: Float[Array, "realisations germs"], decisions: Float[Array, " n"]
) -> list[Float[Array, "realisations _"]]:
    """The states with which each phase begins if those before it rest."""
    return jax.vmap(lambda germ: realise(problem.simulation, germ, decisions).resting())(points)


SIMULATED, RESTING = Compiled(_simulated, use=Use.BRIEF), Compiled(_resting, use=Use.BRIEF)


@final
@dataclass(frozen=True)
class Start:
    """Where the programs of a problem start, on any mesh: as simulated, or by a guess of the states.

    - `guess`: a function of time, a table as such a function, or one of these for each phase by name; a solution; None
      for a simulation.
    """

    guess: "OverTime | tuple[tuple[str, OverTime], ...] | Solution | None"

    @classmethod
    def of(cls, guess: Guess | None) -> "Start":
        """The start that a guess stands for. Raises `ProblemError` for what is no guess."""
        if guess is None or isinstance(guess, Solution):
            return cls(guess)
        each = guess.values() if isinstance(guess, Mapping) and guess else [None]
        if isinstance(guess, Mapping) and all(callable(one) or isinstance(one, Mapping) for one in each):
            return cls(tuple((name, over_time(one)) for name, one in guess.items()))
        return cls(over_time(guess))

    def decisions(self, problem: Problem) -> Float[np.ndarray, " n"]:
        """The first decisions: those of a solution where it has them, else the problem's own initial ones."""
        if isinstance(self.guess, Solution):
            return started_from(problem, self.guess, needs_all=False)
        return problem.placements.vector("initial")

    def courses(
        self,
        problem: Problem,
        fractions: Sequence[Float[np.ndarray, " _"]],
        points: Float[np.ndarray, "realisations germs"],
        decisions: Float[np.ndarray, " n"],
    ) -> list[Course]:
        """The states of realisations at some fractions of the duration of each phase, for given decisions."""
        if self.guess is None:
            return _simulated_courses(problem, fractions, points, decisions)
        if isinstance(self.guess, Solution):
            return _courses_of(self.guess, problem, fractions, points)
        by_phase = dict(self.guess) if isinstance(self.guess, tuple) else {"": self.guess}
        if by_phase.keys() != (phases := problem.simulation.phases).keys():
            expected = f"one for each of the phases {list(phases)}, by name" if "" not in phases else "one of no phase"
            received = "one of no phase" if "" in by_phase else f"those of {list(by_phase)}"
            raise ProblemError(f"{WHO}: expected {expected}; received {received}.")
        each = zip(phases, fractions, strict=True)
        return [_guessed(by_phase[name], problem, name, some, points, decisions) for name, some in each]


def _simulated_courses(
    problem: Problem,
    fractions: Sequence[Float[np.ndarray, " _"]],
    points: Float[np.ndarray, "realisations germs"],
    decisions: Float[np.ndarray, " n"],
) -> list[Course]:
    """States as they are simulated. If one realisation cannot be simulated at these decisions, or grows beyond reason,
    all rest at their initial states: a program may begin where nothing can be simulated.
    """
    if not problem.is_integrated:
        return [Course(np.zeros((len(points), len(some), 0)), np.zeros((len(points), 0))) for some in fractions]
    finer = numbers_to_arrays(problem.on_grid(problem.grid.finer(_FINER)))
    simulated = [
        (np.array(states), np.array(durations).reshape(len(durations), len(points)).T)
        for states, durations in SIMULATED(finer, points, decisions)
    ]
    if not all(map(_is_reasonable, (states for states, _ in simulated))):
        rest = [states[:, 0] for states, _ in simulated]
        if not all(np.isfinite(one).all() for one in rest):
            rest = [np.asarray(one) for one in RESTING(finer, points, decisions)]
        for i, (phase, (states, duration)) in enumerate(zip(problem.simulation.phases, simulated, strict=True)):
            latest = grid_in(phase, problem.grid).duration if duration.size else 0.0
            simulated[i] = np.repeat(rest[i][:, None], states.shape[1], axis=1), np.full_like(duration, latest)
    return [
        Course(_on_places(np.linspace(0.0, 1.0, states.shape[1]), states, some), duration)
        for (states, duration), some in zip(simulated, fractions, strict=True)
    ]


def _is_reasonable(states: Float[np.ndarray, "realisations instants states"]) -> bool:
    """Whether states are finite and do not run away."""
    begun = np.abs(states[:, : 1 + states.shape[1] // _BEGINNING]).max(axis=(0, 1))
    grown = np.abs(states).max(axis=(0, 1)) > _MOST_GROWTH * np.where(begun > 0, begun, np.inf)
    return bool(np.isfinite(states).all() and not grown.any())


def _on_places(
    known: Float[np.ndarray, " n"], states: Float[np.ndarray, "realisations n states"], at: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "realisations m states"]:
    return np.moveaxis(interpolated(known, np.moveaxis(states, 1, 0), at), 0, 1)


def _guessed(
    function: OverTime,
    problem: Problem,
    phase: str,
    fractions: Float[np.ndarray, " places"],
    points: Float[np.ndarray, "realisations germs"],
    decisions: Float[np.ndarray, " n"],
) -> Course:
    """The states of a phase by a function of time; a realisation ends where these meet the event."""
    grid, shapes = grid_in(phase, grid_at(problem, jax_array(decisions))), state_shapes(problem, phase)
    duration, every = float(grid.duration), len(points)

    def states_at(times: Float[np.ndarray, " times"]) -> Float[np.ndarray, "times states"]:
        if isinstance(function, Table):
            function.refuse_short(times[0], times[-1])
        return np.stack([flat_states(f"{WHO} at t = {t:.4g} s", at(float(t)), shapes) for t in times])

    def at(t: float) -> Any:
        try:
            return function(t)
        except AleatorError:
            raise
        except Exception as error:
            raise ProblemError(f"{WHO} raised {type(error).__name__} at t = {t:.4g} s: {error}.") from error

    begin = float(grid.t_start)
    if grid.until is None:
        return Course(np.repeat(states_at(begin + fractions * duration)[None], every, axis=0), np.zeros((every, 0)))
    at_most, instants = np.full((every, 1), duration), np.linspace(0.0, 1.0, _FINER * grid.steps + 1)
    rows = np.repeat(states_at(begin + instants * duration)[None], every, axis=0)
    levels = levels_at((numbers_to_arrays(problem), phase), points, decisions, instants, Course(rows, at_most))
    direction = direction_of(problem, phase)
    ends = [first_crossing(one, instants, direction) or 1.0 for one in levels]
    states = np.stack(
        [_on_places(instants, one[None], end * fractions)[0] for one, end in zip(rows, ends, strict=True)]
    )
    return Course(states, duration * np.array(ends)[:, None])


def direction_of(problem: Problem, phase: str) -> int:
    """The direction of the event that ends a phase: see `Event`."""
    system = problem.simulation.of(f"{phase}.").system
    assert isinstance(system, System)
    return system.declared_events[grid_in(phase, problem.grid).until or ""].direction


def levels_at(
    source: tuple[Problem, str],
    points: Float[np.ndarray, "realisations germs"],
    decisions: Float[np.ndarray, " n"],
    fractions: Float[np.ndarray, " places"],
    course: Course,
) -> Float[np.ndarray, "realisations places"]:
    """The function of the event that ends a phase along a course of the states, known at some fractions of it."""
    places = np.stack([fractions, np.zeros_like(fractions)], axis=1)
    at = decisions, course.duration, np.zeros((len(places), 0)), course.states
    return evaluated_at("level", source, points, places, *at)[..., 0]


def _courses_of(
    solution: Solution,
    problem: Problem,
    fractions: Sequence[Float[np.ndarray, " _"]],
    points: Float[np.ndarray, "realisations germs"],
) -> list[Course]:
    """The states of a solution over the fraction of its duration: each realisation's from the nearest one there, or
    from the mean of all where other numbers are uncertain.
    """
    old, phases = solution.problem, problem.simulation.phases
    shapes, received = (
        named({phase: state_shapes(one, phase) for phase in one.simulation.phases}) if one.system.has_time else {}
        for one in (problem, old)
    )
    if received != shapes:
        raise ProblemError(
            f"{WHO}: expected a solution of a system with the states {listed(shapes)}; received one with "
            f"{listed(received)}."
        )
    is_alike = old.placements.germ_names == problem.placements.germ_names
    if (known := solution.mesh_states) is None:
        same, at = (old, points) if is_alike else (deterministic(old), np.zeros((1, 0)))
        courses = _simulated_courses(same, fractions, at, solution.vector)
    else:
        nearest = np.array([np.square(known.germs - one).sum(axis=1).argmin() for one in points], dtype=int)

        def chosen(table: np.ndarray) -> np.ndarray:
            return table[nearest] if is_alike else table.mean(axis=0, keepdims=True)

        courses = []
        for phase, some in zip(phases, fractions, strict=True):
            duration = known.durations.get(phase, np.zeros((len(known.germs), 0)))
            courses.append(
                Course(_on_places(known.fractions(phase), chosen(known.rows(phase)), some), chosen(duration))
            )
    if not all(np.isfinite(part).all() for one in courses for part in one):
        raise refusal(WHO, "a solution with finite states", solution.status)
    return [Course(*(np.broadcast_to(part, (len(points), *part.shape[1:])) for part in one)) for one in courses]


def state_shapes(problem: Problem, phase: str = "") -> dict[str, tuple[int, ...]]:
    """The shape of each state of a phase, by name. Nothing is computed."""
    places = problem.placements

    def first(germ: Array, decisions: Array) -> Any:
        whole = realise(problem.simulation, germ, decisions)
        _, realised = whole.traced, whole.of(f"{phase}.")
        system, start = realised.traced, realised.start()
        assert isinstance(system, System)
        assert start is not None
        return initial_state(system, *start)

    germ, decisions = (jax.ShapeDtypeStruct((size,), float) for size in (len(places.germ_names), places.size))
    # The names after tracing: a dict that is traced comes back in alphabetical order.
    return {name: one.shape for name, one in jax.eval_shape(first, germ, decisions)._asdict().items()}


def started(
    traced: Problem,
    layout: Layout,
    assembled: Assembled,
    points: Float[np.ndarray, "realisations germs"],
    decisions: Float[np.ndarray, " n"],
    courses: Sequence[Course],
) -> Float[np.ndarray, " variables"]:
    """The point of a program at some decisions and states of each phase: all else follows from them.

    Raises `SimulationError` where the algebraic variables of a realisation do not follow from its initial state.
    """
    variables, numbers = np.zeros(layout.count), layout.numbers
    variables[numbers.decisions] = decisions
    variables[layout.known] = assembled.known(variables)
    for phase, own, course in zip(layout.phases, numbers.phases, courses, strict=True):
        variables[own.states] = course.states
        if phase.pointwise.is_open:
            variables[own.duration] = course.duration
        if not own.algebraic.size:
            continue
        mesh, duration, signals = phase.mesh, variables[own.duration], variables[own.signals]
        at = decisions[phase.pointwise.direct], duration, signals, course.states[:, mesh.sides]
        algebraic = evaluated_at("algebraic", (traced, phase.name), points, mesh.places, *at)
        if (failed := ~np.isfinite(algebraic[:, 0]).all(axis=1)).any():
            first = int(np.argmax(failed))
            reason = unsolved(traced, jax_array(points[first]), jax_array(decisions))
            raise SimulationError(f"{reason} This is collocation point {first + 1} of {len(points)}.")
        variables[own.algebraic] = algebraic
    # Each is tied to those before it: what is missing from zero is what it stands for, and what an interval adds.
    ties = assembled.rows.ties
    integrals = [own.integrals for own in numbers.phases]
    for some in (np.concatenate([one.ravel() for one in integrals]), *layout.stages[1:]):
        these = np.isin(ties.variables, some)
        # What is NaN here makes no start; the rows that are NaN there say where.
        variables[ties.variables[these]] = np.nan_to_num(-assembled.constraints(variables)[ties.rows][these])
        for one in integrals:
            variables[one] = np.cumsum(variables[one], axis=1)
        integrals = []
    return variables
