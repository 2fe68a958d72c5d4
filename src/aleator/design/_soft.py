"""`soft`: a problem whose limits are penalties in its objective."""

from collections.abc import Mapping, Sequence

import numpy as np

from aleator._core.border import a_name, one_of, positive, refusal
from aleator._core.errors import ProblemError
from aleator.design._expression import Constraint, Expression, as_expression, value
from aleator.design._objectives import positive_part, pure, time_integral
from aleator.design._problem import Problem, declared_anew
from aleator.uncertainty import Decision

# The first value of an excess, as a part of the limit.
_FIRST_EXCESS = 0.1


def soft(problem: Problem, *names: str, weight: float, exact: bool = False, most: float | None = None) -> Problem:
    """The same problem with the constraints of these names, or all of them, as penalties in its objective.

    A limit `x <= b` becomes `weight (x - b)₊²`, which is zero where it holds (equation 7); an equality `x = b` becomes
    `weight (x - b)²` (8); both are integrated over time where the constraint holds at every instant. Without any
    constraint left it is the unconstrained form of the design: (94) of (93), (101) of (95), (124) of (122).

    - `weight`: how much one unit of excess costs, in the unit of the objective per square of the constraint's (and
      second, of a path). The larger, the less a limit is exceeded at the optimum, in inverse proportion; it still is,
      wherever it would be active. Several weights: `soft(soft(problem, "a", weight=1e3), "b", weight=10.0)`;
    - `exact`: the penalty is `weight` times the largest excess itself, over all instants and all constraints of one
      name, by a slack that is decided too: `"a.excess"` of the constraint `"a"`, which stays, loosened by it. Above the
      sum of the constraint's shadow prices the limit then holds exactly (Fletcher 1987, 12.3); below, it is exceeded;
    - `most`: the largest excess that an exact penalty allows, in the constraint's unit, beyond which the limit is hard;
      none by default. Searches, which look between bounds, need it.

    The problem given is unchanged. Raises `ProblemError` for names that no constraint has, if there is no constraint,
    for a weight that is not positive, for limits on the worst case unless `exact`, since they hold realisation by
    realisation, and if the name of a slack is taken, as where a limit is made soft twice.
    """
    problem, weight = one_of("soft", problem, Problem), positive("soft: weight", weight)
    if not isinstance(exact, bool):
        raise refusal("soft: exact", "True or False", exact)
    if most is not None and not exact:
        raise refusal("soft: most", "it with exact=True alone, whose slack it bounds", most)
    largest = np.inf if most is None else positive("soft: most", most)
    if not problem.constraints:
        raise ProblemError("soft: the problem has no constraints that could become penalties.")
    chosen = tuple(dict.fromkeys(a_name("soft: a constraint", name) for name in names)) or problem.names
    softened = {name: problem.named(name) for name in chosen}
    return _with_slacks(problem, softened, weight, largest) if exact else _with_penalties(problem, softened, weight)


def _with_penalties(problem: Problem, softened: Mapping[str, tuple[Constraint, ...]], weight: float) -> Problem:
    penalties = [_penalty(one) for every in softened.values() for one in every]
    return declared_anew(
        problem,
        problem.simulation,
        minimize=problem.objective + weight * sum(penalties, start=as_expression(0.0)),
        subject_to=tuple(one for one in problem.constraints if one.name not in softened),
    )


def _with_slacks(
    problem: Problem, softened: Mapping[str, tuple[Constraint, ...]], weight: float, most: float
) -> Problem:
    slacks = {_excess(name): _slack(every, most) for name, every in softened.items()}
    if taken := [
        name for name in softened if _excess(name) in {*problem.simulation.numbers, *problem.placements.decisions}
    ]:
        raise ProblemError(
            f"soft: expected no number called '{_excess(taken[0])}' yet, which is the slack of the constraint "
            f"'{taken[0]}'; received a problem that has one. Make a limit soft once, with one weight, or give the "
            "constraint another name by .named(...)."
        )
    kept = [loose for one in problem.constraints for loose in (_loosened(one) if one.name in softened else [one])]
    return declared_anew(
        problem,
        problem.simulation,
        minimize=problem.objective + weight * sum(map(pure, map(value, slacks)), start=as_expression(0.0)),
        subject_to=tuple(kept),
        decisions=slacks,
    )


def _excess(name: str) -> str:
    """The name of a constraint's slack."""
    return f"{name}.excess"


def _slack(constraints: Sequence[Constraint], most: float) -> Decision:
    """What some constraints are exceeded by, started at a tenth of their largest bound."""
    sizes = [abs(bound) for one in constraints for bound in (float(one.lower), float(one.upper)) if np.isfinite(bound)]
    return Decision(min(_FIRST_EXCESS * (max(sizes) or 1.0), most), 0.0, most)


def _loosened(constraint: Constraint) -> list[Constraint]:
    """A constraint whose finite bounds are loosened by its slack, each in a constraint of its own."""
    expression, excess, name = constraint.expression, value(_excess(constraint.name)), constraint.name
    lower, upper = float(constraint.lower), float(constraint.upper)
    above = [Constraint(expression - excess, upper=upper, name=name)] if np.isfinite(upper) else []
    below = [Constraint(expression + excess, lower=lower, name=name)] if np.isfinite(lower) else []
    return [*above, *below]


def _penalty(constraint: Constraint) -> Expression:
    """The square of what a constraint is missed by, over time if it holds at every instant."""
    expression, lower, upper = constraint.expression, float(constraint.lower), float(constraint.upper)
    if lower == upper:
        missed = [expression - upper]
    else:
        missed = [positive_part(expression - upper)] if np.isfinite(upper) else []
        missed += [positive_part(lower - expression)] if np.isfinite(lower) else []
    square = sum((one**2 for one in missed), start=as_expression(0.0))
    # Its weight carries a unit.
    return pure(time_integral(square) if constraint.is_path else square)
