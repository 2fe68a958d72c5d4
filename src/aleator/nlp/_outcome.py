"""How a solve ended: the point, its multipliers and the certificate."""

import enum
from dataclasses import dataclass
from typing import final

import numpy as np

from aleator.nlp._program import Evaluation


@final
class Status(enum.Enum):
    """How a solve ended; the value is a phrase to be read."""

    SOLVED = "solved: feasible and stationary within tolerance"
    INFEASIBLE = "infeasible: the constraints cannot all be met near here"
    ITERATION_LIMIT = "stopped at the iteration limit"
    EVALUATION_FAILED = "the model gave numbers that are not finite"
    INTERRUPTED = "interrupted by the user"
    FAILED = "the solver gave up before reaching a solution"


@final
@dataclass(frozen=True)
class Outcome:
    """The end of a solve, in the user's units.

    Signs follow the Lagrangian `f + multipliers @ c + bound_multipliers @ x`: a multiplier is >= 0 where the
    upper bound is active and <= 0 where the lower one is, so the optimal objective changes by `-multiplier`
    per unit of the active bound.

    Attributes:
        status: how it ended, judged from the certificate and not only from the solver's word.
        decisions: `x`, shape (n,). The least violated point seen where the status is INFEASIBLE; the best
            where it is INTERRUPTED.
        evaluation: the model's values and derivatives at `decisions`.
        multipliers: of the constraints, shape (m,), units of objective per constraint.
        bound_multipliers: of the decisions' bounds, shape (n,), units of objective per decision.
        violation: largest violation of a constraint or bound over its scale, dimensionless.
        stationarity: largest scaled component of the Lagrangian's gradient, over the largest multiplier if
            above 1.
        complementarity: largest scaled product of a multiplier and its slack, over the largest multiplier if
            above 1.
        iterations: the solver's count of iterations.
        evaluations: number of points at which `evaluate` was called.
        seconds: wall-clock time.
        solver: its name and version.
        message: what the solver itself said, followed by our objection where the status differs.

    """

    status: Status
    decisions: np.ndarray
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
    failed_at: np.ndarray | None = None

    @property
    def ok(self) -> bool:
        """Whether the program was solved."""
        return self.status is Status.SOLVED
