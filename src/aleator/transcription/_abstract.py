"""Abstract transcriptions: a problem's nonlinear program, and the meaning of that program's points."""

import abc
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, NamedTuple, Self, TypeVar, final

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.compilation import Compiled, Use
from aleator.design import Constraint, Problem, functionals_of, history, path_of, statistics_in, variances_by_noise
from aleator.dynamics import Grid
from aleator.expansion import AbstractBasis, Collocation
from aleator.nlp import AbstractSolver, NonlinearProgram, default_solver
from aleator.solution import Costates, MeshError, Solution, States, Switching
from aleator.statistics import Constants
from aleator.transcription._discretised import Discretised, Scenarios
from aleator.transcription._expansions import Resolved, resolved
from aleator.uncertainty import Placements

# The start of a search or its latest point, and the one before.
_KEPT = 2
# Fractions of the duration closer than this are the same, up to rounding.
_SAME = 1e-12

_Result = TypeVar("_Result")


@final
class Remembered(Generic[_Result]):
    """A function of a point that remembers the latest: neither a start nor an answer is computed twice."""

    def __init__(self, function: Callable[[Float[np.ndarray, " n"]], _Result]):
        self._function = function
        self._memory: dict[bytes, _Result] = {}
        self._lock = threading.Lock()

    def __call__(self, point: Float[np.ndarray, " n"]) -> _Result:
        key = point.tobytes()
        with self._lock:
            if key in self._memory:
                return self._memory[key]
        result = self._function(point)
        with self._lock:
            while len(self._memory) >= _KEPT:
                del self._memory[next(iter(self._memory))]
            self._memory[key] = result
        return result


class Meaning(NamedTuple):
    """The meaning of a program's point for its problem.

    - `decisions`: in the order of the problem's placements, shape (n,);
    - `objective`: its value; `constraints`: the rows of each, in order;
    - `samples`: each functional at the collocation points, in the order of `functionals_of`;
    - `tangents`: the derivatives of the samples (of a path at a few instants, see `seen`) by the decisions, along a
      first axis; None if they are not computed, as where no decision is a parameter of a distribution;
    - `statistics`: all statistics in the expressions, in the order of `statistics_in`.
    """

    decisions: Float[np.ndarray, " n"]
    objective: float
    constraints: list[Float[np.ndarray, " rows"]]
    samples: tuple[Float[np.ndarray, "points ..."], ...]
    tangents: tuple[Float[np.ndarray, "n points ..."] | None, ...]
    statistics: tuple[Float[np.ndarray, "..."], ...]


def _outputs_at_points(
    problem: Problem, points: Float[Array, "points variables"], decisions: Float[Array, " n"]
) -> dict[str, Array]:
    return jax.vmap(lambda germ: history(problem, germ, decisions))(points)


OUTPUTS_AT_POINTS = Compiled(_outputs_at_points, use=Use.ONCE)


@dataclass(frozen=True)
class AbstractTranscribed(abc.ABC):
    """A problem as a nonlinear program, the only interface for solving, certifying and reporting.

    - `problem`; `traced`: the same with its numbers as arrays;
    - `discretised`: basis, collocation and constants of its statistics;
    - `program`: in the user's units; its variables are the decisions and any that the transcription adds;
    - `rows`: those of each constraint of the problem within the program, which may have further rows;
    - `scales`: the magnitude of each constraint at the start;
    - `scenarios`: the realisations at which limits on the worst case are imposed; None if there are no such limits.
    """

    problem: Problem
    traced: Problem
    discretised: Discretised
    program: NonlinearProgram
    rows: tuple[slice, ...]
    scales: tuple[float, ...]
    scenarios: Scenarios | None

    @property
    @abc.abstractmethod
    def decided(self) -> Int[np.ndarray, " n"]:
        """Which of the program's variables are the problem's decisions, in the order of its placements."""

    @abc.abstractmethod
    def point(self, decisions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " variables"]:
        """The program's starting point for given decisions: objective and constraints there are the problem's."""

    @abc.abstractmethod
    def at(self, point: Float[np.ndarray, " variables"]) -> Meaning:
        """The meaning of a point. The latest points are remembered."""

    @abc.abstractmethod
    def times(self, point: Float[np.ndarray, " variables"]) -> Float[np.ndarray, " instants"]:
        """The instants of the grid at a point, s: those at the means, where each realisation has its own."""

    @abc.abstractmethod
    def at_scenarios(self, scenarios: Scenarios) -> Self:
        """The same problem with its limits on the worst case imposed at other scenarios."""

    def limited(self, path: str) -> Float[np.ndarray, " limited"]:
        """Where limits over time on an output are imposed, as fractions of the duration, or of that of its phase: at
        the instants of the grid, and on a mesh at its nodes between these.
        """
        grid = self.problem.grid.of(path)
        return grid.fractions if isinstance(grid, Grid) else np.zeros(1)

    def declared(self, path: str) -> Int[np.ndarray, " instants"]:
        """Which of the places in `limited` are the instants of the grid."""
        grid = self.problem.grid.of(path)
        return (
            np.searchsorted(self.limited(path), grid.fractions - _SAME) if isinstance(grid, Grid) else np.zeros(1, int)
        )

    def at_instants(self, limit: Constraint, rows: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " some"]:
        """The rows of a limit without those between the instants of the grid."""
        path = path_of(limit)
        return rows.reshape(len(self.limited(path)), -1)[self.declared(path)].ravel() if path else rows

    def times_limited(self, point: Float[np.ndarray, " variables"], path: str) -> Float[np.ndarray, " limited"]:
        """The places in `limited` as times, s."""
        limited, times = self.limited(path), self.times(point)[self.problem.grid.where(path)]
        return np.interp(limited, limited[self.declared(path)], times)

    @property
    def fineness(self) -> int:
        """How many steps of a simulation, for each of the problem's grid, are as accurate as this program."""
        return 1

    def meshes_at(self, point: Float[np.ndarray, " variables"]) -> tuple[MeshError, ...]:
        """The meshes up to this program's own and their errors, at a point of it; none where states are simulated."""
        del point
        return ()

    def states_at(self, point: Float[np.ndarray, " variables"]) -> States | None:
        """The states at a point of the program; None where they are simulated."""
        del point
        return None

    def costates_at(
        self, point: Float[np.ndarray, " variables"], multipliers: Float[np.ndarray, " rows"]
    ) -> tuple[Costates, Switching] | tuple[None, None]:
        """The costates at a point with multipliers of the program's rows, and the switching functions; None where
        states are simulated.
        """
        del point, multipliers
        return None, None

    def crossed_at(self, point: Float[np.ndarray, " variables"]) -> str:
        """A sentence on a realisation that does not end where the event of its grid first happens; empty if all do."""
        del point
        return ""

    def refined(self, point: Float[np.ndarray, " variables"]) -> tuple[Self, Float[np.ndarray, " variables"]] | None:
        """The problem on a finer mesh, and the point there that a point of this program stands for.

        None where the mesh is fine enough, or there is none.
        """
        del point
        return None

    def decisions(self, point: Float[np.ndarray, " variables"]) -> Float[np.ndarray, " n"]:
        """The problem's decisions at a point, or their part of any vector of the program's variables."""
        return point[self.decided]

    @property
    def places(self) -> Placements:
        """The problem's decisions and distributions."""
        return self.problem.placements

    @property
    def basis(self) -> AbstractBasis:
        """The polynomials of the expansion."""
        return self.discretised.basis

    @property
    def collocation(self) -> Collocation:
        """The collocation points with the map from samples to coefficients."""
        return self.discretised.collocation

    @property
    def constants(self) -> Constants:
        """The constants of the problem's statistics."""
        return self.discretised.constants

    @property
    def points(self) -> Float[np.ndarray, "points variables"]:
        """All germ points at which the model is simulated: the collocation points, then the scenarios."""
        points = np.asarray(self.collocation.points)
        return points if self.scenarios is None else np.concatenate([points, self.scenarios.points])

    def outputs(self, decisions: Float[np.ndarray, " n"]) -> dict[str, Array]:
        """Histories of all outputs at all `points`, simulated."""
        return OUTPUTS_AT_POINTS(self.traced, self.points, decisions)

    def statistics(self, point: Float[np.ndarray, " variables"]) -> dict[str, Float[np.ndarray, "..."]]:
        """Every statistic in the problem, by its text."""
        every = statistics_in(self.problem.expressions)
        return {one.text(): values for one, values in zip(every, self.at(point).statistics, strict=True)}

    def resolve(self, point: Float[np.ndarray, " variables"]) -> dict[str, Resolved]:
        """The moments and the quality of each functional's expansion, by its text. The latest are remembered."""
        return self._resolved(point)

    @cached_property
    def _resolved(self) -> Remembered[dict[str, Resolved]]:
        expressions, parameters = self.problem.expressions, [*self.places.of_distributions.values()]
        functionals, noise = functionals_of(expressions), variances_by_noise(expressions)
        scales = self.program.variable_scale[self.decided][parameters]

        def at(point: Float[np.ndarray, " variables"]) -> dict[str, Resolved]:
            tangents = (None if one is None else (one[parameters].T * scales).T for one in self.at(point).tangents)
            parts = dict(zip(functionals, zip(self.at(point).samples, tangents, strict=True), strict=True))
            by_noise = {one: parts[variance] for one, variance in noise.items()}
            noised = {variance: parts[one][0] for one, variance in noise.items()}
            return {
                one.text(): resolved(one, self.collocation, *parts[one], by_noise.get(one), noised.get(one))
                for one in parts
            }

        return Remembered(at)


Meanwhile = Callable[[Problem, Discretised], Callable[[], object]]
"""A function that is called just before a problem is compiled, to begin work in parallel."""


@dataclass(frozen=True)
class AbstractTranscription(abc.ABC):
    """A method of transcribing a problem to a nonlinear program. Equal transcriptions give the same program."""

    @abc.abstractmethod
    def transcribed(self, problem: Problem, meanwhile: Meanwhile) -> AbstractTranscribed:
        """Transcribe a problem, and compile it unless one of the same structure was compiled before.

        Raises `ProblemError` if it cannot transcribe the problem.
        """

    @property
    def name(self) -> str:
        """Its name, with what tells it from others of its kind."""
        return type(self).__name__

    @property
    def refines(self) -> bool:
        """Whether its programs are to be solved on finer meshes until these are fine enough, see `refined`."""
        return False

    @property
    def is_guessed(self) -> bool:
        """Whether the states of its programs start from a guess, which says nothing about the grid."""
        return False

    def first(self, problem: Problem) -> Float[np.ndarray, " n"]:
        """The decisions at which its programs start: by default the problem's own initial ones."""
        return problem.placements.vector("initial")

    def starting_from(self, solution: Solution) -> "AbstractTranscription":
        """The same way, its programs starting from the states of a solution; itself where states are simulated."""
        del solution
        return self

    @property
    def solver(self) -> AbstractSolver:
        """The solver that its programs suit, where none is given."""
        return default_solver()
