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
from aleator.certification._check import Check, certain, checks_at
from aleator.certification._fresh import OF_THE_SHAPE, has_shape, systems_of
from aleator.certification._shapes import corrected_shape, means, predicted_of_many
from aleator.certification._tails import KnownStatistics, tail_objections
from aleator.design import Statistic, expanded_functionals, functionals_of
from aleator.ensemble import inputs_at, listed
from aleator.solution import SecondOpinion
from aleator.statistics import (
    AbstractStatistic,
    ConditionalValueAtRisk,
    Infimum,
    Mean,
    Probability,
    Quantile,
    Std,
    Supremum,
    Variance,
)
from aleator.transcription import AbstractTranscribed

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

_FOLLOW_THE_SPREAD = (Quantile, ConditionalValueAtRisk, Supremum, Infimum)


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
            seen, predicted = (np.asarray(kind.holds(part), float) for part in (self.values, self.predicted))
            spread = np.sqrt(np.clip(expanded * (1 - expanded), 0.0, None))
            return base + means(self.weights, seen - predicted), spread
        if isinstance(kind, OF_THE_SHAPE):
            known = (self.values, self.weights), (self.predicted, self.weights), self.many()
            return corrected_shape(kind, base, self.mean, std, known)
        return base + 0 * self.off[Mean], 0 * std


def second_opinion(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], check: Check
) -> SecondOpinion | None:
    """Compare the expansions at a point with fresh simulations; None if nothing is uncertain.

    Where these disagree, or one system is missed by far, as in a rare event that none of the collocation points sees,
    more systems are drawn, and a limit counts as broken if two standard errors show it.
    """
    systems = check.systems
    if not len(systems.points) or not functionals_of(transcribed.problem.expressions):
        return None
    begin = checks_at(transcribed, point, check.factor)

    def drawn(first: int, last: int) -> list[Check]:
        draws = (systems_of(transcribed.problem, draw) for draw in range(first, last))
        waiting = [begin(systems) for systems in draws]
        return [one() for one in waiting]

    least, most = systems.draws
    # Few systems tell nothing of third and fourth powers.
    if has_shape(transcribed.problem.expressions):
        least = most
    checks = [check, *drawn(1, least)]
    opinion, has_outlier = _opinion(transcribed, point, checks, _RARE)
    if not opinion.broken and (has_outlier or not opinion.agrees):
        checks += drawn(least, most)
        opinion, _ = _opinion(transcribed, point, checks, _SHOWN)
    if opinion.broken:
        return opinion
    objections = list(tail_objections(transcribed, point, check, opinion.misses))
    broken = next((sentence for sentence, hangs in objections if hangs), "")
    sentences = tuple(sentence for sentence, _ in objections)
    return replace(opinion, contradictions=(*opinion.contradictions, *sentences), broken=broken)


def _opinion(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], checks: list[Check], chance: float
) -> tuple[SecondOpinion, bool]:
    """The opinion by the systems of some checks, and whether it rests on outliers.

    `chance`: with which probability an expression that has not changed may seem to have.
    """
    if without_value := _without_value(transcribed, point, checks):
        return SecondOpinion(len(checks[0].systems.points), {}, (without_value,), without_value), False
    fresh, count = _fresh(transcribed, point, checks), sum(len(one.systems.points) for one in checks)
    missed = [
        f"the expansion predicts fresh simulations of {text} with an error of {one.miss:.2g} of their standard "
        "deviation"
        for text, one in fresh.items()
        if not one.miss <= 2 * transcribed.problem.expansion.tolerance
    ]
    shifts, broken = _judged(transcribed, fresh, point, checks[0], chance) if fresh else ([], "")
    misses = {text: one.miss for text, one in fresh.items()}
    return SecondOpinion(count, misses, (*missed, *shifts), broken), any(one.has_outlier for one in fresh.values())


def _without_value(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], checks: list[Check]
) -> str:
    """A sentence on a functional without values in some fresh systems, with the numbers of one; empty if all have."""
    for check in checks:
        for functional, values in zip(functionals_of(transcribed.problem.expressions), check.fresh, strict=True):
            broken = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
            if broken.any():
                germ, decisions = check.systems.points[broken][0], transcribed.decisions(point)
                named = listed(inputs_at(transcribed.places, jax_array(germ), jax_array(decisions)))
                share = float(check.systems.weights[broken].sum() / check.systems.weights.sum())
                of_all = f"about {100 * share:.2g} % of all systems, such as that with {named}"
                return f"{functional.text()} is not finite in {of_all}"
    return ""


def _fresh(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], checks: list[Check]
) -> dict[str, _Fresh]:
    """The expanded functionals that vary, by their texts; limits on the worst case rely on no expansion."""
    expressions, first = transcribed.problem.expressions, checks[0]
    expanded, constant = expanded_functionals(expressions), certain(transcribed, point, *checks)
    all_weights, fresh = np.concatenate([check.systems.weights for check in checks]), {}
    for i, one in enumerate(functionals_of(expressions)):
        if one not in expanded or one in constant:
            continue
        own = np.s_[:: first.factor] if one.is_path else ...
        values = np.concatenate([check.fresh[i] for check in checks])[:, own]
        predicted = np.concatenate([check.predicted[i] for check in checks])[:, own]
        weights = all_weights.reshape(-1, *[1] * (values.ndim - 1))
        many = cache(partial(predicted_of_many, transcribed, first.coefficients[i][(slice(None), own)]))
        fresh[one.text()] = _Fresh(values, predicted, weights, first.means[i][own], first.stds[i][own] ** 2, many)
    return fresh


def _judged(
    transcribed: AbstractTranscribed,
    fresh: Mapping[str, _Fresh],
    point: Float[np.ndarray, " variables"],
    check: Check,
    chance: float,
) -> tuple[list[str], str]:
    """The expressions that change beyond chance, a sentence each, and what the correction breaks, if anything: a limit,
    by a twentieth of a spread, or the whole gain.
    """
    problem, meaning = transcribed.problem, transcribed.at(point)
    known, spreads = {}, {}
    replicates = next(one.off[Mean].shape[-1] for one in fresh.values())
    # Statistics that occur in several expressions are equal in all; joint ones are not corrected.
    for atom, base in check.at_own(problem).items():
        text, one = atom.text(), atom.functionals[0].text()
        if len(atom.functionals) == 1 and one in fresh:
            known[text], spreads[text] = fresh[one].corrected(atom.kind, base)
        else:
            known[text], spreads[text] = np.repeat(base[..., None], replicates, axis=-1), 0 * base
    for i, (text, values) in enumerate(known.items()):
        moved = np.repeat(values[..., :1], len(spreads), axis=-1)
        moved[..., i] += spreads[text]
        known[text] = np.concatenate([values, moved], axis=-1)
    scope = KnownStatistics(transcribed, point, known)
    sentences, broken = [], ""
    for which, expression in enumerate(problem.expressions):
        if not any(isinstance(leaf, Statistic) for leaf in expression.leaves):
            continue
        shift = _shift(np.asarray(expression.evaluate(scope)), replicates, chance)
        if shift is None:
            continue
        by, error, scale, where = shift
        sentences.append(f"{expression} differs by {by:+.3g} ± {error:.2g} in fresh simulations")
        if broken:
            continue
        if which == 0:
            gained = abs(transcribed.at(transcribed.program.start).objective - meaning.objective)
            if not abs(by) <= max(gained, _BREAKS * scale):
                broken = f"the objective differs by {by:+.3g} ± {error:.2g}, more than was gained ({gained:.3g})"
            continue
        limit = problem.constraints[which - 1]
        own = float(transcribed.at_instants(limit, meaning.constraints[which - 1])[where])
        corrected = f"{by:+.3g} ± {error:.2g}"
        beyond, other = (max(one - float(limit.upper), float(limit.lower) - one) for one in (own + by, own - by))
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
