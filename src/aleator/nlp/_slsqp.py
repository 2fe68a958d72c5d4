"""SciPy's SLSQP as a second opinion, with an exchange method for thousands of rows."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import scipy
from typing_extensions import override

from aleator._core import border
from aleator._core.errors import ProblemError
from aleator.nlp._answer import Answer
from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._matrices import dense_rows
from aleator.nlp._program import Evaluation, Sides
from aleator.nlp._scaling import ScaledProgram
from aleator.nlp._solver import Status

# SLSQP's exit modes (Kraft 1988).
_CONVERGED, _INCOMPATIBLE, _ITERATION_LIMIT = 0, 4, 9
# Added to the objective where the model cannot be evaluated, so that the line search steps back.
_WALL = 1e6
# Variables move at most this many typical magnitudes a round, so that they do not diverge while rows are left out.
_REACH = 10.0
# SLSQP stops on changes of the objective, which are second order in the distance to the solution.
_CHANGE_PER_TOLERANCE = 1e-4
# Most searches for a feasible point.
_MOST_RESTARTS = 5
# SLSQP's dense matrices grow with the square of the variables, and its time with their cube.
_MOST_VARIABLES = 2000


@final
@dataclass(frozen=True)
class Slsqp(AbstractLocalSolver):
    """Sequential least-squares quadratic programming (Kraft 1988) with an exchange of rows.

    SLSQP is slow with thousands of rows. So a round has only the equalities and those rows that are the worst among
    their neighbours; rows that its solution violates join the next round, until none is violated: the exchange method
    of semi-infinite programming (Hettich and Kortanek 1993). If the linearised rows contradict each other, minimising
    the largest violation finds a feasible point to continue from, or a point of least violation.

    - `tolerance`: see `AbstractLocalSolver`; `max_iterations`: over all rounds;
    - `max_rounds`: of the exchange.
    """

    max_iterations: int = 1000
    max_rounds: int = 60

    def __post_init__(self) -> None:
        super().__post_init__()
        border.whole("Slsqp: max_rounds", self.max_rounds)

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
        rows = np.flatnonzero(scaled.constraint_lower == scaled.constraint_upper)
        point, iterations, seeks_feasible, restarts = scaled.start, 0, False, 0
        for _ in range(self.max_rounds):
            rows = np.union1d(rows, _worst_rows(scaled, point))
            before = point
            found = self._round(scaled, point, rows, seeks_feasible, self.max_iterations - iterations)
            point, message = found.x[: scaled.size], str(found.message).lower()
            iterations += int(found.nit)
            if not scaled.user(point).is_finite:
                return Answer(Status.EVALUATION_FAILED, before, None, iterations, message)
            if found.status == _ITERATION_LIMIT or iterations >= self.max_iterations:
                used_up = message if found.status == _ITERATION_LIMIT else "iteration limit reached over all rounds"
                return Answer(Status.ITERATION_LIMIT, point, None, iterations, used_up)
            outside = scaled.limits.excess(scaled.evaluate(point).constraints)
            worst, known = float(outside.max(initial=0.0)), float(outside[rows].max(initial=0.0))
            # Another round changes nothing where no row is violated more than those that it has.
            converged = bool(np.abs(point - before).max() < 0.99 * _REACH) and worst <= max(known, self.aim)
            feasible = worst <= 10 * self.aim
            if seeks_feasible:
                if converged and not feasible:
                    return Answer(Status.INFEASIBLE, point, None, iterations, message)
                seeks_feasible = not feasible
            elif converged and (feasible or restarts == _MOST_RESTARTS):
                claim = Status.SOLVED if found.status == _CONVERGED else Status.FAILED
                return Answer(claim, point, None, iterations, message)
            elif found.status == _INCOMPATIBLE or converged:
                seeks_feasible, restarts = True, restarts + 1
        return Answer(Status.ITERATION_LIMIT, point, None, iterations, "the exchange of rows reached its limit")

    def _round(
        self, scaled: ScaledProgram, point: np.ndarray, rows: np.ndarray, seeks_feasible: bool, max_iterations: int
    ) -> Any:
        """Minimise the objective subject to `rows`, within reach of `point`, or the largest violation of these.

        That is a further variable, by which all rows may be exceeded.
        """
        at, size, extra = _walled(scaled, point), point.size, int(seeks_feasible)
        equal = (scaled.constraint_lower[rows] == scaled.constraint_upper[rows]) & (not seeks_feasible)
        equalities, others = rows[equal], rows[~equal]
        target = scaled.constraint_lower[equalities]
        limits = Sides(scaled.constraint_lower[others], scaled.constraint_upper[others])
        places, signs, gaps = limits.within(at(point).constraints[others])
        sides, bounds = others[places], np.where(signs > 0, limits.upper[places], limits.lower[places])
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
        lower, upper = np.maximum(scaled.lower, point - _REACH), np.minimum(scaled.upper, point + _REACH)
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


def _worst_rows(scaled: ScaledProgram, point: np.ndarray) -> np.ndarray:
    """Find the rows that are worst among their neighbours, the worst first and no more than a few per variable."""
    outside = scaled.limits.excess(scaled.evaluate(point).constraints)
    padded = np.concatenate([[-np.inf], outside, [-np.inf]])
    # Of equally bad rows only the first counts, so that a plateau does not crowd out other extrema.
    extrema = np.flatnonzero((outside > padded[:-2]) & (outside >= padded[2:]))
    return extrema[np.argsort(-outside[extrema])][: 2 * scaled.size + 10]


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
