"""The nonlinear program: objective, constraints, bounds, derivatives and typical magnitudes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

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


class Sides(NamedTuple):
    """Lower and upper bounds of some values, shape (k,) each, infinite where there is none."""

    lower: np.ndarray
    upper: np.ndarray

    def excess(self, values: np.ndarray) -> np.ndarray:
        """How far values of shape (..., k) are outside, negative inside."""
        return np.maximum(values - self.upper, self.lower - values)

    def slack(self, values: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """How far each value is from the bound against which its multiplier presses, the upper one if positive."""
        return np.abs(np.where(multipliers > 0, self.upper - values, values - self.lower))

    def within(self, values: np.ndarray, distance: float = np.inf) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The bounds no further than this from their values: places of these, signs, +1 for an upper bound, and gaps.

        A gap is negative where the value is outside.
        """
        gaps = np.concatenate([self.upper - values, values - self.lower])
        near = np.flatnonzero(np.isfinite(gaps) & (np.abs(gaps) <= distance))
        return near % values.size, np.where(near < values.size, 1.0, -1.0), gaps[near]


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
    - `sizes`: the magnitudes of the constraints, shape (m,), at a point `x` with its evaluation, in the user's units:
      violations are relative to them, and solvers continue from there in them. By default `constraint_scale`;
    - `values`: the objective, shape (k,), and the constraints, shape (k, m), at points of shape (k, n), without
      derivatives; NaN where the model cannot be evaluated. For searches, which call `evaluate` where it is None;
    - `least`: a lower bound of the objective, such as 0 for a norm: a point that attains it is optimal, even at a kink.
      Minus infinity if none is known;
    - `breadth`: how many variables are tied from one point of time to the next, where the program is such a chain: the
      order in which sparse matrices are best factorised depends on it.

    Raises `ProblemError` if shapes differ or bounds cross.
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
    sizes: Callable[[np.ndarray, Evaluation], np.ndarray] | None = None
    least: float = -np.inf
    values: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None
    breadth: int = 1

    def __post_init__(self) -> None:
        shape = rows, size = np.size(self.constraint_lower), np.size(self.start)
        lengths = dict.fromkeys(("start", "lower", "upper", "variable_scale"), size)
        lengths |= dict.fromkeys(("constraint_lower", "constraint_upper", "constraint_scale"), rows)
        for name, length in lengths.items():
            array = np.array(getattr(self, name), dtype=float)
            if array.shape != (length,):
                raise ProblemError(f"Expected `{name}` of shape ({length},). Received shape {array.shape}.")
            object.__setattr__(self, name, array)
        if isinstance(self.sparsity, np.ndarray) and self.sparsity.shape != shape:
            raise ProblemError(f"Expected `sparsity` of shape {shape}. Received shape {self.sparsity.shape}.")
        if not isinstance(self.sparsity, np.ndarray | None):
            check_sparsity("sparsity", self.sparsity, shape)
        if self.hessian is not None:
            check_sparsity("hessian", curved := self.hessian.sparsity, (size, size))
            if np.any(curved.indices > rows_of_entries(curved)):
                raise ProblemError("Expected the lower triangle of `hessian`; received entries above its diagonal.")
        for name, (low, high) in (("", (self.lower, self.upper)), ("constraint_", self.limits)):
            for i in np.flatnonzero(~(low <= high)):
                raise ProblemError(
                    f"Expected `{name}lower` <= `{name}upper`. Received {low[i]} and {high[i]} at index {i}."
                )

    def is_least(self, objective: float, tolerance: float) -> bool:
        """Whether an objective is at its lower bound, as far as can be told beside its fall from the start."""
        if not np.isfinite(self.least):
            return False
        return objective - self.least <= tolerance * (self.evaluate(self.start).objective - self.least)

    @property
    def limits(self) -> Sides:
        """The bounds of the constraints."""
        return Sides(self.constraint_lower, self.constraint_upper)
