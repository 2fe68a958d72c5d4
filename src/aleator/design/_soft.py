"""`soft`: constraints as penalties in the objective, dissertation section 3.4."""

import numpy as np

from aleator._core.errors import ProblemError
from aleator._core.given import one_of, positive
from aleator.design._expression import Constraint, Expression, as_expression
from aleator.design._functions import positive_part
from aleator.design._objectives import time_integral
from aleator.design._problem import Problem, declared_anew


def soft(problem: Problem, *names: str, weight: float) -> Problem:
    """The same problem with the constraints of these names, or all of them, as penalties in its objective.

    A limit `x <= b` becomes `weight (x - b)₊²`, which is zero where it holds (equation 7); an equality `x = b` becomes
    `weight (x - b)²` (8); both are integrated over time where the constraint holds at every instant. Without any
    constraint left it is the unconstrained form of the design: (94) of (93), (101) of (95), (124) of (122).

    - `weight`: how much one unit of excess costs, in the unit of the objective per square of the constraint's (and
      second, of a path). The larger, the less a limit is exceeded at the optimum, in inverse proportion; it still is,
      wherever it would be active. Several weights: `soft(soft(problem, "a", weight=1e3), "b", weight=10.0)`.

    The problem given is unchanged and still judges the answer: `al.validate(problem, solution)` counts the systems that
    exceed its limits. Raises `ProblemError` for names that no constraint has, if there is no constraint, for a weight
    that is not positive, and for limits on the worst case, which hold realisation by realisation.
    """
    problem, weight = one_of("soft", problem, Problem), positive("soft: weight", weight)
    if not problem.constraints:
        raise ProblemError("soft: the problem has no constraints that could become penalties.")
    chosen = names or problem.names
    penalties = [_penalty(one) for name in chosen for one in problem.named(name)]
    return declared_anew(
        problem,
        problem.simulation,
        minimize=problem.objective + weight * sum(penalties, start=as_expression(0.0)),
        subject_to=tuple(one for one in problem.constraints if one.name not in chosen),
    )


def _penalty(constraint: Constraint) -> Expression:
    """The square of what a constraint is missed by, over time if it holds at every instant."""
    expression, lower, upper = constraint.expression, float(constraint.lower), float(constraint.upper)
    if lower == upper:
        missed = [expression - upper]
    else:
        missed = [positive_part(expression - upper)] if np.isfinite(upper) else []
        missed += [positive_part(lower - expression)] if np.isfinite(lower) else []
    square = sum((one**2 for one in missed), start=as_expression(0.0))
    return time_integral(square) if constraint.is_path else square
