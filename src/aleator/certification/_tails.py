"""Limits on tails, confirmed by fresh systems in these tails.

An expansion whose mean and spread are right may be wrong in a tail, where none of its points lies. What a limit on a
quantile, a probability or a mean beyond a quantile hangs on is simulated there: fresh systems come from a mixture of
the given distribution and of normal distributions around the directions in which the expansion is largest or smallest,
and are weighted by the ratio of the densities (importance sampling). The difference between the statistic of what is
simulated and that of what the expansion predicts of the same systems corrects the expansion's own (a control variate).
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import jax_array
from aleator.certification._check import ROUNDING, Check
from aleator.certification._systems import FreshSystems
from aleator.design import AbstractScopeOfInstants, Expression, Statistic, statistics_in
from aleator.statistics import (
    AbstractStatistic,
    AbstractTail,
    ConditionalValueAtRisk,
    Probability,
    Quantile,
    points_in_tail,
    tail_proposal,
)
from aleator.transcription import excess_of
from aleator.uncertainty import named_numbers

# An error of a statistic that moves an optimum: this part of its distance from the mean or of a tenth of the spread;
# for a probability, and for that beyond a quantile, this part of it, which is about as much in a normal distribution.
_TOLERATED, _OF_A_CHANCE = 0.01, 0.1
# Fresh systems in a tail: so many at first, unless the first draw shows that a limit cannot hang on them, and so many
# at most, four times as many each time.
_FIRST, _LAST = 128, 2048
# How far around a quantile its density is taken, as a part of its distance from the mean.
_AROUND = 0.1


class _Tail(NamedTuple):
    """A statistic in an expression: which one, of which entry of a path, and what it says.

    - `entry`: an instant of the finer grid, none without time;
    - `value`, `mean`, `std`: the statistic, and the moments of the functional.
    """

    atom: Statistic
    entry: tuple[int, ...]
    value: float
    mean: float
    std: float

    @classmethod
    def of(cls, atom: Statistic, entry: tuple[int, ...], check: Check) -> "_Tail":
        """That of a statistic at an instant of the problem's own grid."""
        at, functional = tuple(one * check.factor for one in entry), check.functionals[atom.functionals[0]]
        return cls(
            atom, at, float(check.statistics[atom][entry]), float(functional.mean[at]), float(functional.std[at])
        )

    def tolerated(self, predicted: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]) -> float:
        """How wrong the statistic may be; systems as in `differences`."""
        if isinstance(self.kind, Probability):
            return _OF_A_CHANCE * self.chance
        away = _TOLERATED * self.reach
        is_quantile = isinstance(self.kind, Quantile)
        return min(away, _OF_A_CHANCE * self.chance / self.density(predicted, weights)) if is_quantile else away

    def density(self, predicted: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]) -> float:
        """The probability density around the statistic."""
        around = _AROUND * self.reach
        share = np.average(np.abs(predicted - self.value) < around, weights=weights)
        return max(float(share) / (2 * around), np.finfo(float).tiny)

    @property
    def chance(self) -> float:
        """The probability of its tail, the smaller one."""
        return max(self.kind.tail(self.value)[0], np.finfo(float).tiny)

    @property
    def reach(self) -> float:
        """How far the statistic lies from the mean, a tenth of the spread at least."""
        return max(abs(self.value - self.mean), 0.1 * self.std)

    @property
    def kind(self) -> AbstractTail:
        """Its statistic."""
        assert isinstance(self.atom.kind, AbstractTail)
        return self.atom.kind

    def differences(
        self, values: Float[np.ndarray, " n"], predicted: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """The contribution of each system to the error of the statistic: their weighted mean is the error."""
        kind = self.kind
        if isinstance(kind, Probability):
            inside = (np.asarray(kind.holds(one, is_rounded=True), float) for one in (values, predicted))
            return next(inside) - next(inside)
        if isinstance(kind, ConditionalValueAtRisk):
            level, sign = float(kind.level), -1.0 if kind.lower else 1.0
            order = np.argsort(predicted)
            summed = np.cumsum(weights[order])
            quantile = predicted[order[np.searchsorted(summed, level * summed[-1]).clip(max=len(order) - 1)]]
            short = [np.maximum(sign * (one - quantile), 0.0) for one in (values, predicted)]
            return sign * (short[0] - short[1]) / (level if kind.lower else 1 - level)
        return (1.0 * (predicted < self.value) - 1.0 * (values < self.value)) / self.density(predicted, weights)


class KnownStatistics(AbstractScopeOfInstants):
    """A scope of statistics that are known, with a last axis of what they may be."""

    def __init__(self, check: Check, known: Mapping[Statistic, np.ndarray]):
        self._check, self._known = check, known

    @cached_property
    def step(self) -> float:  # type: ignore[override]
        times = self._check.times
        return float(times[1] - times[0]) if len(times) > 1 else 1.0

    @override
    def statistic(self, functionals: tuple, kind: AbstractStatistic) -> Array:
        return self._known[Statistic(functionals, kind)]  # type: ignore[return-value]

    @override
    def value(self, name: str) -> Array:
        # The model's numbers take longer than all the rest, and few problems need any.
        return named_numbers(self._check.problem.simulation, jax_array(self._check.meaning.decisions))[name]


def tail_objections(check: Check, varying: Collection[str]) -> Iterator[tuple[str, bool]]:
    """A sentence on each statistic of a tail that fresh systems in it contradict or cannot confirm, and whether the
    answer hangs on it.

    `varying`: the texts of the functionals that are not certain.
    """
    problem, known = check.problem, {}
    for which, expression in enumerate(problem.expressions):
        gaps = -excess_of(problem.constraints[which - 1], check.at_instants(which - 1)) if which else None
        for atom in statistics_in((expression,)):
            one = atom.functionals[0]
            if not isinstance(atom.kind, AbstractTail) or one.text() not in varying or (one.is_path and gaps is None):
                continue
            entry = (int(np.argmin(gaps)),) if one.is_path and gaps is not None else ()
            tail = _Tail.of(atom, entry, check)
            if tail.std <= ROUNDING * abs(tail.mean):
                continue  # A path may be certain at some instants, as at its start.

            def matters(
                by: float, expression: Expression = expression, atom: Statistic = atom, gaps: Any = gaps
            ) -> bool:
                """Whether the answer may hang on an error of this size: a limit that is not nearly active does not."""
                return gaps is None or not float(np.min(gaps)) > 2 * _effect(check, expression, atom, by)

            if (atom, entry) not in known:
                known[atom, entry] = _error(check, tail, matters)
            error, uncertainty, tolerated, count = known[atom, entry]
            by = abs(error) + 2 * uncertainty
            if abs(error) <= tolerated and (by <= 3 * tolerated or not matters(by)):
                continue
            seen = f"{tail.value + error:.4g} ± {2 * uncertainty:.2g}"
            sentence = f"{atom.text()} is {tail.value:.4g} by the expansion, and {seen} by {count} systems in its tail"
            if abs(error) <= 2 * uncertainty:
                sentence = f"{sentence}, too few to tell"
            if gaps is None:
                yield sentence, not _effect(check, expression, atom, by) <= check.gained
            else:
                yield f"'{problem.constraints[which - 1].name}': {sentence}", matters(by)


def _error(check: Check, tail: _Tail, matters: Callable[[float], bool]) -> tuple[float, float, float, int]:
    """The error of a statistic by fresh systems in its tail, its standard error, what is tolerated, and their number.

    `matters`: whether the answer may hang on an error, below which no more systems are drawn.
    """
    size, functional, of = len(check.systems.points), tail.atom.functionals[0], (slice(None), *tail.entry)
    values, predicted, weights = (np.zeros(0) for _ in range(3))
    coefficients, least = check.functionals[functional].coefficients[of], size
    basis, lines = check.transcribed.discretised.basis, check.transcribed.constants.of(tail.kind)
    proposal = tail_proposal(basis, lines, coefficients, tail.chance, lower=tail.kind.tail(tail.value)[1])
    while True:
        draws = range(len(values) // size, -(-max(least, size) // size))
        own = check.again(FreshSystems(*points_in_tail(proposal, basis, size, draw)) for draw in draws)
        values = np.concatenate([values, own.functionals[functional].fresh[of]])
        predicted = np.concatenate([predicted, own.functionals[functional].predicted[of]])
        weights = np.concatenate([weights, own.systems.weights])
        each, share = tail.differences(values, predicted, weights), weights / weights.sum()
        error = float(share @ each)
        uncertainty = float(np.sqrt(np.sum((share * (each - error)) ** 2)))
        tolerated = tail.tolerated(predicted, weights)
        is_clear = len(values) >= _FIRST and abs(abs(error) - tolerated) > 2 * uncertainty
        is_harmless = not matters(abs(error) + 2 * uncertainty)
        if is_clear or is_harmless or len(values) >= _LAST or not np.isfinite(error):
            # What the integral over the expansion is off by, with the fewer lines and points of a path, and may be off
            # by with all lines, is none of the systems' doing.
            value, half = tail.kind.estimated(np.asarray(coefficients), lines)
            whole = error + float(value) - tail.value
            return whole, float(np.hypot(uncertainty, float(half) / 2)), tolerated, len(values)
        least = max(4 * len(values), _FIRST)


def _effect(check: Check, expression: Expression, moved: Statistic, by: float) -> float:
    """How much an expression changes with one of its statistics."""
    own = check.statistics.items()
    known = {atom: np.stack([value, value + by * (atom == moved)], axis=-1) for atom, value in own}
    values = np.asarray(expression.evaluate(KnownStatistics(check, known)))
    return float(np.max(np.abs(values[..., 1] - values[..., 0])))
