"""Limits on probabilities as limits on quantiles, which say the same and are flat nowhere.

Away from its limit a probability is 0 or 1 whatever the decisions are, so that no search by derivatives finds its way.
`P[x < v] ≤ p` if and only if `Q_p[x] ≥ v`.
"""

from typing import NamedTuple

import equinox as eqx
import numpy as np

from aleator._core.arrays import Scalar
from aleator.design._expression import Constraint, Expression
from aleator.design._problem import Problem
from aleator.design._statistic import AbstractFunctional, Statistic
from aleator.statistics import Probability, Quantile


class LimitedProbability(NamedTuple):
    """A limit `constant + factor P ≤ bound`, or `≥`, where `P` is `P[x < threshold]`, or `P[x > threshold]`.

    - `chance`: what it bounds `P` by; `is_most`: whether from above.
    """

    functional: AbstractFunctional
    kind: Probability
    threshold: Scalar
    is_below: bool
    factor: float
    constant: float
    chance: float
    is_most: bool

    @property
    def quantile(self) -> Quantile:
        """The quantile that the threshold bounds instead."""
        return Quantile(self.chance if self.is_below else 1 - self.chance)

    @property
    def level_by_bound(self) -> float:
        """The derivative of the quantile's level by the bound of the limit."""
        return (1.0 if self.is_below else -1.0) / self.factor


def limited_probability(limit: Constraint) -> LimitedProbability | None:
    """The probability that a limit bounds; None if it bounds something else, two sides of one, or every instant."""
    expression, ends = limit.expression, [end for end in (limit.lower, limit.upper) if np.isfinite(float(end))]
    if len(expression.atoms) != 1 or len(ends) != 1 or expression.is_path:
        return None
    (atom,), factor, constant = expression.atoms, float(expression.factors[0]), float(expression.constant)
    kind = atom.kind if isinstance(atom, Statistic) else None
    if not isinstance(atom, Statistic) or not isinstance(kind, Probability) or factor == 0:
        return None
    thresholds = [one for one in (kind.below, kind.above) if one is not None]
    chance, is_most = (float(ends[0]) - constant) / factor, np.isfinite(float(limit.upper)) == (factor > 0)
    if len(thresholds) != 1 or not 0 < chance < 1:
        return None
    functional, is_below = atom.functionals[0], kind.above is None
    return LimitedProbability(functional, kind, thresholds[0], is_below, factor, constant, chance, bool(is_most))


def in_quantiles(problem: Problem) -> Problem:
    """The same problem with its limits on probabilities as limits on quantiles."""
    return _with_limits(problem, [_in_quantile(one) for one in problem.constraints])


def as_declared(problem: Problem) -> Problem:
    """The problem with its limits as they were declared: the inverse of `in_quantiles`."""
    return _with_limits(problem, [one if one.declared is None else one.declared for one in problem.constraints])


def _with_limits(problem: Problem, limits: list[Constraint]) -> Problem:
    if all(one is other for one, other in zip(limits, problem.constraints, strict=True)):
        return problem
    return eqx.tree_at(lambda one: one.constraints, problem, tuple(limits))


def _in_quantile(limit: Constraint) -> Constraint:
    one = limited_probability(limit)
    if one is None:
        return limit
    quantile = Expression((1.0,), (Statistic((one.functional,), one.quantile),))
    is_least = one.is_below == one.is_most
    return (quantile >= one.threshold if is_least else quantile <= one.threshold).instead_of(limit)
