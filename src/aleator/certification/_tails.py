"""Limits on tails, confirmed by fresh systems in these tails.

An expansion whose mean and spread are right may be wrong in a tail, where none of its points lies. What a limit on a
quantile, a probability or a mean beyond a quantile hangs on is simulated there: fresh systems come from a mixture of
the given distribution and of normal distributions around the directions in which the expansion is largest or smallest,
and are weighted by the ratio of the densities (importance sampling). The difference between the statistic of what is
simulated and that of what the expansion predicts of the same systems corrects the expansion's own (a control variate).
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import jax_array
from aleator.certification._check import ROUNDING, Check
from aleator.certification._systems import FreshSystems
from aleator.design import LEAST_CHANCE, AbstractScopeOfInstants, Expression, Statistic, statistics_in
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

# An error of a statistic that moves an optimum: this part of its distance from the mean, or of the spread; for a
# probability, and for that beyond a quantile, this part of it, which is about as much in a normal distribution.
_TOLERATED, _OF_A_CHANCE = 0.01, 0.1
# Fresh systems in a tail: so many at first, unless the first draw shows that a limit cannot hang on them, and so many
# at most, four times as many each time.
_FIRST, _LAST = 128, 2048
# So many are predicted alone, by a draw of their own, where the integral over the expansion is in doubt.
_MANY, _DRAW = 2**14, 10**6
# How far around a quantile its density is taken, as a part of its distance from the mean.
_AROUND = 0.1
_TINY = np.finfo(float).tiny


class _Seen(NamedTuple):
    """Fresh systems in a tail: a functional as simulated and as predicted, and their weights."""

    values: Float[np.ndarray, " n"]
    predicted: Float[np.ndarray, " n"]
    weights: Float[np.ndarray, " n"]


class _Tail(NamedTuple):
    """A statistic of one functional, or of an entry of it.

    - `at`: its place among the functional's values on the finer grid, the instant first; empty for a number;
    - `value`: the statistic; `chance`: the probability of its tail, the smaller one; `is_lower`: which tail that is;
    - `reach`: how far it lies from the mean, the spread at least.
    """

    kind: AbstractTail
    at: tuple[int, ...]
    value: float
    chance: float
    is_lower: bool
    reach: float

    def tolerated(self, seen: _Seen) -> float:
        """How wrong the statistic may be."""
        if isinstance(self.kind, Probability):
            return _OF_A_CHANCE * max(self.chance, LEAST_CHANCE)
        of_chance = _OF_A_CHANCE * self.chance / self.density(seen) if isinstance(self.kind, Quantile) else np.inf
        return min(_TOLERATED * self.reach, of_chance)

    def density(self, seen: _Seen) -> float:
        """The probability density around the statistic."""
        around = _AROUND * self.reach
        share = np.average(np.abs(seen.predicted - self.value) < around, weights=seen.weights)
        return max(float(share) / (2 * around), _TINY)

    def error(self, seen: _Seen) -> tuple[float, float]:
        """The error of the statistic, and its standard error."""
        kind, share, both = self.kind, seen.weights / seen.weights.sum(), (seen.values, seen.predicted)
        moved, local = 0.0, 0.0
        if isinstance(kind, Probability):
            inside = [np.asarray(kind.holds(one, is_rounded=True), float) for one in both]
            each = inside[0] - inside[1]
        elif isinstance(kind, ConditionalValueAtRisk):
            simulated, predicted = (_beyond(kind, one, share) for one in both)
            each = simulated - predicted
        else:
            # Beside the known quantile, the error is that of the value of the same rank.
            at = int(np.argmin(np.where(seen.predicted < self.value, np.inf, seen.predicted)))
            below = seen.predicted < seen.predicted[at]
            end = _quantile(seen.values, share, float(share @ below + share[at] / 2))
            moved, each = end - seen.predicted[at], (1.0 * below - 1.0 * (seen.values < end)) / self.density(seen)
            each -= share @ each
            away = np.minimum(np.abs(seen.predicted - self.value), np.abs(seen.values - end))
            near = np.where(away < _AROUND * self.reach, share, 0.0)
            local = _standard_error(seen.values - seen.predicted, near / max(near.sum(), _TINY))
        return float(moved + share @ each), float(np.hypot(_standard_error(each, share), local))

    def scatter(self, seen: _Seen) -> tuple[float, float]:
        """How far the statistic is from that of systems as predicted, by chance alone, and the standard error."""
        kind, share, values = self.kind, seen.weights / seen.weights.sum(), seen.predicted
        if isinstance(kind, Probability):
            each = np.asarray(kind.holds(values, is_rounded=True), float) - self.value
        elif isinstance(kind, ConditionalValueAtRisk):
            each = _beyond(kind, values, share) - self.value
        else:
            each = ((values < self.value) - float(kind.level)) / self.density(seen)
        return float(share @ each), _standard_error(each, share)


def _beyond(
    kind: ConditionalValueAtRisk, values: Float[np.ndarray, " n"], share: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Numbers whose mean is that of the values beyond their quantile."""
    level, sign = float(kind.level), -1.0 if kind.lower else 1.0
    end, chance = _quantile(values, share, level), level if kind.lower else 1 - level
    return end + sign * np.maximum(sign * (values - end), 0.0) / chance


def _standard_error(values: Float[np.ndarray, " n"], share: Float[np.ndarray, " n"]) -> float:
    """That of a mean of values that have shares."""
    return float(np.sqrt(np.sum((share * (values - share @ values)) ** 2)))


def _quantile(values: Float[np.ndarray, " n"], share: Float[np.ndarray, " n"], level: float) -> float:
    """The quantile of values that have shares."""
    order = np.argsort(values)
    return float(values[order[np.searchsorted(np.cumsum(share[order]), level).clip(max=len(order) - 1)]])


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
    known = {}
    for which, expression in enumerate(check.problem.expressions):
        limit = check.problem.constraints[which - 1] if which else None
        gaps = None if limit is None else -excess_of(limit, check.at_instants(which - 1))
        for atom in statistics_in((expression,)):
            kind, one = atom.kind, atom.functionals[0]
            if not isinstance(kind, AbstractTail) or one.text() not in varying:
                continue
            functional, matters = check.functionals[one], partial(_matters, check, expression, atom, gaps)
            for entry in _entries(check, which, expression, atom, gaps):
                at = (entry[0] * check.factor, *entry[1:]) if one.is_path else entry
                value, mean, std = (
                    float(part) for part in (check.statistics[atom][entry], functional.mean[at], functional.std[at])
                )
                if std <= ROUNDING * abs(mean):
                    continue  # A path may be certain at some instants, as at its start.
                chance, is_lower = kind.tail(value)
                tail = _Tail(kind, at, value, max(chance, _TINY), is_lower, max(abs(value - mean), std))
                if (atom, entry) not in known:
                    known[atom, entry] = _error(check, atom, tail, matters)
                error, uncertainty, tolerated, count, half = known[atom, entry]
                by = abs(error) + 2 * uncertainty
                if abs(error) <= tolerated and (by <= 3 * tolerated or not matters(by)):
                    continue
                seen = f"{value + error:.4g} ± {2 * uncertainty:.2g} by {count} systems in its tail"
                unsure = ", too few to tell" if abs(error) <= 2 * uncertainty else ""
                if half > uncertainty:
                    unsure = f", of which ± {half:.2g} is how well its integral over the expansion is known"
                name = "" if limit is None else f"'{limit.name}': "
                hangs = matters(by) if which else not _effect(check, expression, atom, by) <= check.gained
                yield f"{name}{atom.text()} is {value:.4g} by the expansion, and {seen}{unsure}", hangs


def _entries(
    check: Check, which: int, expression: Expression, atom: Statistic, gaps: np.ndarray | None
) -> Collection[tuple[int, ...]]:
    """The entries of a statistic, an instant first, that systems are drawn for; that of a number is empty.

    For a limit, those for which it is closest to its bound, and for which it would be if the statistic followed the
    mean and spread of the fresh systems; for what all instants count in, that which would change most.
    """
    own = check.statistics[atom].shape
    if not own:
        return [()]
    one = check.functionals[atom.functionals[0]].at(check.own(atom.functionals[0]))
    away, foreseen = one.fresh - one.mean, one.predicted - one.mean
    missed = away - foreseen, away**2 - foreseen**2
    shift, squares = (np.average(each, axis=0, weights=one.weights) for each in missed)
    wider = np.sqrt(np.maximum(1 + (squares - shift**2) / np.maximum(one.std**2, _TINY), 0.0)) - 1
    moved = shift + (check.statistics[atom] - one.mean) * wider
    whole = np.shape(check.values[which][:: check.factor] if expression.is_path else check.values[which])
    if gaps is None or len(own) > len(whole):
        chosen = {int(np.argmax(np.abs(moved)))}
    else:
        limit, rows = check.problem.constraints[which - 1], check.at_instants(which - 1)
        follows = -excess_of(limit, rows + _change(check, expression, atom, moved).ravel())
        places = np.broadcast_to(np.arange(math.prod(own)).reshape(own), whole).ravel()
        chosen = {int(places[np.argmin(each)]) for each in (gaps, follows)}
    return [tuple(map(int, np.unravel_index(place, own))) for place in sorted(chosen)]


def _matters(check: Check, expression: Expression, atom: Statistic, gaps: np.ndarray | None, by: float) -> bool:
    """Whether the answer may hang on an error of a statistic: a limit that is not nearly active does not.

    `gaps`: those between the limit and its bound, None for the objective.
    """
    return gaps is None or not float(np.min(gaps)) > 2 * _effect(check, expression, atom, by)


def _error(
    check: Check, atom: Statistic, tail: _Tail, matters: Callable[[float], bool]
) -> tuple[float, float, float, int, float]:
    """The error of a statistic by fresh systems in its tail, its standard error, what is tolerated, their number, and
    the 95 % half-width of the statistic's integral over the expansion.

    `matters`: whether the answer may hang on an error, below which no more systems are drawn.
    """
    size, functional, of = len(check.systems.points), atom.functionals[0], (slice(None), *tail.at)
    coefficients, basis = check.functionals[functional].coefficients[of], check.transcribed.basis
    lines, least = check.transcribed.constants.of(tail.kind), size
    proposal = tail_proposal(basis, lines, coefficients, tail.chance, lower=tail.is_lower)
    seen = _Seen(*(np.zeros(0) for _ in _Seen._fields))
    while True:
        draws = range(len(seen.values) // size, -(-max(least, size) // size))
        own = check.of(FreshSystems.joined(FreshSystems(*points_in_tail(proposal, basis, size, one)) for one in draws))
        new = own.functionals[functional]
        parts = new.fresh[of], new.predicted[of], own.systems.weights
        seen = _Seen(*map(np.concatenate, zip(seen, parts, strict=True)))
        (error, uncertainty), tolerated, drawn = tail.error(seen), tail.tolerated(seen), len(seen.values)
        is_clear = drawn >= _FIRST and abs(abs(error) - tolerated) > 2 * uncertainty
        is_harmless = not matters(abs(error) + 2 * uncertainty)
        if is_clear or is_harmless or drawn >= _LAST or not np.isfinite(error):
            # What the integral over the expansion is off by, with the fewer lines and points of a path, and may be off
            # by with all lines, is none of the systems' doing.
            value, half = map(float, tail.kind.estimated(np.asarray(coefficients), lines))
            if half > tolerated:  # The scatter of a few replicates overstates it.
                points, weights = points_in_tail(proposal, basis, _MANY, _DRAW)
                predicted = basis.matrix(points) @ np.asarray(coefficients)
                away, scatter = tail.scatter(_Seen(predicted, predicted, weights))
                half = min(half, abs(away) + 2 * scatter)
            whole = error + value - tail.value
            return whole, float(np.hypot(uncertainty, half / 2)), tolerated, drawn, half
        least = max(4 * drawn, _FIRST)


def _effect(check: Check, expression: Expression, atom: Statistic, by: float) -> float:
    """How much an expression changes at most with one of its statistics."""
    return float(np.max(np.abs(_change(check, expression, atom, by))))


def _change(check: Check, expression: Expression, moved: Statistic, by: float | np.ndarray) -> np.ndarray:
    """How an expression changes with one of its statistics."""
    own = check.statistics.items()
    known = {atom: np.stack([value, value + by if atom == moved else value], axis=-1) for atom, value in own}
    values = np.asarray(expression.evaluate(KnownStatistics(check, known)))
    return values[..., 1] - values[..., 0]
