"""SciPy's SLSQP as a second opinion."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np
import scipy
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._matrices import dense_rows
from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import ScaledProgram
from aleator.nlp._solver import Status
from aleator.nlp._verdict import LOST, Answer

# What SLSQP's exit modes say (Kraft 1988); others are failures.
_CLAIMS = {0: Status.SOLVED, 9: Status.ITERATION_LIMIT}
# Added to the objective where the model cannot be evaluated, so that the line search steps back.
_WALL = 1e6
# SLSQP stops on changes of the objective, which are second order in the distance to the solution.
_CHANGE_PER_TOLERANCE = 1e-4
# How far variables go, in typical magnitudes: where they are lost.
_FARTHEST = 2 * LOST
# SLSQP's dense matrices grow with the square of the variables, and its time with their cube.
_MOST_VARIABLES = 2000


@final
@dataclass(frozen=True)
class Slsqp(AbstractLocalSolver):
    """Sequential least-squares quadratic programming (Kraft 1988), in SciPy.

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
        at = _walled(scaled)
        rows = scipy.optimize.NonlinearConstraint(
            lambda z: at(z).constraints, *scaled.relaxed(self.aim), jac=lambda z: dense_rows(at(z).jacobian)
        )
        # Where nothing bounds the objective, steps would grow without end.
        bounds = np.maximum(scaled.lower, -_FARTHEST), np.minimum(scaled.upper, _FARTHEST)
        with warnings.catch_warnings():
            # SLSQP's steps overshoot bounds by rounding, which SciPy clips; equalities it tells from others itself.
            warnings.filterwarnings("ignore", message="Values in x were outside bounds|Equality and inequality")
            found = scipy.optimize.minimize(
                lambda z: at(z).objective,
                scaled.start,
                jac=lambda z: at(z).gradient,
                method="SLSQP",
                bounds=scipy.optimize.Bounds(*bounds),
                constraints=[rows] if scaled.rows else [],
                options={"ftol": self.aim * _CHANGE_PER_TOLERANCE, "maxiter": self.max_iterations},
            )
        claim = _CLAIMS.get(found.status, Status.FAILED)
        return Answer(claim, found.x, None, int(found.nit), str(found.message).lower())


def _walled(scaled: ScaledProgram) -> Callable[[np.ndarray], Evaluation]:
    """The model, which returns the latest finite evaluation plus a wall where it is not finite."""
    latest = scaled.evaluate(scaled.start)
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
