"""Solvers of nonlinear programs: what is asked of each of them, its outcome, and the history of its search."""

import abc
import enum
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core import border
from aleator._core.leaves import Drawn
from aleator.nlp._program import Evaluation, NonlinearProgram


@final
@dataclass(frozen=True)
class Searched(Drawn):
    """What a search, or a local solver, evaluated in order. Of a search: before its best point was polished.

    - `method`: its name and version;
    - `objectives`: shape (evaluations,), in the unit of the objective; NaN where the model could not be evaluated;
    - `violations`: the largest of each point, relative to the constraints' magnitudes, shape (evaluations,);
    - `end`: why it ended, in words; `seconds`: wall-clock time.
    """

    method: str
    objectives: Float[np.ndarray, " evaluations"]
    violations: Float[np.ndarray, " evaluations"]
    end: str
    seconds: float

    @property
    def evaluations(self) -> int:
        """How many points were evaluated."""
        return len(self.objectives)

    def best(self, violation: float = 1e-2) -> Float[np.ndarray, " evaluations"]:
        """The least objective so far among points that violate nothing by more than `violation`; NaN before any."""
        held = np.where(self.violations <= violation, self.objectives, np.nan)
        least = np.fmin.accumulate(held) if len(held) else held
        return np.asarray(least)

    def __str__(self) -> str:
        failed = int(np.isnan(self.objectives).sum())
        said = f", {failed} of them not finite" if failed else ""
        return f"{self.method}: {self.evaluations} evaluations{said} in {self.seconds:.2f} s; {self.end}"


@final
class Status(enum.Enum):
    """How a solve ended; the value is a phrase for users."""

    SOLVED = "solved: feasible and stationary within tolerance"
    INFEASIBLE = "infeasible: the constraints cannot all be met near here"
    ITERATION_LIMIT = "stopped at the iteration limit"
    EVALUATION_FAILED = "the model returned numbers that are not finite"
    INTERRUPTED = "interrupted by the user"
    FAILED = "not solved: the solver stopped at a point that does not meet the tolerance"


@final
@dataclass(frozen=True)
class Outcome:
    """The end of a solve, in the user's units.

    Signs follow the Lagrangian `f + multipliers @ c + bound_multipliers @ x`: a multiplier is >= 0 where the
    upper bound is active and <= 0 where the lower one is, so the optimal objective changes by `-multiplier`
    per unit of the active bound.

    - `status`: how it ended, judged by the certificate and not only by the solver's claim;
    - `point`: `x`, shape (n,). The least violated point seen if the status is INFEASIBLE; the best if it is
      INTERRUPTED or EVALUATION_FAILED;
    - `evaluation`: the model's values and derivatives at `point`;
    - `multipliers`: of the constraints, shape (m,), units of objective per constraint;
    - `bound_multipliers`: of the variables' bounds, shape (n,), units of objective per variable;
    - `violation`, `stationarity`, `complementarity`: see `Certificate`; constraints are divided by their `sizes`, the
      objective so that its terms, or the change of its gradient over a typical magnitude, are one. If the objective is
      even closer to its lower bound (`NonlinearProgram.least`): its distance from that, relative to its change over a
      typical magnitude;
    - `iterations`: the solver's count, over all restarts;
    - `evaluations`: number of points at which `evaluate` was called;
    - `seconds`: wall-clock time;
    - `solver`: its name and version;
    - `message`: that of the solver, with the reason if the status differs from its claim;
    - `active`: whether a constraint is at its bound, shape (m,): its scaled slack is at most 1e-6, or smaller than a
      scaled multiplier above 1e-6; equalities always are;
    - `active_bounds`: the same for the variables, shape (n,); fixed ones always are;
    - `sizes`: the magnitudes of the constraints at `point` to which a violation is relative, in their units,
      shape (m,);
    - `failed_at`: the last point at which the model was not finite, shape (n,), if the status is EVALUATION_FAILED;
      else None;
    - `idle`: variables left at their start that change nothing at the points checked; `blind`: those by which a value
      changes although all of its derivatives by them are zero;
    - `strayed`: whether the search ended where the constraints do not hold and no small step helps, although it had
      seen points where they do: `point` is the best of these, and the status FAILED, since INFEASIBLE would be false;
    - `searched`: the points of a search without derivatives; None if there was none;
    - `visited`: the points of the local solver, over all restarts; None if there was none.
    """

    status: Status
    point: np.ndarray
    evaluation: Evaluation
    multipliers: np.ndarray
    bound_multipliers: np.ndarray
    violation: float
    stationarity: float
    complementarity: float
    iterations: int
    evaluations: int
    seconds: float
    solver: str
    message: str
    active: np.ndarray
    active_bounds: np.ndarray
    sizes: np.ndarray
    failed_at: np.ndarray | None = None
    idle: tuple[int, ...] = ()
    blind: tuple[int, ...] = ()
    strayed: bool = False
    searched: Searched | None = None
    visited: Searched | None = None

    @property
    def ok(self) -> bool:
        """Whether the program was solved."""
        return self.status is Status.SOLVED

    def with_effort_of(self, *others: "Outcome") -> "Outcome":
        """The same outcome with the effort of other solves on the way to it added."""
        every = (*others, self)
        visited = [each.visited for each in every if each.visited is not None]
        return replace(
            self,
            searched=next((each.searched for each in every if each.searched is not None), None),
            visited=replace(
                visited[-1],
                objectives=np.concatenate([one.objectives for one in visited]),
                violations=np.concatenate([one.violations for one in visited]),
                seconds=sum(one.seconds for one in visited),
            )
            if visited
            else None,
            iterations=sum(each.iterations for each in every),
            evaluations=sum(each.evaluations for each in every),
            seconds=sum(each.seconds for each in every),
        )


@dataclass(frozen=True)
class AbstractSolver(abc.ABC):
    """Solves nonlinear programs.

    - `tolerance`: the largest Karush-Kuhn-Tucker residual of an `Outcome` that counts as solved; a violation must also
      be at most a millionth.
    """

    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        border.positive(f"{type(self).__name__}: tolerance", self.tolerance, below=1.0)

    @abc.abstractmethod
    def solve(
        self,
        program: NonlinearProgram,
        *,
        multipliers: np.ndarray | None = None,
        start: np.ndarray | None = None,
    ) -> Outcome:
        """Solve `program`, given in user units; a failed solve returns an outcome with its status.

        - `multipliers`: of the constraints, shape (m,), from an earlier `Outcome`, for a warm start;
        - `start`: replaces `program.start`, shape (n,); clipped to the bounds.

        Raises `MissingExtraError` if the solver's library is not installed, and any exception of `program.evaluate`
        except `KeyboardInterrupt`, which ends the solve with `Status.INTERRUPTED`.
        """

    @property
    @abc.abstractmethod
    def name(self) -> str:
        """Name and version."""

    @property
    def local(self) -> "AbstractSolver":
        """The solver that continues from a good point: itself, unless it searches everywhere."""
        return self

    def require(self) -> None:  # noqa: B027 -- most solvers need nothing beyond the package's own dependencies
        """Raise `MissingExtraError` if the library is not installed."""
