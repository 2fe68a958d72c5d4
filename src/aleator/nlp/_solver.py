"""Solvers of nonlinear programs: what is asked of each of them."""

import abc
from dataclasses import dataclass

import numpy as np

from aleator._core import given
from aleator._core.errors import ProblemError
from aleator.nlp._outcome import Outcome
from aleator.nlp._program import NonlinearProgram


@dataclass(frozen=True)
class AbstractSolver(abc.ABC):
    """Solves nonlinear programs.

    - `tolerance`: the largest Karush-Kuhn-Tucker residual of an `Outcome` that counts as solved; a violation must also
      be at most a millionth.
    """

    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        given.positive(f"{type(self).__name__}: tolerance", self.tolerance, below=1.0)

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

        Raises `ProblemError` if `start` or `multipliers` have the wrong shape or are not finite, `MissingExtraError`
        if the solver's library is not installed, and any exception of `program.evaluate` except `KeyboardInterrupt`,
        which ends the solve with `Status.INTERRUPTED`.
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


def checked(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A finite array of the expected shape. Raises `ProblemError`."""
    array = np.array(value, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise ProblemError(f"Expected finite `{name}` of shape {shape}. Received shape {array.shape}: {array}.")
    return array
