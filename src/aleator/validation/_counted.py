"""Which constraints single systems are counted against, why the others are not, and on how fine a grid."""

from aleator.design import (
    AbstractFunctional,
    Constraint,
    Expression,
    Problem,
    Solution,
    Statistic,
)


def is_counted(constraint: Constraint) -> bool:
    """Whether systems can be counted against a constraint: it speaks of one system, and is no equality."""
    return not _reason(constraint)


def uncounted(problem: Problem) -> dict[str, str]:
    """The constraints that no system is counted against, as mathematics, and why."""
    return {str(one): reason for one in problem.constraints if (reason := _reason(one))}


def finer_by(solution: Solution) -> int:
    """How many times finer than its own grid that is on which a solution's limits over time were held."""
    return 1 if solution.between is None else solution.between.factor


def _reason(constraint: Constraint) -> str:
    """Why systems are not counted against a constraint; empty if they are."""
    expression = constraint.expression
    if float(constraint.lower) == float(constraint.upper):
        return "an equality, which no single system meets"
    if _speaks_of_one_system(expression):
        return ""
    if any(isinstance(atom, Statistic) for atom in expression.atoms):
        return "a statistic of all systems together"
    inside = any(isinstance(atom, Statistic) for atom in expression.leaves)
    return "a norm or an integral of statistics" if inside else "numbers of the design alone"


def _speaks_of_one_system(expression: Expression) -> bool:
    """Whether the value of a single system is part of it: not so of a spread, nor of the gap between two quantiles."""
    factors: dict[tuple[AbstractFunctional, ...], float] = {}
    for factor, atom in zip(expression.factors, expression.atoms, strict=True):
        if isinstance(atom, Statistic) and atom.kind.speaks_of_one_system:
            factors[atom.functionals] = factors.get(atom.functionals, 0.0) + float(factor)
    return any(factor != 0 for factor in factors.values())
