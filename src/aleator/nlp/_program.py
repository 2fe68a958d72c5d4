"""The nonlinear program: what is minimised, subject to what, and how large its numbers typically are."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from aleator._core.errors import ProblemError


class Evaluation(NamedTuple):
    """Objective, constraints and their first derivatives at one point, from one call of the model.

    - `objective`: `f(x)`, a number;
    - `gradient`: `∂f/∂x`, shape (n,);
    - `constraints`: `c(x)`, shape (m,);
    - `jacobian`: `∂c/∂x`, dense, shape (m, n).
    """

    objective: float
    gradient: np.ndarray
    constraints: np.ndarray
    jacobian: np.ndarray

    @property
    def is_finite(self) -> bool:
        """Whether every number is finite: a solver can use nothing less."""
        return bool(np.isfinite(self.objective) and all(np.isfinite(part).all() for part in self[1:]))


class Magnitudes(NamedTuple):
    """How large the constraints are at a point, in user units, shape (m,) each.

    - `size`: the magnitude to which a violation is relative, whatever a solver divides by;
    - `scale`: what a solver had best divide by from here on.
    """

    size: np.ndarray
    scale: np.ndarray


@final
@dataclass(frozen=True)
class NonlinearProgram:
    """Minimise `f(x)` subject to `constraint_lower <= c(x) <= constraint_upper` and `lower <= x <= upper`.

    Everything is in the user's units; the solvers scale inside.

    - `evaluate`: gives the `Evaluation` at `x` of shape (n,). Non-finite numbers in it mean "cannot be evaluated
      here", and solvers step back; an exception ends the solve and reaches its caller;
    - `start`: initial decisions, shape (n,);
    - `lower`, `upper`: bounds of the decisions, shape (n,), infinite where there is none, equal to fix a decision;
    - `constraint_lower`, `constraint_upper`: bounds of the constraints, shape (m,), infinite where there is none,
      equal for an equality;
    - `constraint_scale`: what solvers divide the constraints by at first, shape (m,), positive: typical magnitudes;
    - `decision_scale`: typical magnitudes of the decisions, shape (n,), positive;
    - `structure`: which entries of the Jacobian may be other than zero, shape (m, n); all by default. Solvers that use
      it notice where it was too narrow;
    - `magnitudes`: those of the constraints at a point `x` with its evaluation: by them, and not by what a solver
      divided by, an answer is judged feasible. By default `constraint_scale`, as size and as scale, at every point;
    - `least`: a value below which the objective cannot fall, such as 0 for a norm: there it is optimal, even if it
      has a kink. Minus infinity where none is known.

    Raises `ProblemError` if shapes differ, bounds cross, scales are not positive or the start is not finite.
    """

    evaluate: Callable[[np.ndarray], Evaluation]
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    constraint_lower: np.ndarray
    constraint_upper: np.ndarray
    constraint_scale: np.ndarray
    decision_scale: np.ndarray
    structure: np.ndarray | None = None
    magnitudes: Callable[[np.ndarray, Evaluation], Magnitudes] | None = None
    least: float = -np.inf

    def __post_init__(self) -> None:
        for name, length in _expected_lengths(self).items():
            array = np.array(getattr(self, name), dtype=float)
            if array.shape != (length,):
                raise ProblemError(f"Expected `{name}` of shape ({length},). Received shape {array.shape}.")
            object.__setattr__(self, name, array)
        shape = (self.constraint_lower.size, self.start.size)
        if self.structure is not None and self.structure.shape != shape:
            raise ProblemError(f"Expected `structure` of shape {shape}. Received shape {self.structure.shape}.")
        _check_bounds("lower", "upper", self.lower, self.upper)
        _check_bounds("constraint_lower", "constraint_upper", self.constraint_lower, self.constraint_upper)
        _check_positive("decision_scale", self.decision_scale)
        _check_positive("constraint_scale", self.constraint_scale)
        if not np.isfinite(self.start).all():
            raise ProblemError(f"Expected a finite `start`. Received {self.start}.")


def _expected_lengths(program: NonlinearProgram) -> dict[str, int]:
    decisions, constraints = np.size(program.start), np.size(program.constraint_lower)
    return {
        "start": decisions,
        "lower": decisions,
        "upper": decisions,
        "decision_scale": decisions,
        "constraint_lower": constraints,
        "constraint_upper": constraints,
        "constraint_scale": constraints,
    }


def _check_bounds(lower_name: str, upper_name: str, lower: np.ndarray, upper: np.ndarray) -> None:
    possible = (lower <= upper) & (lower < np.inf) & (upper > -np.inf)
    if not possible.all():
        first = int(np.flatnonzero(~possible)[0])
        raise ProblemError(
            f"Expected `{lower_name}` <= `{upper_name}`. Received {lower[first]} and {upper[first]} at index {first}."
        )


def _check_positive(name: str, scale: np.ndarray) -> None:
    valid = np.isfinite(scale) & (scale > 0)
    if not valid.all():
        first = int(np.flatnonzero(~valid)[0])
        raise ProblemError(f"Expected `{name}` positive and finite. Received {scale[first]} at index {first}.")
