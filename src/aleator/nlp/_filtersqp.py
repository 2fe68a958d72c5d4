"""Uno's filterSQP: few decisions, many dense rows, costly values."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from aleator._core import given
from aleator._core.errors import MissingExtraError
from aleator.nlp._ipopt import Ipopt
from aleator.nlp._outcome import Status
from aleator.nlp._pattern import Pattern
from aleator.nlp._scaling import Multipliers, ScaledProgram
from aleator.nlp._solver import AbstractSolver
from aleator.nlp._verdict import Answer

# Beyond this many pairs, the limited memory costs more than the curvature it remembers is worth.
_LARGEST_MEMORY = 20
_CLAIMS = {
    "FEASIBLE_KKT_POINT": Status.SOLVED,
    "INFEASIBLE_STATIONARY_POINT": Status.INFEASIBLE,
    "ITERATION_LIMIT": Status.ITERATION_LIMIT,
    # Uno replaces Python's handler of Ctrl-C while it runs.
    "USER_INTERRUPTION": Status.INTERRUPTED,
}


@final
@dataclass(frozen=True)
class FilterSQP(AbstractSolver):
    """Sequential quadratic programming with a filter and a trust region, L-BFGS Hessian and BQPD subproblems.

    Fletcher and Leyffer 2002, "Nonlinear programming without a penalty function", in the implementation of
    Vanaret and Leyffer 2026 (Uno, https://github.com/cvanaret/Uno). Points that cannot be evaluated shrink
    the trust region.

    - `radius`: initial trust region, in typical magnitudes of the decisions.
    """

    radius: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        given.positive("FilterSQP: radius", self.radius)

    def _require(self) -> None:
        _import()

    def _name(self) -> str:
        return f"filterSQP (Uno {_import().current_uno_version()})"

    def _minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        pattern = Pattern(scaled.structure)
        answer = self._solved(scaled, pattern, scaled.start, multipliers, self.max_iterations)
        while pattern.outgrown and scaled.evaluations.halt is None and answer.iterations < self.max_iterations:
            pattern = pattern.widened()
            rows = None if answer.multipliers is None else answer.multipliers.rows
            left = self.max_iterations - answer.iterations
            again = self._solved(scaled, pattern, answer.point, rows, left)
            answer = again._replace(iterations=answer.iterations + again.iterations)
        return answer

    def _solved(
        self,
        scaled: ScaledProgram,
        pattern: Pattern,
        start: np.ndarray,
        multipliers: np.ndarray | None,
        iterations: int,
    ) -> Answer:
        """Run Uno until it ends, or until derivatives are not zero where `pattern` has none."""
        unopy = _import()
        solver = unopy.UnoSolver()
        solver.set_preset("filtersqp")
        for option, value in (self._options(scaled) | {"max_iterations": iterations}).items():
            solver.set_option(option, value)
        solver.set_termination_callback(lambda *_: scaled.evaluations.halt is not None or pattern.outgrown)
        return _answer(solver.optimize(_model(unopy, scaled, pattern, start, multipliers)))

    def _options(self, scaled: ScaledProgram) -> dict[str, Any]:
        return {
            "QP_solver": "BQPD",
            "hessian_model": "LBFGS",
            "quasi_newton_memory_size": int(np.clip(2 * scaled.size, 6, _LARGEST_MEMORY)),
            "primal_tolerance": self.aim,
            "dual_tolerance": self.aim,
            # The preset's L2 norm would demand more of a row, the more rows a grid has.
            "residual_norm": "INF",
            "TR_radius": float(self.radius),
            "logger": "SILENT",
        }


def default_solver() -> AbstractSolver:
    """`FilterSQP()` where unopy is installed, `Ipopt()` otherwise."""
    try:
        _import()
    except MissingExtraError:
        return Ipopt()
    return FilterSQP()


def _import() -> Any:
    try:
        import unopy
    except ImportError as error:
        raise MissingExtraError(
            "`FilterSQP` needs the library unopy: install it with `pip install unopy`, or use `Ipopt()` instead."
        ) from error
    return unopy


def _model(
    unopy: Any, scaled: ScaledProgram, pattern: Pattern, start: np.ndarray, multipliers: np.ndarray | None
) -> Any:
    def gradient(z: np.ndarray, out: np.ndarray) -> None:
        out[:] = scaled.evaluate(z).gradient

    def constraints(z: np.ndarray, out: np.ndarray) -> None:
        out[:] = scaled.evaluate(z).constraints

    def jacobian(z: np.ndarray, out: np.ndarray) -> None:
        out[:] = pattern.entries(scaled.evaluate(z).jacobian)

    n, m = scaled.size, scaled.rows
    model = unopy.Model(
        unopy.PROBLEM_NONLINEAR, n, scaled.lower.tolist(), scaled.upper.tolist(), unopy.ZERO_BASED_INDEXING
    )
    model.set_objective(unopy.MINIMIZE, lambda z: scaled.evaluate(z).objective, gradient)
    model.set_lagrangian_sign_convention(unopy.MULTIPLIER_POSITIVE)
    if m:
        rows, columns = pattern.rows.tolist(), pattern.columns.tolist()
        lower, upper = scaled.constraint_lower.tolist(), scaled.constraint_upper.tolist()
        model.set_constraints(m, constraints, lower, upper, len(rows), rows, columns, jacobian)
    model.set_initial_primal_iterate(start.tolist())
    if m and multipliers is not None:
        model.set_initial_dual_iterate(multipliers.tolist())
    return model


def _answer(result: Any) -> Answer:
    # unopy's constants are plain integers, which its results never equal; only the names can be compared.
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
