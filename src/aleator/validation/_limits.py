"""Limits against which single systems are counted, and which of a sample's systems break them."""

from collections.abc import Collection, Sequence

import numpy as np
from jaxtyping import Bool, Float

from aleator._core.errors import ProblemError
from aleator.design import AbstractFunctional, Constraint, Expression, Extreme, Problem, Statistic


def is_counted(constraint: Constraint) -> bool:
    """Whether systems can be counted against a constraint: it applies to a single system, and is not an equality."""
    return not reason_uncounted(constraint)


def reason_uncounted(constraint: Constraint) -> str:
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


def check_counted(who: str, names: Sequence[str], counted: Collection[str]) -> None:
    """Raise `ProblemError` for no names, and for any but those of constraints against which systems are counted."""
    unknown = [name for name in names if name not in counted]
    if unknown or not names:
        raise ProblemError(
            f"{who}: expected names of constraints against which systems are counted, {list(counted)}; received "
            f"{unknown}."
        )


def why_uncounted(problem: Problem, name: str) -> str:
    """Why no system can be counted against the constraints called `name`; empty where it can."""
    reasons = [reason_uncounted(one) for one in problem.named(name)]
    return "" if "" in reasons else reasons[0]


def broken_by(
    problem: Problem, excess: Float[np.ndarray, "constraints systems"]
) -> dict[str, Bool[np.ndarray, " systems"]]:
    """Which systems break any limit of each name against which they are counted, from their excess over each."""
    broken: dict[str, Bool[np.ndarray, " systems"]] = {}
    for limit, beyond in zip(problem.constraints, excess, strict=True):
        if is_counted(limit):
            broken[limit.name] = broken.get(limit.name, False) | (beyond > 0)
    return broken
