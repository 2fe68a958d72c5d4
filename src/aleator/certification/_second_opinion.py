"""A second opinion on a solution: fresh simulations at the answer, compared with predictions of the expansions.

Optimisers exploit errors of an expansion. Its errors at a few fresh systems correct each statistic (a control variate:
the expansion's own number plus the mean error), with a standard error by the jackknife. Both are those of CHECK, so
that the error of the grid is none of the expansion's.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator.certification._check import NEGLIGIBLE_SPREAD, Check, Checked
from aleator.certification._systems import OF_THE_SHAPE, FreshSystems, fresh_systems, has_shape, systems_of
from aleator.certification._tails import KnownStatistics, tail_objections
from aleator.design import Statistic, expanded_functionals, variances_by_noise
from aleator.ensemble import inputs_at, listed
from aleator.nlp import HELD
from aleator.solution import SecondOpinion
from aleator.statistics import (
    AbstractStatistic,
    ConditionalValueAtRisk,
    CornishFisher,
    Infimum,
    Mean,
    Probability,
    Quantile,
    Skewness,
    Std,
    Supremum,
    Variance,
)
from aleator.transcription import AbstractTranscribed, excess_of

Values = Float[np.ndarray, "systems ..."]
Replicates = Float[np.ndarray, "... replicates"]
Known = dict[Statistic, Replicates]

# The two-sided probabilities of four and of two standard deviations of a normal variable.
_RARE, _SHOWN = math.erfc(4 / math.sqrt(2)), math.erfc(2 / math.sqrt(2))
# Shifts up to the first part of the effect of one standard deviation are negligible; an excess over a bound by more
# than the second part breaks it.
_NONE, _BREAKS = 0.01, 0.05
# Expressions that change by less than this part of their size have not changed.
_ROUNDING = 1e-11
# A system that is missed by more standard deviations than this is a rare event, of which a few systems say little: more
# are drawn, and two standard errors show a shift.
_OUTLIER = 10.0
# How many systems are predicted, at most and at least, how many numbers they may have in all, and a draw of their own.
_MANY, _FEWEST, _NUMBERS, _DRAW = 2**15, 2**11, 2**23, 10**6
# An expansion has the statistic of these systems within so many standard errors and this part of its size.
_ERRORS, _PART = 4.0, 0.01

_IN_TAILS, _AT_ENDS = (Quantile, ConditionalValueAtRisk), (Supremum, Infimum)


def second_opinion(check: Check) -> SecondOpinion | None:
    """Compare the expansions at a point with fresh simulations; None if nothing is uncertain.

    Where these disagree, or are too few to tell, or one system is missed by far, as in a rare event that none of the
    collocation points sees, more systems are drawn, and a limit counts as broken if two standard errors show it.
    """
    count, problem = len(check.systems.points), check.problem
    if not count or not check.functionals:
        return None

    def grown(total: int) -> Check:
        draws = range(total // count)
        return check.of(FreshSystems.joined(systems_of(problem, one) for one in draws)) if len(draws) > 1 else check

    least, most = check.systems.least_and_most
    # Few systems tell nothing of third and fourth powers.
    opinion, is_unsure = _opinion(grown(most if has_shape(problem.expressions) else least), _RARE)
    if not opinion.broken and (is_unsure or not opinion.agrees):
        opinion, _ = _opinion(grown(most), _SHOWN)
    if opinion.broken:
        return opinion
    objections = list(tail_objections(check, opinion.misses))
    broken = next((sentence for sentence, hangs in objections if hangs), "")
    sentences = tuple(sentence for sentence, _ in objections)
    return replace(opinion, contradictions=(*opinion.contradictions, *sentences), broken=broken)


def _opinion(check: Check, chance: float) -> tuple[SecondOpinion, bool]:
    """The opinion by the fresh systems of a check, and whether more of them may change it.

    `chance`: with which probability an expression that has not changed may seem to have.
    """
    count = len(check.systems.points)
    if without_value := _without_value(check):
        return SecondOpinion(count, {}, (without_value,), without_value), False
    # Limits on the worst case rely on no expansion.
    varying = {
        one: check.functionals[one].at(check.own(one))
        for one in expanded_functionals(check.problem.expressions)
        if not check.functionals[one].is_certain
    }
    fresh = {one.text(): own for one, own in varying.items()}
    noise = variances_by_noise(check.problem.expressions)
    by_noise = {one.text(): check.functionals[own].mean[check.own(own)] for one, own in noise.items()}
    # What misses such a variance is a part of the whole.
    by_noise |= {
        own.text(): (check.functionals[one].std[check.own(one)] ** 2 + by_noise[one.text()]) ** 2
        for one, own in noise.items()
    }
    misses = {text: _miss(one, by_noise.get(text, 0.0)) for text, one in fresh.items()}
    missed = [
        f"the expansion predicts fresh simulations of {text} with an error of {miss:.2g} of their standard deviation"
        for text, miss in misses.items()
        if not miss <= 2 * check.problem.expansion.tolerance
    ]
    shifts, broken, is_unsure = _judged(fresh, check, chance) if fresh else ([], "", False)
    has_outlier = any(
        not (np.abs(own.fresh - own.predicted) <= _OUTLIER * _at_least(own.std, one.is_path)).all()
        for one, own in varying.items()
    )
    return SecondOpinion(count, misses, (*missed, *shifts), broken), is_unsure or has_outlier


def _without_value(check: Check) -> str:
    """A sentence on a functional without values in some fresh systems, with the numbers of one; empty if all have."""
    for functional, own in check.functionals.items():
        broken = ~np.isfinite(own.fresh.reshape(len(own.fresh), -1)).all(axis=1)
        if broken.any():
            germ, decisions = check.systems.points[broken][0], check.meaning.decisions
            named = listed(inputs_at(check.transcribed.places, jax_array(germ), jax_array(decisions)))
            share = 100 * float(own.weights[broken].sum() / own.weights.sum())
            return f"{functional.text()} is not finite in about {share:.2g} % of all systems, such as that with {named}"
    return ""


def _miss(one: Checked, by_noise: Any) -> float:
    """The rms error of predictions over the standard deviation, what they miss included, summed over entries.

    - `by_noise`: what white noise adds to the variance.
    """
    weights = _along(one.weights, one.fresh)
    missed = float(np.sum(weights * (one.fresh - one.predicted) ** 2) / np.sum(weights))
    total = float(np.sum(one.std**2 + by_noise)) + missed
    return 0.0 if total == 0 else float(np.sqrt(missed / total))


def _along(weights: Float[np.ndarray, " systems"], values: Values) -> Values:
    """Weights with an axis for each of the values."""
    return weights.reshape(-1, *[1] * (values.ndim - 1))


def means(weights: Values, values: Values) -> Replicates:
    """Weighted means along a last axis of replicates: zero, of all systems, and of all but one (the jackknife)."""
    weighted, weight = weights * values, weights.sum(axis=0)
    total = weighted.sum(axis=0)
    rest = (total - weighted) / (weight - weights)
    return np.moveaxis(np.concatenate([0 * total[None], (total / weight)[None], rest]), 0, -1)


def _corrected(
    kind: AbstractStatistic, expanded: np.ndarray, one: Checked, transcribed: AbstractTranscribed
) -> tuple[Replicates, Float[np.ndarray, "..."]]:
    """A statistic in all replicates, and its change by one standard deviation of the functional.

    What lies at the ends of an output is shifted and scaled with mean and spread; of quantiles and means beyond them
    systems in their tails tell (`tail_objections`).
    """
    weights, std, base = _along(one.weights, one.fresh), one.std, expanded[..., None]
    shift = means(weights, one.fresh - one.predicted)
    squares = means(weights, (one.fresh - one.mean) ** 2 - (one.predicted - one.mean) ** 2) - shift**2
    wider = np.sqrt(np.maximum(std[..., None] ** 2 + squares, 0.0)) - std[..., None]
    match kind:
        case Mean():
            return base + shift, std
        case Variance():
            return base + squares, std**2
        case Std():
            return base + wider, std
        case Probability():
            seen = [np.asarray(kind.holds(part, is_rounded=True), float) for part in (one.fresh, one.predicted)]
            return base + means(weights, seen[0] - seen[1]), np.sqrt(np.clip(expanded * (1 - expanded), 0.0, None))
    if isinstance(kind, OF_THE_SHAPE):
        return _corrected_shape(kind, base, one, transcribed)
    if isinstance(kind, _AT_ENDS):
        safe = np.where(std > 0, std, 1.0)[..., None]
        return base + shift + (base - one.mean[..., None]) / safe * wider, std
    return base + 0 * shift, std if isinstance(kind, _IN_TAILS) else 0 * std


def _judged(fresh: Mapping[str, Checked], check: Check, chance: float) -> tuple[list[str], str, bool]:
    """The expressions that change beyond chance, a sentence each; what the correction breaks, if anything: a limit, by
    a twentieth of a spread, or the whole gain; and whether chance could hide such a change.
    """
    problem, replicates = check.problem, len(check.systems.points) + 2
    known, spreads = Known(), dict[Statistic, np.ndarray]()
    # Statistics that occur in several expressions are equal in all; joint ones are not corrected.
    for atom, base in check.statistics.items():
        one = fresh.get(atom.functionals[0].text()) if len(atom.functionals) == 1 else None
        unmoved = np.repeat(base[..., None], replicates, axis=-1), 0 * base
        known[atom], spreads[atom] = unmoved if one is None else _corrected(atom.kind, base, one, check.transcribed)
    for i, (atom, values) in enumerate(known.items()):
        moved = np.repeat(values[..., :1], len(spreads), axis=-1)
        moved[..., i] += spreads[atom]
        known[atom] = np.concatenate([values, moved], axis=-1)
    scope, sentences, broken, is_unsure = KnownStatistics(check, known), [], "", False
    for which, expression in enumerate(problem.expressions):
        kinds = [leaf.kind for leaf in expression.leaves if isinstance(leaf, Statistic)]
        if not kinds:
            continue
        shifts = _shifts(np.asarray(expression.evaluate(scope)), replicates, chance, expression.is_path)
        # Each instant and entry is judged by its own spread, and told as a part of the largest.
        judged = _of_objective(check, shifts) if which == 0 else _of_limit(check, which - 1, shifts)
        worst, is_told = shifts.worst(shifts.scale.max())
        if is_told or judged.broken:
            text = shifts.text(judged.entry if judged.broken else worst)
            has_ends = any(isinstance(kind, _AT_ENDS) for kind in kinds)
            follows = ", if its ends follow their mean and spread" if has_ends else ""
            sentences.append(f"{expression} differs by {text} in fresh simulations{follows}")
        broken, is_unsure = broken or judged.broken, is_unsure or judged.is_unsure
    return sentences, broken, is_unsure


class _Judged(NamedTuple):
    """The entry that decides, what its change breaks, if anything, and whether chance could hide that."""

    entry: int
    broken: str
    is_unsure: bool


def _of_objective(check: Check, shifts: "_Shifts") -> _Judged:
    tolerated, is_moved = _BREAKS * float(shifts.scale[0]), shifts.beyond(shifts.scale)[0] > 1
    if not (is_moved or shifts.sure[0] > tolerated):
        return _Judged(0, "", False)
    tolerated = max(check.gained, tolerated)
    is_broken = is_moved and not abs(shifts.by[0]) <= tolerated
    said = f"the objective differs by {shifts.text(0)}, more than was gained ({check.gained:.3g})"
    return _Judged(0, said if is_broken else "", bool(shifts.sure[0] > tolerated))


def _of_limit(check: Check, number: int, shifts: "_Shifts") -> _Judged:
    limit, own, by, sure = check.problem.constraints[number], check.at_instants(number), shifts.by, shifts.sure
    tolerated = _BREAKS * shifts.scale + HELD * check.limits[number].size
    beyond, other, low, high = (excess_of(limit, own + one) - tolerated for one in (by, -by, -sure, sure))
    is_unsure, is_moved = bool(max(low.max(), high.max()) > 0), shifts.beyond(shifts.scale) > 1
    broken, held = (np.where(is_moved, one, -np.inf) for one in (beyond, other))
    if not np.max(broken) <= 0:
        entry = int(np.argmax(broken))
        excess = f"by {beyond[entry] + tolerated[entry]:.3g} once the expansion is corrected by {shifts.text(entry)}"
        return _Judged(entry, f"'{limit.name}' is broken {excess}", is_unsure)
    # As with limits on tails: one that does not bind where it seems to holds the answer off its optimum.
    if has_shape((limit.expression,)) and not np.max(held) <= 0:
        entry = int(np.argmax(held))
        said = f"'{limit.name}' binds in the expansion alone, which is wrong by {shifts.text(entry)}"
        return _Judged(entry, said, is_unsure)
    return _Judged(0, "", is_unsure)


class _Shifts(NamedTuple):
    """How fresh simulations change an expression, for each of its entries.

    - `by`, `error`: the change and its standard error; `sure`: how large a change is beyond chance and rounding;
    - `scale`: its change by one standard deviation.
    """

    by: Float[np.ndarray, " entries"]
    error: Float[np.ndarray, " entries"]
    sure: Float[np.ndarray, " entries"]
    scale: Float[np.ndarray, " entries"]

    def beyond(self, scale: Any) -> Float[np.ndarray, " entries"]:
        """By how many times each change exceeds chance and what is negligible; infinite for what is not finite."""
        least = np.maximum(np.maximum(self.sure, _NONE * scale), np.finfo(float).tiny)
        return np.nan_to_num(np.abs(self.by) / least, nan=np.inf)

    def worst(self, scale: Any) -> tuple[int, bool]:
        """The entry that changes most, and whether that is more than chance and what is negligible."""
        ratio = self.beyond(scale)
        return int(np.argmax(ratio)), bool(ratio.max() > 1)

    def text(self, entry: int) -> str:
        """The change of an entry."""
        return f"{self.by[entry]:+.3g} ± {self.error[entry]:.2g}"


def _shifts(values: Float[np.ndarray, "... moved"], replicates: int, chance: float, is_path: bool) -> _Shifts:
    """How an expression changes by fresh simulations, from its values in all replicates and with each spread added."""
    by, count = values[..., 1] - values[..., 0], replicates - 2
    error = np.sqrt((count - 1) * np.var(values[..., 2:replicates], axis=-1))
    reach = _quantile(count - 1, min(chance / 2 / by.size, 0.5))
    sure = np.maximum(reach * error, _ROUNDING * float(np.max(np.abs(values))))
    scale = np.sum(np.abs(values[..., replicates:] - values[..., :1]), axis=-1)
    return _Shifts(*map(np.ravel, (by, error, sure, _at_least(scale, is_path))))


def _at_least(spreads: Float[np.ndarray, "*shape"], is_path: bool) -> Float[np.ndarray, "*shape"]:
    """Spreads, those over time not less than what is negligible beside the largest at any instant."""
    return np.maximum(spreads, NEGLIGIBLE_SPREAD * np.max(spreads, axis=0)) if is_path else spreads


def _quantile(freedom: int, chance: float) -> float:
    """What Student's t exceeds with a probability, to 1e-4 for 29 degrees of freedom.

    By the normal distribution (Abramowitz and Stegun, 1964, 26.7.5): SciPy's function takes longer to import than an
    answer to judge.
    """
    z = -NormalDist().inv_cdf(chance)
    first, second = (z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96
    third = (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
    fourth = (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160
    return z + first / freedom + second / freedom**2 + third / freedom**3 + fourth / freedom**4


# --- Third and fourth powers ------------------------------------------------------------------------------------------
#
# An expansion whose mean and spread are right may be wrong in skewness, kurtosis, and quantiles that follow from them,
# for polynomials of a high power run away where no collocation point lies, in systems so rare that mean and spread owe
# nothing to them.


def _corrected_shape(
    kind: AbstractStatistic, base: Float[np.ndarray, "... 1"], one: Checked, transcribed: AbstractTranscribed
) -> tuple[Replicates, Float[np.ndarray, "..."]]:
    """A statistic in all replicates, and a change of it that counts.

    Where the expansion does not have the statistic of many systems, of which it predicts each, it owes its own to yet
    rarer ones: then theirs is corrected, in the same way, by the difference between what is simulated and predicted.
    """
    terms = one.coefficients
    count = int(np.clip(_NUMBERS // max(len(terms), terms[0].size), _FEWEST, _MANY))
    systems = fresh_systems(transcribed.problem, count, _DRAW)
    many = np.tensordot(transcribed.basis.matrix(systems.points), terms, axes=1)
    known = (one.fresh, one.weights), (one.predicted, one.weights), (many, systems.weights)
    simulated, predicted, of_many = (_shape(kind, *part, one.mean, one.std) for part in known)
    error = np.sqrt((of_many.shape[-1] - 2) * np.var(of_many[..., 1:], axis=-1, keepdims=True))
    magnitude = np.minimum(np.abs(base), np.abs(simulated[..., :1]))[..., 0]
    size = one.std if isinstance(kind, CornishFisher) else np.maximum(magnitude, 1.0)
    is_theirs = np.abs(of_many[..., :1] - base) <= _ERRORS * error + _PART * size[..., None]
    corrected = np.where(is_theirs, base, of_many[..., :1]) + simulated - predicted
    varies = (one.std > NEGLIGIBLE_SPREAD * np.max(one.std))[..., None]
    return np.concatenate([base, np.where(varies, corrected, base)], axis=-1), size


def _shape(
    kind: AbstractStatistic,
    values: Values,
    weights: Float[np.ndarray, " systems"],
    mean: Float[np.ndarray, "..."],
    std: Float[np.ndarray, "..."],
) -> Replicates:
    """The statistic of weighted values: of all, and of all but one."""
    scale = np.where(std > 0, std, 1.0)
    standard, weights = (values - mean) / scale, _along(weights, values)
    first, second, third, fourth = (means(weights, standard**power)[..., 1:] for power in range(1, 5))
    variance = second - first**2
    spread = np.sqrt(np.where(variance > 0, variance, 1.0))
    skewness = (third - 3 * first * second + 2 * first**3) / spread**3
    kurtosis = (fourth - 4 * first * third + 6 * first**2 * second - 3 * first**4) / spread**4
    if isinstance(kind, CornishFisher):
        moments = mean[..., None] + scale[..., None] * first, scale[..., None] * spread, skewness, kurtosis
        return np.asarray(kind.of_moments(*map(jax_array, moments)))
    return skewness if isinstance(kind, Skewness) else kurtosis
