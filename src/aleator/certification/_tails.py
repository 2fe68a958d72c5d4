"""Limits on tails, confirmed by fresh systems in these tails.

An expansion whose mean and spread are right may be wrong in a tail, where none of its points lies. What a limit on a
quantile, a probability or a mean beyond a quantile hangs on is simulated there: fresh systems come from a mixture of
the given distribution and of normal distributions around the directions in which the expansion is largest or smallest,
and are weighted by the ratio of the densities (importance sampling). The difference between the statistic of what is
simulated and that of what the expansion predicts of the same systems corrects the expansion's own (a control variate).
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import jax_array
from aleator._core.compilation import Use, evaluate
from aleator.certification._check import Check, begin_check, certain
from aleator.certification._fresh import FreshSystems
from aleator.design import AbstractScopeOfInstants, Expression, Statistic, functionals_of, statistics_in
from aleator.statistics import AbstractStatistic, AbstractTail, ConditionalValueAtRisk, Probability, points_in_tail
from aleator.transcription import AbstractTranscribed
from aleator.uncertainty import named_numbers

# An error of a statistic that moves an optimum: this part of its distance from the mean or of a tenth of the spread;
# for a probability, this part of it, which is about as much.
_TOLERATED, _OF_A_CHANCE = 0.01, 0.1
# Fresh systems in a tail: so many at first, and so many at most, four times as many each time.
_FIRST, _LAST = 128, 2048
# How far around a quantile its density is taken, as a part of its distance from the mean.
_AROUND = 0.1


class _Tail(NamedTuple):
    """A statistic in an expression: which one, of which entry of a path, and what it says.

    - `functional`: its number among those of the problem; `entry`: an instant of the grid, none without time;
    - `value`, `mean`, `std`: the statistic, and the moments of the functional.
    """

    atom: Statistic
    functional: int
    entry: tuple[int, ...]
    value: float
    mean: float
    std: float

    @property
    def tolerated(self) -> float:
        """How wrong the statistic may be."""
        if isinstance(self.atom.kind, Probability):
            return _OF_A_CHANCE * self.chance
        return _TOLERATED * max(abs(self.value - self.mean), 0.1 * self.std)

    @property
    def chance(self) -> float:
        """The probability of its tail, the smaller one."""
        kind = self.atom.kind
        level = self.value if isinstance(kind, Probability) else float(kind.level)  # type: ignore[attr-defined]
        return max(min(level, 1 - level), np.finfo(float).tiny)

    @property
    def is_lower(self) -> bool:
        """Whether its tail is that of the smaller values."""
        kind = self.atom.kind
        if isinstance(kind, Probability):
            return (kind.below is not None) == (self.value < 0.5)
        return float(kind.level) < 0.5  # type: ignore[attr-defined]

    def differences(
        self, values: Float[np.ndarray, " n"], predicted: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """The contribution of each system to the error of the statistic: their weighted mean is the error."""
        kind = self.atom.kind
        if isinstance(kind, Probability):
            above = -np.inf if kind.above is None else float(kind.above)
            below = np.inf if kind.below is None else float(kind.below)
            return 1.0 * ((values > above) & (values < below)) - 1.0 * ((predicted > above) & (predicted < below))
        if isinstance(kind, ConditionalValueAtRisk):
            level, sign = float(kind.level), -1.0 if kind.lower else 1.0
            order = np.argsort(predicted)
            summed = np.cumsum(weights[order])
            quantile = predicted[order[np.searchsorted(summed, level * summed[-1]).clip(max=len(order) - 1)]]
            short = [np.maximum(sign * (one - quantile), 0.0) for one in (values, predicted)]
            return sign * (short[0] - short[1]) / (level if kind.lower else 1 - level)
        reach = _AROUND * max(abs(self.value - self.mean), 0.1 * self.std)
        density = np.average(np.abs(predicted - self.value) < reach, weights=weights) / (2 * reach)
        return (1.0 * (predicted < self.value) - 1.0 * (values < self.value)) / max(density, np.finfo(float).tiny)


class KnownStatistics(AbstractScopeOfInstants):
    """A scope of statistics that are known, with a last axis of what they may be."""

    def __init__(self, transcribed: AbstractTranscribed, point: np.ndarray, known: Mapping[str, np.ndarray]):
        meaning = transcribed.at(point)
        self._known, self._decisions = known, meaning.decisions
        self._simulation = transcribed.problem.simulation
        self.step = float(meaning.times[1] - meaning.times[0]) if len(meaning.times) > 1 else 1.0

    @override
    def statistic(self, functionals: tuple, kind: AbstractStatistic) -> Array:
        return self._known[Statistic(functionals, kind).text()]  # type: ignore[return-value]

    @override
    def value(self, name: str) -> Array:
        # The model's numbers take longer than all the rest, and few problems need any.
        return named_numbers(self._simulation, jax_array(self._decisions))[name]


def tail_objections(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], check: Check
) -> Iterator[tuple[str, bool]]:
    """A sentence on each statistic of a tail that fresh systems in it contradict or cannot confirm, and whether the
    answer hangs on it.
    """
    problem, meaning = transcribed.problem, transcribed.at(point)
    statistics = dict(zip(statistics_in(problem.expressions), check.statistics, strict=True))
    constant = certain(transcribed, point, check)
    known = {}
    for which, expression in enumerate(problem.expressions):
        for atom in statistics_in((expression,)):
            of_tail = isinstance(atom.kind, AbstractTail) and atom.functionals[0] not in constant
            if not of_tail or (atom.functionals[0].is_path and which == 0):
                continue
            limit = problem.constraints[which - 1] if which else None
            values = (
                meaning.objective if limit is None else transcribed.at_instants(limit, meaning.constraints[which - 1])
            )
            gaps = np.inf if limit is None else np.minimum(float(limit.upper) - values, values - float(limit.lower))
            entry = (int(np.argmin(gaps)),) if atom.functionals[0].is_path else ()
            tail = _tail(transcribed, atom, entry, check, statistics)
            if (tail.atom, entry) not in known:
                known[tail.atom, entry] = _error(transcribed, point, check, tail)
            error, uncertainty, count = known[tail.atom, entry]
            if abs(error) + 2 * uncertainty <= 3 * tail.tolerated and abs(error) <= tail.tolerated:
                continue
            seen = f"{tail.value + error:.4g} ± {2 * uncertainty:.2g}"
            sentence = f"{atom.text()} is {tail.value:.4g} by the expansion, and {seen} by {count} systems in its tail"
            effect = abs(_effect(transcribed, point, check, expression, statistics, tail, abs(error) + 2 * uncertainty))
            if limit is None:
                hangs = effect > abs(transcribed.at(transcribed.program.start).objective - meaning.objective)
            else:
                hangs = float(np.min(gaps)) <= 2 * effect
            yield (f"'{limit.name}': {sentence}" if limit is not None else sentence), hangs


def _tail(
    transcribed: AbstractTranscribed,
    atom: Statistic,
    entry: tuple[int, ...],
    check: Check,
    statistics: Mapping[Statistic, np.ndarray],
) -> _Tail:
    number = functionals_of(transcribed.problem.expressions).index(atom.functionals[0])
    at = tuple(one * check.factor for one in entry)
    moments = (float(np.asarray(every[number])[at]) for every in (check.means, check.stds))
    return _Tail(atom, number, at, float(np.asarray(statistics[atom])[at]), *moments)


def _error(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], check: Check, tail: _Tail
) -> tuple[float, float, int]:
    """The error of a statistic by fresh systems in its tail, its standard error, and their number."""
    size, least = len(check.systems.points), _FIRST
    values, predicted, weights = (np.zeros(0) for _ in range(3))
    coefficients = check.coefficients[tail.functional][(slice(None), *tail.entry)]
    lines = transcribed.constants.of(tail.atom.kind)
    while True:
        draws = range(len(values) // size, -(-max(least, size) // size))
        systems = (_systems(transcribed, coefficients, tail, size, draw) for draw in draws)
        waiting = [begin_check(transcribed, point, check.factor, one) for one in systems]
        for one in (begun() for begun in waiting):
            of = (slice(None), *tail.entry)
            values = np.concatenate([values, one.fresh[tail.functional][of]])
            predicted = np.concatenate([predicted, one.predicted[tail.functional][of]])
            weights = np.concatenate([weights, one.systems.weights])
        each, share = tail.differences(values, predicted, weights), weights / weights.sum()
        error = float(share @ each)
        uncertainty = float(np.sqrt(np.sum((share * (each - error)) ** 2)))
        is_clear = abs(abs(error) - tail.tolerated) > 2 * uncertainty
        if is_clear or len(values) >= _LAST or not np.isfinite(error):
            # What the integral over the expansion may be off by is none of the systems' doing.
            _, half = evaluate(_estimated, tail.atom.kind, jax_array(coefficients), lines, use=Use.BRIEF)
            return error, float(np.hypot(uncertainty, float(half) / 2)), len(values)
        least = 4 * len(values)


def _estimated(kind: AbstractTail, coefficients: Array, lines: Any) -> tuple[Array, Array]:
    return kind.estimated(coefficients, lines)


def _systems(
    transcribed: AbstractTranscribed, coefficients: np.ndarray, tail: _Tail, count: int, draw: int
) -> FreshSystems:
    basis, lines = transcribed.discretised.basis, transcribed.constants.of(tail.atom.kind)
    return FreshSystems(*points_in_tail(basis, lines, coefficients, tail.chance, count, lower=tail.is_lower, seed=draw))


def _effect(
    transcribed: AbstractTranscribed,
    point: Float[np.ndarray, " variables"],
    check: Check,
    expression: Expression,
    statistics: Mapping[Statistic, np.ndarray],
    tail: _Tail,
    by: float,
) -> float:
    """How much an expression changes with one of its statistics."""
    known = {}
    for atom, value in statistics.items():
        own = np.asarray(value)[:: check.factor] if atom.functionals[0].is_path else np.asarray(value)
        known[atom.text()] = np.stack([own, own + by * (atom == tail.atom)], axis=-1)
    values = np.asarray(expression.evaluate(KnownStatistics(transcribed, point, known)))
    return float(np.max(np.abs(values[..., 1] - values[..., 0])))
