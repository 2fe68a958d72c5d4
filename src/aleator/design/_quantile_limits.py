"""Limits on probabilities for searches, to which these are flat: 0 or 1 away from a bound, whatever the decisions are.

`P[x < v] ≤ p` if and only if `Q_p[x] ≥ v`, and a quantile is flat nowhere. Other expressions of probabilities are
searched with spreads that are first much larger than they are.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from aleator._core.arrays import Scalar
from aleator.design._expression import Constraint, Expression
from aleator.design._problem import Problem
from aleator.design._statistic import AbstractFunctional, Statistic, statistics_in
from aleator.statistics import Probability, Quantile, Widened


class LimitedProbability(NamedTuple):
    """A limit on `constant + factor P`, where `P` is `P[x < threshold]`, or `P[x > threshold]`.

    - `chance`: what it bounds `P` by; `is_most`, `is_least`: from above, from below, or both if it is an equality.
    """

    functional: AbstractFunctional
    kind: Probability
    threshold: Scalar
    is_below: bool
    factor: float
    constant: float
    chance: float
    is_most: bool
    is_least: bool

    @property
    def excludes_nothing(self) -> bool:
        """Whether each probability keeps it."""
        return (not self.is_least and self.chance >= 1) or (not self.is_most and self.chance <= 0)

    @property
    def quantile(self) -> Quantile:
        """The quantile that the threshold bounds instead."""
        return Quantile(self.chance if self.is_below else 1 - self.chance)

    @property
    def level_by_bound(self) -> float:
        """The derivative of the quantile's level by the bound of the limit."""
        return (1.0 if self.is_below else -1.0) / self.factor


def limited_probability(limit: Constraint) -> LimitedProbability | None:
    """The probability that a limit bounds; None if it bounds something else, a range, or every instant."""
    expression, ends = limit.expression, [float(end) for end in (limit.lower, limit.upper)]
    bounds = {end for end in ends if np.isfinite(end)}
    if len(expression.atoms) != 1 or len(bounds) != 1 or expression.is_path:
        return None
    (atom,), factor, constant = expression.atoms, float(expression.factors[0]), float(expression.constant)
    kind = atom.kind if isinstance(atom, Statistic) else None
    if not isinstance(atom, Statistic) or not isinstance(kind, Probability) or factor == 0:
        return None
    thresholds = [one for one in (kind.below, kind.above) if one is not None]
    if len(thresholds) != 1:
        return None
    sides = [bool(np.isfinite(end)) for end in (ends if factor < 0 else ends[::-1])]
    parts = atom.functionals[0], kind, thresholds[0], kind.above is None, factor, constant
    return LimitedProbability(*parts, (bounds.pop() - constant) / factor, *sides)


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
    if one.excludes_nothing:  # out of reach of rounding
        return limit.with_bounds(float(limit.lower) - abs(one.factor), float(limit.upper) + abs(one.factor)).instead_of(
            limit
        )
    if not 0 < one.chance < 1:
        return limit
    quantile = Expression((1.0,), (Statistic((one.functional,), one.quantile),))
    is_most, is_least = (one.is_least, one.is_most) if one.is_below else (one.is_most, one.is_least)
    if is_most and is_least:
        return quantile.equals(float(one.threshold)).instead_of(limit)
    return (quantile <= one.threshold if is_most else quantile >= one.threshold).instead_of(limit)


def widened(problem: Problem, factor: float) -> Problem | None:
    """The same problem with spreads a factor as large wherever a probability is asked for; None if none is."""

    def is_probability(node: Any) -> bool:
        return isinstance(node, Statistic) and isinstance(node.kind, Probability)

    def wide(node: Any) -> Any:
        return Statistic(node.functionals, Widened(node.kind, factor)) if is_probability(node) else node

    if not any(map(is_probability, statistics_in(problem.expressions))):
        return None
    parts = problem.objective, problem.constraints
    return eqx.tree_at(
        lambda one: (one.objective, one.constraints), problem, jax.tree.map(wide, parts, is_leaf=is_probability)
    )
