"""Uno (Vanaret and Leyffer 2026, https://github.com/cvanaret/Uno): its presets, programs and answers."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, final

import numpy as np
from typing_extensions import override

from aleator._core import border
from aleator._core.errors import MissingExtraError
from aleator._core.interruption import take_back
from aleator.nlp._answer import Answer
from aleator.nlp._ipopt import Ipopt
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._matrices import Pattern, rows_of_entries
from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import Multipliers, ScaledProgram
from aleator.nlp._solver import Status

_CLAIMS = {
    "FEASIBLE_KKT_POINT": Status.SOLVED,
    "INFEASIBLE_STATIONARY_POINT": Status.INFEASIBLE,
    "ITERATION_LIMIT": Status.ITERATION_LIMIT,
    # Outside the main thread, only Uno receives Ctrl-C.
    "USER_INTERRUPTION": Status.INTERRUPTED,
}


def _unopy(who: str) -> Any:
    """The library, imported late. Raises `MissingExtraError` if it is not installed."""
    try:
        import unopy
    except ImportError as error:
        raise MissingExtraError(
            f"`{who}` needs the library unopy: install it with `pip install unopy`, or use al.solvers.Ipopt()."
        ) from error
    return unopy


def _minimised(
    preset: str,
    scaled: ScaledProgram,
    multipliers: np.ndarray | None,
    *,
    aim: float,
    max_iterations: int,
    options: Mapping[str, Any] = MappingProxyType({}),
) -> Answer:
    """Run one of Uno's presets, a second time with all entries where a derivative outside the sparsity is nonzero.

    - `aim`: the tolerance for Uno; `options`: those of the preset alone.
    """
    settings: dict[str, Any] = {
        "hessian_model": "LBFGS" if scaled.curved is None else "exact",
        "primal_tolerance": aim,
        "dual_tolerance": aim,
        # With the L2 norm of the presets, the accuracy per row would depend on the number of rows.
        "residual_norm": "INF",
        "logger": "SILENT",
    }
    settings |= options
    pattern = Pattern(scaled.sparsity)
    answer = _run(preset, settings | {"max_iterations": max_iterations}, scaled, pattern, scaled.start, multipliers)
    left = max_iterations - answer.iterations
    if not pattern.outgrown or scaled.evaluations.halt is not None or left <= 0:
        return answer
    rows = None if answer.multipliers is None else answer.multipliers.rows
    pattern = Pattern(np.ones((scaled.rows, scaled.size)))
    again = _run(preset, settings | {"max_iterations": left}, scaled, pattern, answer.point, rows)
    return again._replace(iterations=answer.iterations + again.iterations)


def _run(
    preset: str,
    settings: Mapping[str, Any],
    scaled: ScaledProgram,
    pattern: Pattern,
    start: np.ndarray,
    multipliers: np.ndarray | None,
) -> Answer:
    """Run Uno until it ends, the solve must end, the pattern is outgrown, or it approximates curvature in vain."""
    unopy = _unopy(preset)
    solver = unopy.UnoSolver()
    solver.set_preset(preset)
    for option, value in settings.items():
        solver.set_option(option, value)

    def is_over(*_: Any) -> bool:
        in_vain = scaled.curved is None and scaled.straightness.is_shown
        return scaled.evaluations.halt is not None or pattern.outgrown or in_vain

    solver.set_termination_callback(is_over)
    return _answer(solver.optimize(_model(unopy, scaled, pattern, start, multipliers)))


def _model(
    unopy: Any, scaled: ScaledProgram, pattern: Pattern, start: np.ndarray, multipliers: np.ndarray | None
) -> Any:
    """The scaled program, with second derivatives if it has them."""
    latest: list[bytes] = []

    def at(z: np.ndarray) -> Evaluation:
        if latest != [key := z.tobytes()]:
            # Uno installs its own handler of Ctrl-C before Python's, and ends the process at the second one.
            take_back()
            latest[:] = [key]
        return scaled.evaluate(z)

    def gradient(z: np.ndarray, out: np.ndarray) -> None:
        out[:] = at(z).gradient

    def constraints(z: np.ndarray, out: np.ndarray) -> None:
        out[:] = at(z).constraints

    def jacobian(z: np.ndarray, out: np.ndarray) -> None:
        out[:] = pattern.entries(at(z).jacobian)

    def hessian(z: np.ndarray, weight: float, multipliers: np.ndarray, out: np.ndarray) -> None:
        out[:] = scaled.hessian(z, weight, np.array(multipliers))

    n, m = scaled.size, scaled.rows
    model = unopy.Model(
        unopy.PROBLEM_NONLINEAR, n, scaled.lower.tolist(), scaled.upper.tolist(), unopy.ZERO_BASED_INDEXING
    )
    model.set_objective(unopy.MINIMIZE, lambda z: at(z).objective, gradient)
    model.set_lagrangian_sign_convention(unopy.MULTIPLIER_POSITIVE)
    if m:
        rows, columns = pattern.rows.tolist(), pattern.columns.tolist()
        lower, upper = scaled.constraint_lower.tolist(), scaled.constraint_upper.tolist()
        model.set_constraints(m, constraints, lower, upper, len(rows), rows, columns, jacobian)
    if scaled.curved is not None:
        rows, columns = rows_of_entries(scaled.curved).tolist(), scaled.curved.indices.tolist()
        model.set_lagrangian_hessian(len(rows), unopy.LOWER_TRIANGLE, rows, columns, hessian)
    model.set_initial_primal_iterate(start.tolist())
    if m and multipliers is not None:
        model.set_initial_dual_iterate(multipliers.tolist())
    return model


def _answer(result: Any) -> Answer:
    """Uno's result as an answer."""
    # unopy's constants are plain integers, to which its results never compare equal; so names are compared.
    ended, solution = result.optimization_status.name, result.solution_status.name
    claim = _CLAIMS.get(solution if ended == "SUCCESS" else ended, Status.FAILED)
    bounds = np.array(result.lower_bound_dual_solution) + np.array(result.upper_bound_dual_solution)
    return Answer(
        claim=claim,
        point=np.array(result.primal_solution),
        multipliers=Multipliers(np.array(result.constraint_dual_solution), bounds),
        iterations=int(result.number_iterations),
        message=f"{ended}, {solution}".lower().replace("_", " "),
    )


# With more pairs, the limited-memory Hessian costs more than it gains.
_LARGEST_MEMORY = 20


@final
@dataclass(frozen=True)
class FilterSQP(AbstractLocalSolver):
    """Sequential quadratic programming with a filter and a trust region, and BQPD subproblems.

    The Hessian is the program's own if it has one, else an L-BFGS approximation.
    Fletcher and Leyffer 2002, "Nonlinear programming without a penalty function", in the implementation of
    Vanaret and Leyffer 2026 (Uno, https://github.com/cvanaret/Uno). Points that cannot be evaluated shrink
    the trust region.

    - `tolerance`, `max_iterations`: see `AbstractLocalSolver`;
    - `radius`: initial trust region, in typical magnitudes of the variables.
    """

    radius: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        border.positive("FilterSQP: radius", self.radius)

    @override
    def require(self) -> None:
        _unopy("FilterSQP")

    @property
    @override
    def name(self) -> str:
        return f"filterSQP (Uno {_unopy('FilterSQP').current_uno_version()})"

    @override
    def minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        options = {
            "QP_solver": "BQPD",
            "quasi_newton_memory_size": int(np.clip(2 * scaled.size, 6, _LARGEST_MEMORY)),
            "TR_radius": float(self.radius),
        }
        limits = {"aim": self.aim, "max_iterations": self.max_iterations}
        return _minimised("filtersqp", scaled, multipliers, **limits, options=options)


def default_solver() -> AbstractLocalSolver:
    """`FilterSQP()` if unopy is installed, else `Ipopt()`."""
    try:
        _unopy("FilterSQP")
    except MissingExtraError:
        return Ipopt()
    return FilterSQP()


@final
@dataclass(frozen=True)
class InteriorPoint(AbstractLocalSolver):
    """The primal-dual interior-point method with a filter line search of IPOPT, in Uno's implementation.

    For programs with sparse derivatives and a Hessian of their own (`NonlinearProgram.hessian`); without one the
    Hessian is a limited-memory approximation. Vanaret and Leyffer 2026 (Uno, https://github.com/cvanaret/Uno), preset
    `ipopt`, with MUMPS.

    - `tolerance`, `max_iterations`: see `AbstractLocalSolver`.
    """

    @override
    def require(self) -> None:
        _unopy("InteriorPoint")

    @property
    @override
    def name(self) -> str:
        return f"interior points (Uno {_unopy('InteriorPoint').current_uno_version()})"

    @override
    def minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        return _minimised("ipopt", scaled, multipliers, aim=self.aim, max_iterations=self.max_iterations)
