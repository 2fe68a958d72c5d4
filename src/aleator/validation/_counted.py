"""The constraints against which single systems are counted, why the others are not, and on which grid."""

import numpy as np
from jaxtyping import Float

from aleator.design import AbstractFunctional, Constraint, Expression, Extreme, Problem, Statistic
from aleator.nlp import HELD
from aleator.solution import Solution

_AN_ORDER_BELOW = 0.1


def is_counted(constraint: Constraint) -> bool:
    """Whether systems can be counted against a constraint: it applies to a single system, and is not an equality."""
    return not _reason(constraint)


def uncounted(problem: Problem) -> dict[str, str]:
    """The constraints against which no system is counted, as mathematics, with the reasons."""
    return {str(one): reason for one in problem.constraints if (reason := _reason(one))}


def tolerances(solution: Solution) -> Float[np.ndarray, " constraints"]:
    """The excess over each constraint that does not count as a violation, so that rounding does not break a limit."""
    return np.array([HELD * one.scale for one in solution.constraints])


def why_uncounted(problem: Problem, name: str) -> str:
    """Why no system can be counted against the constraints called `name`; empty where it can."""
    reasons = [_reason(one) for one in problem.named(name)]
    return "" if "" in reasons else reasons[0]


def sampled_by(solution: Solution) -> int:
    """The refinement factor, relative to a solution's own grid, of the grid for sampling systems.

    1 if the error of its own grid is an order of magnitude below the tolerance; otherwise that of the grid used to
    estimate it.
    """
    error = solution.certificate.grid_error
    return 1 if error is None or error.ratio <= _AN_ORDER_BELOW else error.factor


def finer_by(solution: Solution) -> int:
    """The refinement factor, relative to a solution's own grid, of the grid for counting against limits over time.

    It is that of the grid on which limits were held between instants, if they were; otherwise that of all samples.
    """
    between = solution.certificate.between
    return between.factor if between is not None and between.is_strict else sampled_by(solution)


def _reason(constraint: Constraint) -> str:
    """Why no system is counted against a constraint; empty if systems are."""
    expression = constraint.expression
    if float(constraint.lower) == float(constraint.upper):
        return "an equality, which no single system meets"
    if _speaks_of_one_system(expression):
        return ""
    if any(isinstance(atom, Statistic) for atom in expression.atoms):
        return "a statistic of all systems together"
    inside = any(isinstance(atom, Statistic) for atom in expression.leaves)
    return "a function or an integral of statistics" if inside else "numbers of the design alone"


def _speaks_of_one_system(expression: Expression) -> bool:
    """Whether it involves the value of a single system: a spread, or the gap between two quantiles, does not."""
    if any(isinstance(atom, Extreme) for atom in expression.atoms):
        return True
    factors: dict[tuple[AbstractFunctional, ...], float] = {}
    for factor, atom in zip(expression.factors, expression.atoms, strict=True):
        if isinstance(atom, Statistic) and atom.kind.speaks_of_one_system:
            factors[atom.functionals] = factors.get(atom.functionals, 0.0) + float(factor)
    return any(factor != 0 for factor in factors.values())
