"""SciPy's SLSQP as a second opinion."""

import itertools
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import scipy
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._matrices import dense_rows
from aleator.nlp._program import Evaluation, Sides
from aleator.nlp._scaling import ScaledProgram
from aleator.nlp._solver import Status
from aleator.nlp._verdict import LOST, Answer

# SLSQP's exit modes (Kraft 1988).
_CONVERGED, _ITERATION_LIMIT = 0, 9
# Added to the objective where the model cannot be evaluated, so that the line search steps back.
_WALL = 1e6
# SLSQP stops on changes of the objective, which are second order in the distance to the solution.
_CHANGE_PER_TOLERANCE = 1e-4
# Most searches for a feasible point, and the largest violation of one, in the tolerance of the library.
_MOST_RESTARTS, _FEASIBLE = 5, 10.0
# How far variables go, in typical magnitudes: where they are lost.
_FARTHEST = 2 * LOST
# SLSQP's dense matrices grow with the square of the variables, and its time with their cube.
_MOST_VARIABLES = 2000


@final
@dataclass(frozen=True)
class Slsqp(AbstractLocalSolver):
    """Sequential least-squares quadratic programming (Kraft 1988), in SciPy.

    If the linearised rows contradict each other, minimising the largest violation finds a feasible point to continue
    from, or a point of least violation.

    - `tolerance`, `max_iterations`: see `AbstractLocalSolver`.
    """

    max_iterations: int = 1000

    @property
    @override
    def name(self) -> str:
        return f"SLSQP (SciPy {scipy.__version__})"

    @override
    def minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        del multipliers  # SLSQP has no use for them.
        if scaled.size > _MOST_VARIABLES:
            raise ProblemError(
                f"Slsqp keeps dense matrices: expected at most {_MOST_VARIABLES} variables; received {scaled.size}. "
                "Use al.solvers.Ipopt() or al.solvers.InteriorPoint()."
            )
        point, iterations = scaled.start, 0
        for restarts, seeks_feasible in itertools.product(range(_MOST_RESTARTS + 1), (False, True)):
            before = point
            found = self._minimised(scaled, point, seeks_feasible, self.max_iterations - iterations)
            point, message = found.x[: scaled.size], str(found.message).lower()
            iterations += int(found.nit)
            if not scaled.user(point).is_finite:
                return Answer(Status.EVALUATION_FAILED, before, None, iterations, message)
            if found.status == _ITERATION_LIMIT or iterations >= self.max_iterations:
                return Answer(Status.ITERATION_LIMIT, point, None, iterations, message)
            outside = scaled.limits.excess(scaled.evaluate(point).constraints)
            feasible = outside.max(initial=0.0) <= _FEASIBLE * self.aim
            if seeks_feasible and not feasible:
                return Answer(Status.INFEASIBLE, point, None, iterations, message)
            if not seeks_feasible and (feasible or restarts == _MOST_RESTARTS):
                claim = Status.SOLVED if found.status == _CONVERGED else Status.FAILED
                return Answer(claim, point, None, iterations, message)
        raise AssertionError("the last round returns")

    def _minimised(self, scaled: ScaledProgram, point: np.ndarray, seeks_feasible: bool, max_iterations: int) -> Any:
        """Minimise the objective, or the largest violation: a further variable, by which all rows may be exceeded."""
        at, size, extra = _walled(scaled, point), point.size, int(seeks_feasible)
        equal = (scaled.constraint_lower == scaled.constraint_upper) & (not seeks_feasible)
        equalities, others = np.flatnonzero(equal), np.flatnonzero(~equal)
        target = scaled.constraint_lower[equalities]
        limits = Sides(scaled.constraint_lower[others], scaled.constraint_upper[others])
        places, signs, gaps = limits.within(at(point).constraints[others])
        sides, bounds = others[places], np.where(signs > 0, limits.upper[places], limits.lower[places])
        # Where nothing bounds the objective, steps would grow without end.
        lower, upper = np.maximum(scaled.lower, -_FARTHEST), np.minimum(scaled.upper, _FARTHEST)
        last, ones = np.append(np.zeros(size), 1.0), np.ones((sides.size, extra))
        equations = {
            "type": "eq",
            "fun": lambda w: at(w[:size]).constraints[equalities] - target,
            "jac": lambda w: dense_rows(at(w[:size]).jacobian, equalities),
        }
        inequalities = {
            "type": "ineq",
            "fun": lambda w: signs * (bounds - at(w[:size]).constraints[sides]) + w[size:].sum(),
            "jac": lambda w: np.hstack([-signs[:, None] * dense_rows(at(w[:size]).jacobian, sides), ones]),
        }
        with warnings.catch_warnings():
            # SLSQP's steps overshoot bounds by rounding; SciPy clips them and warns needlessly.
            warnings.filterwarnings("ignore", message="Values in x were outside bounds")
            return scipy.optimize.minimize(
                (lambda w: w[-1]) if seeks_feasible else lambda w: at(w).objective,
                np.append(point, [max(0.0, -float(gaps.min(initial=0.0)))] * extra),
                jac=(lambda _: last) if seeks_feasible else lambda w: at(w).gradient,
                method="SLSQP",
                bounds=[*zip(lower.tolist(), upper.tolist(), strict=True), *[(0.0, None)] * extra],
                constraints=[equations] * bool(equalities.size) + [inequalities] * bool(sides.size),
                options={"ftol": self.aim * _CHANGE_PER_TOLERANCE, "maxiter": max_iterations},
            )


def _walled(scaled: ScaledProgram, point: np.ndarray) -> Callable[[np.ndarray], Evaluation]:
    """The model, which returns the latest finite evaluation plus a wall where it is not finite."""
    latest = scaled.evaluate(point)
    # Every row is violated behind the wall, so that searches that ignore the objective step back as well.
    outward = np.where(np.isfinite(scaled.constraint_upper), _WALL, -_WALL)

    def at(z: np.ndarray) -> Evaluation:
        nonlocal latest
        try:
            latest = scaled.evaluate(z)
        except NotFiniteError:
            return latest._replace(objective=latest.objective + _WALL, constraints=latest.constraints + outward)
        return latest

    return at
