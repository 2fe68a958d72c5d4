"""The nonlinear program: objective, constraints, bounds, derivatives and typical magnitudes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from aleator._core.border import shown
from aleator._core.errors import ProblemError
from aleator.nlp._matrices import Matrix, SparseMatrix, check_sparsity, entries, rows_of_entries


class Evaluation(NamedTuple):
    """Objective, constraints and their first derivatives at one point, from one call of the model.

    - `objective`: `f(x)`, a number;
    - `gradient`: `∂f/∂x`, shape (n,);
    - `constraints`: `c(x)`, shape (m,);
    - `jacobian`: `∂c/∂x`, shape (m, n): dense, or a `scipy.sparse.csr_array` if the program declares its sparsity.
    """

    objective: float
    gradient: np.ndarray
    constraints: np.ndarray
    jacobian: Matrix

    @property
    def is_finite(self) -> bool:
        """Whether every number is finite, as solvers need."""
        numbers = self.gradient, self.constraints, entries(self.jacobian)
        return bool(np.isfinite(self.objective) and all(np.isfinite(part).all() for part in numbers))


class Hessian(NamedTuple):
    """The lower triangle of the second derivatives of the Lagrangian `w f(x) + λᵀ c(x)`.

    - `evaluate`: returns it as a `scipy.sparse.csr_array` at `x` of shape (n,), for a weight `w` of the objective and
      multipliers `λ` of shape (m,), in the user's units;
    - `sparsity`: a `csr_array` of shape (n, n) of the entries that may be nonzero, the same for all results.
    """

    evaluate: Callable[[np.ndarray, float, np.ndarray], SparseMatrix]
    sparsity: SparseMatrix


class Magnitudes(NamedTuple):
    """How large the constraints are at a point, in user units, shape (m,) each.

    - `size`: the magnitude to which a violation is relative, whatever the solver's scale;
    - `scale`: the recommended scale for a solver that continues from here.
    """

    size: np.ndarray
    scale: np.ndarray


@final
@dataclass(frozen=True)
class NonlinearProgram:
    """Minimise `f(x)` subject to `constraint_lower <= c(x) <= constraint_upper` and `lower <= x <= upper`.

    Everything is in the user's units; the solvers scale inside.

    - `evaluate`: returns the `Evaluation` at `x` of shape (n,). Non-finite numbers in it mean "cannot be evaluated
      here", and solvers step back; an exception ends the solve and reaches its caller;
    - `start`: initial variables, shape (n,);
    - `lower`, `upper`: bounds of the variables, shape (n,), infinite if there is none, equal to fix a variable;
    - `constraint_lower`, `constraint_upper`: bounds of the constraints, shape (m,), infinite if there is none,
      equal for an equality;
    - `constraint_scale`: typical magnitudes by which solvers divide the constraints at first, shape (m,), positive;
    - `variable_scale`: typical magnitudes of the variables, shape (n,), positive;
    - `sparsity`: the entries of the Jacobian that may be nonzero, shape (m, n); all by default. A dense array of truth
      values is a guess: solvers that use it detect entries outside it. A `scipy.sparse.csr_array` is the sparsity of
      every Jacobian, which then is sparse too: no dense array of size m x n is ever made;
    - `hessian`: second derivatives, if known; all solvers but `Slsqp` use them;
    - `magnitudes`: gives those of the constraints at a point `x` with its evaluation. Feasibility is judged by them,
      not by the solver's scale. By default `constraint_scale`, as size and as scale, at every point;
    - `values`: the objective, shape (k,), and the constraints, shape (k, m), at points of shape (k, n), without
      derivatives; NaN where the model cannot be evaluated. For searches, which call `evaluate` where it is None;
    - `least`: a lower bound of the objective, such as 0 for a norm: a point that attains it is optimal, even at a kink.
      Minus infinity if none is known.

    Raises `ProblemError` if shapes differ, bounds cross, scales are not positive or the start is not finite.
    """

    evaluate: Callable[[np.ndarray], Evaluation]
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    constraint_lower: np.ndarray
    constraint_upper: np.ndarray
    constraint_scale: np.ndarray
    variable_scale: np.ndarray
    sparsity: Matrix | None = None
    hessian: Hessian | None = None
    magnitudes: Callable[[np.ndarray, Evaluation], Magnitudes] | None = None
    least: float = -np.inf
    values: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None

    def __post_init__(self) -> None:
        for name, length in _expected_lengths(self).items():
            array = np.array(getattr(self, name), dtype=float)
            if array.shape != (length,):
                raise ProblemError(f"Expected `{name}` of shape ({length},). Received shape {array.shape}.")
            object.__setattr__(self, name, array)
        shape = (self.constraint_lower.size, self.start.size)
        if isinstance(self.sparsity, np.ndarray) and self.sparsity.shape != shape:
            raise ProblemError(f"Expected `sparsity` of shape {shape}. Received shape {self.sparsity.shape}.")
        if self.sparsity is not None and not isinstance(self.sparsity, np.ndarray):
            check_sparsity("sparsity", self.sparsity, shape)
        if self.hessian is not None:
            _check_lower_triangle(self.hessian, self.start.size)
        _check_bounds("lower", "upper", self.lower, self.upper)
        _check_bounds("constraint_lower", "constraint_upper", self.constraint_lower, self.constraint_upper)
        _check_positive("variable_scale", self.variable_scale)
        _check_positive("constraint_scale", self.constraint_scale)
        if not np.isfinite(self.start).all():
            raise ProblemError(f"Expected a finite `start`; received {shown(self.start)}.")


def _expected_lengths(program: NonlinearProgram) -> dict[str, int]:
    variables, constraints = np.size(program.start), np.size(program.constraint_lower)
    return {
        "start": variables,
        "lower": variables,
        "upper": variables,
        "variable_scale": variables,
        "constraint_lower": constraints,
        "constraint_upper": constraints,
        "constraint_scale": constraints,
    }


def _check_lower_triangle(hessian: Hessian, size: int) -> None:
    sparsity = hessian.sparsity
    check_sparsity("hessian", sparsity, (size, size))
    if np.any(sparsity.indices > rows_of_entries(sparsity)):
        raise ProblemError("Expected the lower triangle of `hessian` alone; received entries above its diagonal.")


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
