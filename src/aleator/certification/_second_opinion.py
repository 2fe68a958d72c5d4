"""A second opinion on a solution: fresh simulations at the answer, compared with predictions of the expansions.

Optimisers exploit errors of an expansion. Its errors at a few fresh systems correct each statistic (a control variate:
the expansion's own number plus the mean error), with a standard error by the jackknife. Both are those of CHECK, so
that the error of the grid is none of the expansion's.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from statistics import NormalDist
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator.certification._check import NEGLIGIBLE_SPREAD, Check, certain
from aleator.certification._systems import DEEPEST_OF_SHAPES, OF_THE_SHAPE, fresh_systems, has_shape, systems_of
from aleator.certification._tails import KnownStatistics, tail_objections
from aleator.design import Statistic, expanded_functionals
from aleator.ensemble import inputs_at, listed
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

# The two-sided probability of four standard deviations of a normal variable.
_RARE = math.erfc(4 / math.sqrt(2))
# Shifts up to the first part of the effect of one standard deviation are negligible; an excess over a bound by more
# than the second part breaks it.
_NONE, _BREAKS = 0.01, 0.05
# Expressions that change by less than this part of their size have not changed.
_ROUNDING = 1e-11
# A system that is missed by more standard deviations than this is a rare event, of which a few systems say little: more
# are drawn, and two standard errors show a shift.
_OUTLIER, _SHOWN = 10.0, math.erfc(2 / math.sqrt(2))

# How many systems are predicted, at most and at least, how many numbers they may have in all, and a draw of their own.
_MANY, _FEWEST, _NUMBERS, _DRAW = 2**15, 2**11, 2**23, 10**6
# An expansion has the statistic of these systems within so many standard errors and this part of its size.
_ERRORS, _PART = 4.0, 0.01

_FOLLOW_THE_SPREAD = (Quantile, ConditionalValueAtRisk, Supremum, Infimum)


def means(weights: Values, values: Values) -> Replicates:
    """Weighted means along a last axis of replicates: zero, of all systems, and of all but one (the jackknife)."""
    weighted, weight = weights * values, weights.sum(axis=0)
    total = weighted.sum(axis=0)
    rest = (total - weighted) / (weight - weights)
    return np.moveaxis(np.concatenate([0 * total[None], (total / weight)[None], rest]), 0, -1)


@final
@dataclass(frozen=True)
class _Fresh:
    """A functional at the fresh points, simulated and predicted, with its mean and variance by the expansion.

    - `weights`: those of the fresh points, with an axis for each of the values;
    - `many`: what the expansion predicts of many more systems, which are not simulated, and their weights.
    """

    values: Float[np.ndarray, "fresh ..."]
    predicted: Float[np.ndarray, "fresh ..."]
    weights: Float[np.ndarray, "fresh ..."]
    mean: Float[np.ndarray, "..."]
    variance: Float[np.ndarray, "..."]
    many: Callable[[], tuple[Float[np.ndarray, "many ..."], Float[np.ndarray, "many ..."]]]

    @property
    def miss(self) -> float:
        """The rms error of the predictions over the standard deviation, that which they miss included, summed over
        entries.
        """
        squares = self.weights * (self.values - self.predicted) ** 2
        missed = float(np.sum(squares) / np.sum(self.weights))
        total = float(np.sum(self.variance)) + missed
        return 0.0 if total == 0 else float(np.sqrt(missed / total))

    @property
    def has_outlier(self) -> bool:
        """Whether some system is missed by many standard deviations."""
        return not (np.abs(self.values - self.predicted) <= _OUTLIER * np.sqrt(np.max(self.variance))).all()

    @cached_property
    def off(self) -> dict[type[AbstractStatistic], Float[np.ndarray, "... replicates"]]:
        """The errors of mean, variance and standard deviation by the fresh systems, in all replicates."""
        shift = means(self.weights, self.values - self.predicted)
        squares = means(self.weights, (self.values - self.mean) ** 2 - (self.predicted - self.mean) ** 2) - shift**2
        wider = np.sqrt(np.maximum(self.variance[..., None] + squares, 0.0)) - np.sqrt(self.variance)[..., None]
        return {Mean: shift, Variance: squares, Std: wider}

    def corrected(self, kind: AbstractStatistic, expanded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A statistic in all replicates, and its change by one standard deviation of the functional.

        Quantiles and the like are shifted and scaled with mean and spread.
        """
        std, base = np.sqrt(self.variance), expanded[..., None]
        if type(kind) in self.off:
            return base + self.off[type(kind)], self.variance if isinstance(kind, Variance) else std
        if isinstance(kind, _FOLLOW_THE_SPREAD):
            safe = np.where(std > 0, std, 1.0)[..., None]
            return base + self.off[Mean] + (base - self.mean[..., None]) / safe * self.off[Std], std
        if isinstance(kind, Probability):
            seen, predicted = (
                np.asarray(kind.holds(part, is_rounded=True), float) for part in (self.values, self.predicted)
            )
            spread = np.sqrt(np.clip(expanded * (1 - expanded), 0.0, None))
            return base + means(self.weights, seen - predicted), spread
        if isinstance(kind, OF_THE_SHAPE):
            known = (self.values, self.weights), (self.predicted, self.weights), self.many()
            return corrected_shape(kind, base, self.mean, std, known)
        return base + 0 * self.off[Mean], 0 * std


def second_opinion(check: Check) -> SecondOpinion | None:
    """Compare the expansions at a point with fresh simulations; None if nothing is uncertain.

    Where these disagree, or one system is missed by far, as in a rare event that none of the collocation points sees,
    more systems are drawn, and a limit counts as broken if two standard errors show it.
    """
    systems, problem = check.systems, check.problem
    if not len(systems.points) or not check.functionals:
        return None

    def drawn(first: int, last: int) -> list[Check]:
        return [check.again(systems_of(problem, draw) for draw in range(first, last))] if first < last else []

    least, most = systems.draws
    # Few systems tell nothing of third and fourth powers.
    if has_shape(problem.expressions):
        least = most
    checks = [check, *drawn(1, least)]
    opinion, has_outlier = _opinion(checks, _RARE)
    if not opinion.broken and (has_outlier or not opinion.agrees):
        checks += drawn(least, most)
        opinion, _ = _opinion(checks, _SHOWN)
    if opinion.broken:
        return opinion
    objections = list(tail_objections(check, opinion.misses))
    broken = next((sentence for sentence, hangs in objections if hangs), "")
    sentences = tuple(sentence for sentence, _ in objections)
    return replace(opinion, contradictions=(*opinion.contradictions, *sentences), broken=broken)


def _opinion(checks: list[Check], chance: float) -> tuple[SecondOpinion, bool]:
    """The opinion by the systems of some checks, and whether it rests on outliers.

    `chance`: with which probability an expression that has not changed may seem to have.
    """
    if without_value := _without_value(checks):
        return SecondOpinion(len(checks[0].systems.points), {}, (without_value,), without_value), False
    fresh, count = _fresh(checks), sum(len(one.systems.points) for one in checks)
    missed = [
        f"the expansion predicts fresh simulations of {text} with an error of {one.miss:.2g} of their standard "
        "deviation"
        for text, one in fresh.items()
        if not one.miss <= 2 * checks[0].problem.expansion.tolerance
    ]
    shifts, broken = _judged(fresh, checks[0], chance) if fresh else ([], "")
    misses = {text: one.miss for text, one in fresh.items()}
    return SecondOpinion(count, misses, (*missed, *shifts), broken), any(one.has_outlier for one in fresh.values())


def _without_value(checks: list[Check]) -> str:
    """A sentence on a functional without values in some fresh systems, with the numbers of one; empty if all have."""
    for check in checks:
        for functional, own in check.functionals.items():
            broken = ~np.isfinite(own.fresh.reshape(len(own.fresh), -1)).all(axis=1)
            if broken.any():
                germ, decisions = check.systems.points[broken][0], check.meaning.decisions
                named = listed(inputs_at(check.transcribed.places, jax_array(germ), jax_array(decisions)))
                share = float(own.weights[broken].sum() / own.weights.sum())
                of_all = f"about {100 * share:.2g} % of all systems, such as that with {named}"
                return f"{functional.text()} is not finite in {of_all}"
    return ""


def _fresh(checks: list[Check]) -> dict[str, _Fresh]:
    """The expanded functionals that vary, by their texts; limits on the worst case rely on no expansion."""
    first, constant, fresh = checks[0], certain(*checks), {}
    all_weights = np.concatenate([check.systems.weights for check in checks])
    expanded = expanded_functionals(first.problem.expressions)
    for one, checked in first.functionals.items():
        if one not in expanded or one in constant:
            continue
        own, every = first.own(one), [check.functionals[one] for check in checks]
        values, predicted = (
            np.concatenate([getattr(check, part) for check in every])[:, own] for part in ("fresh", "predicted")
        )
        weights = all_weights.reshape(-1, *[1] * (values.ndim - 1))
        many = cache(partial(predicted_of_many, first.transcribed, checked.coefficients[(slice(None), own)]))
        fresh[one.text()] = _Fresh(values, predicted, weights, checked.mean[own], checked.std[own] ** 2, many)
    return fresh


def _judged(fresh: Mapping[str, _Fresh], check: Check, chance: float) -> tuple[list[str], str]:
    """The expressions that change beyond chance, a sentence each, and what the correction breaks, if anything: a limit,
    by a twentieth of a spread, or the whole gain.
    """
    problem, known, spreads = check.problem, {}, {}
    replicates = next(one.off[Mean].shape[-1] for one in fresh.values())
    # Statistics that occur in several expressions are equal in all; joint ones are not corrected.
    for atom, base in check.statistics.items():
        one = atom.functionals[0].text()
        if len(atom.functionals) == 1 and one in fresh:
            known[atom], spreads[atom] = fresh[one].corrected(atom.kind, base)
        else:
            known[atom], spreads[atom] = np.repeat(base[..., None], replicates, axis=-1), 0 * base
    for i, (atom, values) in enumerate(known.items()):
        moved = np.repeat(values[..., :1], len(spreads), axis=-1)
        moved[..., i] += spreads[atom]
        known[atom] = np.concatenate([values, moved], axis=-1)
    scope = KnownStatistics(check, known)
    sentences, broken = [], ""
    for which, expression in enumerate(problem.expressions):
        if not any(isinstance(leaf, Statistic) for leaf in expression.leaves):
            continue
        shift = _shift(np.asarray(expression.evaluate(scope)), replicates, chance)
        if shift is None:
            continue
        by, error, scale, where = shift
        corrected = f"{by:+.3g} ± {error:.2g}"
        sentences.append(f"{expression} differs by {corrected} in fresh simulations")
        if broken:
            continue
        if which == 0:
            if not abs(by) <= max(check.gained, _BREAKS * scale):
                broken = f"the objective differs by {corrected}, more than was gained ({check.gained:.3g})"
            continue
        limit, own = problem.constraints[which - 1], float(check.at_instants(which - 1)[where])
        beyond, other = excess_of(limit, np.array([own + by, own - by]))
        if not beyond <= _BREAKS * scale:
            broken = f"'{limit.name}' is broken by {beyond:.3g} once the expansion is corrected by {corrected}"
        # As with limits on tails: one that does not bind where it seems to holds the answer off its optimum.
        elif has_shape((expression,)) and not other <= _BREAKS * scale:
            broken = f"'{limit.name}' binds in the expansion alone, which is wrong by {corrected}"
    return sentences, broken


def _shift(
    values: Float[np.ndarray, "... moved"], replicates: int, chance: float
) -> tuple[float, float, float, int] | None:
    """The largest change of an expression by fresh simulations, its standard error, the change by one standard
    deviation, and the entry; None if by chance or negligible.
    """
    rows = values.reshape(-1, values.shape[-1])
    rest = rows[:, 2:replicates]
    by, count = rows[:, 1] - rows[:, 0], replicates - 2
    error = np.sqrt((count - 1) * np.var(rest, axis=1))
    scale = float(np.max(np.sum(np.abs(rows[:, replicates:] - rows[:, :1]), axis=1)))
    reach = _quantile(count - 1, min(chance / 2 / len(rows), 0.5))
    floor = max(_NONE * scale, _ROUNDING * float(np.max(np.abs(rows))))
    ratio = np.abs(by) / np.maximum(np.maximum(reach * error, floor), np.finfo(float).tiny)
    i = int(np.argmax(ratio))
    return (float(by[i]), float(error[i]), scale, i) if not ratio[i] <= 1 else None


def _quantile(freedom: int, chance: float) -> float:
    """What Student's t exceeds with a probability, to 1e-4 for 29 degrees of freedom.

    By the normal distribution (Abramowitz and Stegun, 1964, 26.7.5): SciPy's function takes longer to import than an
    answer to judge.
    """
    z = -NormalDist().inv_cdf(chance)
    terms = (
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160,
    )
    return z + sum(term / freedom**power for power, term in enumerate(terms, 1))


# --- Third and fourth powers ------------------------------------------------------------------------------------------
#
# An expansion whose mean and spread are right may be wrong in skewness, kurtosis, and quantiles that follow from them,
# for polynomials of a high power run away where no collocation point lies, in systems so rare that mean and spread owe
# nothing to them.


def predicted_of_many(transcribed: AbstractTranscribed, terms: Float[np.ndarray, "terms ..."]) -> tuple[Values, Values]:
    """What the expansion of a functional predicts of many systems, and their weights."""
    count = int(np.clip(_NUMBERS // max(len(terms), terms[0].size), _FEWEST, _MANY))
    systems = fresh_systems(transcribed.problem.placements.germs.values(), count, _DRAW, DEEPEST_OF_SHAPES)
    predicted = np.tensordot(transcribed.discretised.basis.matrix(systems.points), terms, axes=1)
    return predicted, systems.weights.reshape(-1, *[1] * (predicted.ndim - 1))


def corrected_shape(
    kind: AbstractStatistic,
    base: Float[np.ndarray, "... 1"],
    mean: Float[np.ndarray, "..."],
    std: Float[np.ndarray, "..."],
    known: tuple[tuple[Values, Values], ...],
) -> tuple[Replicates, Float[np.ndarray, "..."]]:
    """A statistic in all replicates: uncorrected, by all fresh systems, by all but one; and a change of it that counts.

    - `base`: the expansion's own; `mean`, `std`: its moments of the functional;
    - `known`: values and weights of the fresh systems, simulated and predicted, and of many that are predicted.

    Where the expansion does not have the statistic of the many systems, it owes its own to yet rarer ones: then theirs
    is corrected, in the same way, by the difference between what is simulated and what is predicted.
    """
    simulated, predicted, of_many = (_shape(kind, values, weights, mean, std) for values, weights in known)
    error = np.sqrt((of_many.shape[-1] - 2) * np.var(of_many[..., 1:], axis=-1, keepdims=True))
    magnitude = np.minimum(np.abs(base), np.abs(simulated[..., :1]))[..., 0]
    size = std if isinstance(kind, CornishFisher) else np.maximum(magnitude, 1.0)
    is_theirs = np.abs(of_many[..., :1] - base) <= _ERRORS * error + _PART * size[..., None]
    corrected = np.where(is_theirs, base, of_many[..., :1]) + simulated - predicted
    varies = (std > NEGLIGIBLE_SPREAD * np.max(std))[..., None]
    return np.concatenate([base, np.where(varies, corrected, base)], axis=-1), size


def _shape(
    kind: AbstractStatistic,
    values: Values,
    weights: Values,
    mean: Float[np.ndarray, "..."],
    std: Float[np.ndarray, "..."],
) -> Replicates:
    """The statistic of weighted values: of all, and of all but one."""
    scale = np.where(std > 0, std, 1.0)
    standard = (values - mean) / scale
    first, second, third, fourth = (means(weights, standard**power)[..., 1:] for power in range(1, 5))
    variance = second - first**2
    spread = np.sqrt(np.where(variance > 0, variance, 1.0))
    skewness = (third - 3 * first * second + 2 * first**3) / spread**3
    kurtosis = (fourth - 4 * first * third + 6 * first**2 * second - 3 * first**4) / spread**4
    if isinstance(kind, CornishFisher):
        moments = mean[..., None] + scale[..., None] * first, scale[..., None] * spread, skewness, kurtosis
        return np.asarray(kind.of_moments(*map(jax_array, moments)))
    return skewness if isinstance(kind, Skewness) else kurtosis
