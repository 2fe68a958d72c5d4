"""Uno (Vanaret and Leyffer 2026, https://github.com/cvanaret/Uno): its presets, programs and answers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np
from typing_extensions import override

from aleator._core import border
from aleator._core.errors import MissingExtraError, optional
from aleator._core.parallel import take_back
from aleator.nlp._ipopt import Ipopt
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._matrices import Pattern, rows_of_entries
from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import Multipliers, ScaledProgram
from aleator.nlp._solver import Status
from aleator.nlp._verdict import Answer

_CLAIMS = {
    "FEASIBLE_KKT_POINT": Status.SOLVED,
    "INFEASIBLE_STATIONARY_POINT": Status.INFEASIBLE,
    "ITERATION_LIMIT": Status.ITERATION_LIMIT,
    # Outside the main thread, only Uno receives Ctrl-C.
    "USER_INTERRUPTION": Status.INTERRUPTED,
}


def _unopy(who: str) -> Any:
    """The library, imported late. Raises `MissingExtraError` if it is not installed."""
    return optional("unopy", who, "unopy", "al.solvers.Ipopt()")


def _model(unopy: Any, scaled: ScaledProgram, pattern: Pattern, multipliers: np.ndarray | None) -> Any:
    """The scaled program, with second derivatives if it has them."""

    def at(z: np.ndarray) -> Evaluation:
        # Uno installs its own handler of Ctrl-C before Python's, and ends the process at the second one.
        take_back()
        return scaled.evaluate(z)

    def written(part: Callable[[Evaluation], np.ndarray]) -> Callable[[np.ndarray, np.ndarray], None]:
        def write(z: np.ndarray, out: np.ndarray) -> None:
            out[:] = part(at(z))

        return write

    def hessian(z: np.ndarray, weight: float, multipliers: np.ndarray, out: np.ndarray) -> None:
        out[:] = scaled.hessian(z, weight, np.array(multipliers))

    n, m = scaled.size, scaled.rows
    model = unopy.Model(
        unopy.PROBLEM_NONLINEAR, n, scaled.lower.tolist(), scaled.upper.tolist(), unopy.ZERO_BASED_INDEXING
    )
    model.set_objective(unopy.MINIMIZE, lambda z: at(z).objective, written(lambda found: found.gradient))
    model.set_lagrangian_sign_convention(unopy.MULTIPLIER_POSITIVE)
    if m:
        rows, columns = pattern.rows.tolist(), pattern.columns.tolist()
        bounds = scaled.constraint_lower.tolist(), scaled.constraint_upper.tolist()
        entries = len(rows), rows, columns, written(lambda found: pattern.entries(found.jacobian))
        model.set_constraints(m, written(lambda found: found.constraints), *bounds, *entries)
    if scaled.curved is not None:
        rows, columns = rows_of_entries(scaled.curved).tolist(), scaled.curved.indices.tolist()
        model.set_lagrangian_hessian(len(rows), unopy.LOWER_TRIANGLE, rows, columns, hessian)
    model.set_initial_primal_iterate(scaled.start.tolist())
    if m and multipliers is not None:
        model.set_initial_dual_iterate(multipliers.tolist())
    return model


@dataclass(frozen=True)
class _AbstractUno(AbstractLocalSolver):
    """One of Uno's presets."""

    preset: ClassVar[str]
    method: ClassVar[str]

    @override
    def require(self) -> None:
        _unopy(type(self).__name__)

    @property
    @override
    def name(self) -> str:
        return f"{self.method} (Uno {_unopy(type(self).__name__).current_uno_version()})"

    def _options(self, scaled: ScaledProgram) -> dict[str, Any]:
        """Those of the preset alone."""
        del scaled
        return {}

    @override
    def minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        """Run Uno until it ends, the solve must end, the pattern is outgrown, or it approximates curvature in vain."""
        pattern = Pattern(scaled.sparsity)
        unopy = _unopy(type(self).__name__)
        solver = unopy.UnoSolver()
        solver.set_preset(self.preset)
        options = {
            "hessian_model": "LBFGS" if scaled.curved is None else "exact",
            "primal_tolerance": self.aim,
            "dual_tolerance": self.aim,
            # With the L2 norm of the presets, the accuracy per row would depend on the number of rows.
            "residual_norm": "INF",
            "logger": "SILENT",
            "max_iterations": self.max_iterations,
        }
        for option, value in (options | self._options(scaled)).items():
            solver.set_option(option, value)

        def is_over(*_: Any) -> bool:
            in_vain = scaled.curved is None and scaled.evaluations.is_straight
            return scaled.evaluations.halt is not None or pattern.outgrown or in_vain

        solver.set_termination_callback(is_over)
        result = solver.optimize(_model(unopy, scaled, pattern, multipliers))
        if pattern.outgrown:
            # The next round has all entries.
            scaled.sparsity = np.ones((scaled.rows, scaled.size))
        # unopy's constants are plain integers, to which its results never compare equal; so names are compared.
        ended, solution = result.optimization_status.name, result.solution_status.name
        bounds = np.array(result.lower_bound_dual_solution) + np.array(result.upper_bound_dual_solution)
        return Answer(
            claim=_CLAIMS.get(solution if ended == "SUCCESS" else ended, Status.FAILED),
            point=np.array(result.primal_solution),
            multipliers=Multipliers(np.array(result.constraint_dual_solution), bounds),
            iterations=int(result.number_iterations),
            message=f"{ended}, {solution}".lower().replace("_", " "),
        )


# Initial trust regions without and with second derivatives.
_RADII = 0.25, 10.0
# With more pairs, the limited-memory Hessian costs more than it gains.
_LARGEST_MEMORY = 20


@final
@dataclass(frozen=True)
class FilterSQP(_AbstractUno):
    """Sequential quadratic programming with a filter and a trust region, and BQPD subproblems.

    The Hessian is the program's own if it has one, else an L-BFGS approximation.
    Fletcher and Leyffer 2002, "Nonlinear programming without a penalty function", in the implementation of
    Vanaret and Leyffer 2026 (Uno, https://github.com/cvanaret/Uno). Points that cannot be evaluated shrink
    the trust region.

    - `tolerance`, `max_iterations`: see `AbstractLocalSolver`;
    - `radius`: initial trust region, in typical magnitudes of the variables. By default 10 where second derivatives are
      known and 1/4 where they are not: longer first steps carry durations to zero and controls to their bounds, where
      searches for feasibility creep.
    """

    radius: float | None = None

    preset: ClassVar[str] = "filtersqp"
    method: ClassVar[str] = "filterSQP"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.radius is not None:
            border.positive("FilterSQP: radius", self.radius)

    @override
    def _options(self, scaled: ScaledProgram) -> dict[str, Any]:
        return {
            "QP_solver": "BQPD",
            "quasi_newton_memory_size": int(np.clip(2 * scaled.size, 6, _LARGEST_MEMORY)),
            "TR_radius": float(self.radius or _RADII[scaled.curved is not None]),
        }


def default_solver() -> AbstractLocalSolver:
    """`FilterSQP()` if unopy is installed, else `Ipopt()`."""
    try:
        _unopy("FilterSQP")
    except MissingExtraError:
        return Ipopt()
    return FilterSQP()


@final
@dataclass(frozen=True)
class InteriorPoint(_AbstractUno):
    """The primal-dual interior-point method with a filter line search of IPOPT, in Uno's implementation.

    For programs with sparse derivatives and a Hessian of their own (`NonlinearProgram.hessian`); without one the
    Hessian is a limited-memory approximation. Vanaret and Leyffer 2026 (Uno, https://github.com/cvanaret/Uno), preset
    `ipopt`, with MUMPS.

    - `tolerance`, `max_iterations`: see `AbstractLocalSolver`.
    """

    preset: ClassVar[str] = "ipopt"
    method: ClassVar[str] = "interior points"
