"""SciPy's SLSQP as a second opinion, with an exchange method for thousands of rows."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np
import scipy
from typing_extensions import override

from aleator._core import border
from aleator._core.errors import ProblemError
from aleator.nlp._answer import Answer
from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._matrices import dense_rows
from aleator.nlp._program import Evaluation
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


class _Round(NamedTuple):
    point: np.ndarray
    mode: int
    iterations: int
    message: str


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
        point, iterations, search, restarts = scaled.start, 0, _least_objective, 0
        for _ in range(self.max_rounds):
            rows = np.union1d(rows, _worst_rows(scaled, point))
            before = point
            point, mode, spent, message = search(scaled, point, rows, self.aim, self.max_iterations - iterations)
            iterations += spent
            if not scaled.user(point).is_finite:
                return Answer(Status.EVALUATION_FAILED, before, None, iterations, message)
            if mode == _ITERATION_LIMIT or iterations >= self.max_iterations:
                used_up = message if mode == _ITERATION_LIMIT else "iteration limit reached over all rounds"
                return Answer(Status.ITERATION_LIMIT, point, None, iterations, used_up)
            converged = bool(np.abs(point - before).max() < 0.99 * _REACH) and self._met(scaled, point, rows)
            violation = scaled.limits.excess(scaled.evaluate(point).constraints)
            feasible = float(violation.max(initial=0.0)) <= 10 * self.aim
            if search is _least_violation:
                if converged and not feasible:
                    return Answer(Status.INFEASIBLE, point, None, iterations, message)
                search = _least_objective if feasible else _least_violation
            elif converged and (feasible or restarts == _MOST_RESTARTS):
                claim = Status.SOLVED if mode == _CONVERGED else Status.FAILED
                return Answer(claim, point, None, iterations, message)
            elif mode == _INCOMPATIBLE or converged:
                search, restarts = _least_violation, restarts + 1
        return Answer(Status.ITERATION_LIMIT, point, None, iterations, "the exchange of rows reached its limit")

    def _met(self, scaled: ScaledProgram, point: np.ndarray, rows: np.ndarray) -> bool:
        """Whether no row outside `rows` is violated more than those inside, so that another round changes nothing."""
        outside = scaled.limits.excess(scaled.evaluate(point).constraints)
        inside = float(outside[rows].max(initial=0.0))
        return float(outside.max(initial=0.0)) <= max(inside, self.aim)


def _worst_rows(scaled: ScaledProgram, point: np.ndarray) -> np.ndarray:
    """Find the rows that are worst among their neighbours, the worst first and no more than a few per variable."""
    outside = scaled.limits.excess(scaled.evaluate(point).constraints)
    padded = np.concatenate([[-np.inf], outside, [-np.inf]])
    # Of equally bad rows only the first counts, so that a plateau does not crowd out other extrema.
    extrema = np.flatnonzero((outside > padded[:-2]) & (outside >= padded[2:]))
    return extrema[np.argsort(-outside[extrema])][: 2 * scaled.size + 10]


def _least_objective(
    scaled: ScaledProgram, point: np.ndarray, rows: np.ndarray, tolerance: float, max_iterations: int
) -> _Round:
    """Minimise the objective subject to `rows`, within reach of `point`."""
    at = _walled(scaled, point)
    equal = scaled.constraint_lower[rows] == scaled.constraint_upper[rows]
    equalities, others = rows[equal], rows[~equal]
    target = scaled.constraint_lower[equalities]
    sides = _sides(scaled, others)
    constraints = [
        {
            "type": "eq",
            "fun": lambda z: at(z).constraints[equalities] - target,
            "jac": lambda z: dense_rows(at(z).jacobian, equalities),
        },
        {"type": "ineq", "fun": lambda z: sides.slack(at(z)), "jac": lambda z: sides.slopes(at(z))},
    ]
    sizes = (equalities.size, sides.rows.size)
    return _slsqp(
        lambda z: at(z).objective,
        lambda z: at(z).gradient,
        point,
        _reachable(scaled, point),
        [constraint for constraint, size in zip(constraints, sizes, strict=True) if size],
        tolerance,
        max_iterations,
    )


def _least_violation(
    scaled: ScaledProgram, point: np.ndarray, rows: np.ndarray, tolerance: float, max_iterations: int
) -> _Round:
    """Minimise the largest violation `t` of `rows` over `(z, t)`, within reach of `point`."""
    at = _walled(scaled, point)
    sides = _sides(scaled, rows)
    begin = max(0.0, -float(sides.slack(at(point)).min()))
    direction = np.append(np.zeros(point.size), 1.0)
    ones = np.ones((sides.rows.size, 1))
    constraint = {
        "type": "ineq",
        "fun": lambda w: sides.slack(at(w[:-1])) + w[-1],
        "jac": lambda w: np.hstack([sides.slopes(at(w[:-1])), ones]),
    }
    found = _slsqp(
        lambda w: w[-1],
        lambda _: direction,
        np.append(point, begin),
        [*_reachable(scaled, point), (0.0, None)],
        [constraint],
        tolerance,
        max_iterations,
    )
    return found._replace(point=found.point[:-1])


class _Sides(NamedTuple):
    """Finite bounds of rows as `slack >= 0`: sign +1 for a lower bound, -1 for an upper one."""

    rows: np.ndarray
    signs: np.ndarray
    bounds: np.ndarray

    def slack(self, evaluation: Evaluation) -> np.ndarray:
        return self.signs * (evaluation.constraints[self.rows] - self.bounds)

    def slopes(self, evaluation: Evaluation) -> np.ndarray:
        return self.signs[:, None] * dense_rows(evaluation.jacobian, self.rows)


def _sides(scaled: ScaledProgram, rows: np.ndarray) -> _Sides:
    below = rows[np.isfinite(scaled.constraint_lower[rows])]
    above = rows[np.isfinite(scaled.constraint_upper[rows])]
    return _Sides(
        np.concatenate([below, above]),
        np.concatenate([np.ones(below.size), -np.ones(above.size)]),
        np.concatenate([scaled.constraint_lower[below], scaled.constraint_upper[above]]),
    )


def _reachable(scaled: ScaledProgram, point: np.ndarray) -> list[tuple[float, float]]:
    lower, upper = np.maximum(scaled.lower, point - _REACH), np.minimum(scaled.upper, point + _REACH)
    return list(zip(lower.tolist(), upper.tolist(), strict=True))


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


def _slsqp(
    objective: Callable[[np.ndarray], float],
    gradient: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    bounds: list[Any],
    constraints: list[dict[str, Any]],
    tolerance: float,
    max_iterations: int,
) -> _Round:
    options = {"ftol": tolerance * _CHANGE_PER_TOLERANCE, "maxiter": max_iterations}
    with warnings.catch_warnings():
        # SLSQP's steps overshoot bounds by rounding; SciPy clips them and warns needlessly.
        warnings.filterwarnings("ignore", message="Values in x were outside bounds")
        found: Any = scipy.optimize.minimize(
            objective,
            start,
            jac=gradient,
            method="SLSQP",
            bounds=bounds,
            constraints=constraints,
            options=options,
        )
    return _Round(found.x, int(found.status), int(found.nit), str(found.message).lower())
