"""A second opinion on a solution: fresh simulations at the answer, compared with predictions of the expansions.

Optimisers exploit errors of an expansion. Its errors at a few fresh systems correct each statistic (a control variate:
the expansion's own number plus the mean error), with a standard error by the jackknife.

Half of the systems are drawn at random, half from the tails: an output may owe much of its spread to the one system in
a hundred that no collocation point and none of a few random systems resembles. Weights undo the choice (multiple
importance sampling with the balance heuristic of Veach & Guibas, 1995), and no weight exceeds 2.
"""

import math
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple, final

import numpy as np
import scipy
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator.certification._reference import prepare_reference
from aleator.design import (
    AbstractScopeOfInstants,
    Problem,
    Statistic,
    expanded_functionals,
    functionals_of,
    sizes,
    statistics_in,
)
from aleator.ensemble import at_levels, inputs_at, listed, random_levels
from aleator.solution import SecondOpinion
from aleator.statistics import (
    AbstractStatistic,
    ConditionalValueAtRisk,
    CornishFisher,
    Infimum,
    Mean,
    Probability,
    Quantile,
    Std,
    Supremum,
    Variance,
)
from aleator.transcription import RESPOND, AbstractTranscribed, Discretised, Meaning
from aleator.uncertainty import AbstractGerm, named_numbers

# Fresh systems: enough for a standard error, and cheap compared with one evaluation with derivatives.
_FRESH = 32
# The two-sided probability of four standard deviations of a normal variable.
_RARE = math.erfc(4 / math.sqrt(2))
# Shifts up to the first part of the effect of one standard deviation are negligible; an excess over a bound by more
# than the second part breaks it.
_NONE, _BREAKS = 0.01, 0.05
# Outputs that vary by less than this part of their size are constant up to rounding.
_ROUNDING = 1e-11

_FOLLOW_THE_SPREAD = (Quantile, CornishFisher, ConditionalValueAtRisk, Supremum, Infimum)
# The depths of tails, as parts of all systems: more than 4 standard deviations of a normal germ, and the median.
_DEEPEST, _SHALLOWEST = 1e-5, 0.5


class FreshSystems(NamedTuple):
    """Germ points, and the weights with which their mean stands for all systems."""

    points: Float[np.ndarray, "fresh variables"]
    weights: Float[np.ndarray, " fresh"]


def fresh_systems(germs: Collection[AbstractGerm], count: int, generator: np.random.Generator) -> FreshSystems:
    """Half of the systems drawn at random, in the others one germ after the other in its lower or its upper tail.

    Depths within a tail are log-uniform, spread evenly over the systems of that tail.
    """
    levels = random_levels(generator, count, len(germs))
    tails = np.arange(count - count // 2) % (2 * len(germs))
    which, upper = tails // 2, tails % 2 == 1
    depths = _depths(tails, generator)
    levels[count // 2 + np.arange(len(tails)), which] = np.where(upper, 1 - depths, depths)
    drawn = np.bincount(tails, minlength=2 * len(germs)) / count
    density = count // 2 / count + _tail_density(levels) @ drawn[::2] + _tail_density(1 - levels) @ drawn[1::2]
    return FreshSystems(at_levels(germs, levels), 1 / density)


def _depths(tails: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """A depth for each system, one in each of the equal parts of its tail's logarithmic range."""
    parts = np.empty(len(tails))
    for tail in np.unique(tails):
        those = np.flatnonzero(tails == tail)
        parts[those] = (np.arange(len(those)) + generator.random(len(those))) / len(those)
    return _DEEPEST * (_SHALLOWEST / _DEEPEST) ** parts


def _tail_density(depths: np.ndarray) -> np.ndarray:
    """The density of a level at a depth below the median, relative to a random one."""
    inside = (depths >= _DEEPEST) & (depths <= _SHALLOWEST)
    return np.where(inside, 1 / (np.maximum(depths, _DEEPEST) * np.log(_SHALLOWEST / _DEEPEST)), 0.0)


class _Fresh(NamedTuple):
    """A functional at the fresh points, simulated and predicted, with its mean and variance by the expansion.

    `weights`: those of the fresh points, with an axis for each of the values.
    """

    values: Float[np.ndarray, "fresh ..."]
    predicted: Float[np.ndarray, "fresh ..."]
    weights: Float[np.ndarray, "fresh ..."]
    mean: Float[np.ndarray, "..."]
    variance: Float[np.ndarray, "..."]

    def miss(self) -> float:
        """The rms error of the predictions over the standard deviation, summed over entries; zero for rounding."""
        total, size = float(np.sum(self.variance)), float(np.sum(self.mean**2 + self.variance))
        if total <= _ROUNDING**2 * size:
            return 0.0
        squares = self.weights * (self.values - self.predicted) ** 2
        return float(np.sqrt(np.sum(squares) / np.sum(self.weights) / total))

    def is_rounding(self, size: float) -> bool:
        """Whether a number spreads by no more than rounding of its terms, which have the magnitude `size`."""
        return self.values.ndim == 1 and bool(np.sqrt(self.variance) <= _ROUNDING * size)

    def corrections(self) -> "_Corrections":
        """The corrections of mean and variance by the fresh systems."""
        shift = self.means(self.values - self.predicted)
        squares = self.means((self.values - self.mean) ** 2 - (self.predicted - self.mean) ** 2) - shift**2
        wider = np.sqrt(np.maximum(self.variance[..., None] + squares, 0.0)) - np.sqrt(self.variance)[..., None]
        return _Corrections(shift, squares, wider)

    def means(self, missed: Float[np.ndarray, "fresh ..."]) -> Float[np.ndarray, "... replicates"]:
        """The mean error along a last axis of replicates: zero, of all, and of all but one (the jackknife)."""
        weighted, weight = self.weights * missed, self.weights.sum(axis=0)
        every = weighted.sum(axis=0) / weight
        rest = (weighted.sum(axis=0) - weighted) / (weight - self.weights)
        return np.moveaxis(np.concatenate([0 * every[None], every[None], rest]), 0, -1)


class _Corrections(NamedTuple):
    """The errors of a functional's mean, variance and standard deviation, in all replicates."""

    mean: Float[np.ndarray, "... replicates"]
    variance: Float[np.ndarray, "... replicates"]
    std: Float[np.ndarray, "... replicates"]


@final
class _Replicated(AbstractScopeOfInstants):
    """Statistics with a last axis of replicates: those of `_Fresh.means`, then one for each statistic that is moved."""

    def __init__(self, known: Mapping[str, np.ndarray], numbers: Callable[[], Mapping[str, Array]], step: float):
        # The model's numbers take longer than all the rest, and few problems need any.
        self._known, self._numbers, self.step = known, numbers, step

    @override
    def statistic(self, functionals: tuple, kind: AbstractStatistic) -> Array:
        return self._known[Statistic(functionals, kind).text()]  # type: ignore[return-value]

    @override
    def value(self, name: str) -> Array:
        return self._numbers()[name]


def second_opinion(transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"]) -> SecondOpinion | None:
    """Compare the expansions at a point with fresh simulations; None if nothing is uncertain.

    The fresh systems are the same at every call, so that a solution is repeatable; no solver has seen them.
    """
    problem, basis, meaning = transcribed.problem, transcribed.basis, transcribed.at(point)
    if basis.variables == 0 or not functionals_of(problem.expressions):
        return None
    systems = fresh_systems(basis.germs.values(), _FRESH, np.random.default_rng(2))
    decisions = jax_array(meaning.decisions)
    values = _simulated(transcribed, jax_array(systems.points), decisions)
    fresh = _fresh(transcribed, systems, values, point)
    for text, one in fresh.items():
        broken = ~np.isfinite(one.values.reshape(_FRESH, -1)).all(axis=1)
        if broken.any():
            named = listed(inputs_at(transcribed.places, jax_array(systems.points[broken][0]), decisions))
            share = float(systems.weights[broken].sum() / systems.weights.sum())
            sentence = f"{text} is not finite in about {100 * share:.2g} % of all systems, such as that with {named}"
            return SecondOpinion(_FRESH, {}, (sentence,), "")
    opinion = _opinion(transcribed, fresh, point)
    if opinion.agrees:
        return opinion
    magnitudes = sizes(problem, jax_array(systems.points[0]), decisions)
    allowed_for = {
        text: one._replace(values=one.predicted) if one.is_rounding(float(size)) else one
        for (text, one), size in zip(fresh.items(), magnitudes, strict=True)
    }
    return _opinion(transcribed, allowed_for, point)


def _simulated(
    transcribed: AbstractTranscribed, points: Float[Array, "fresh variables"], decisions: Float[Array, " n"]
) -> list[np.ndarray]:
    """Each functional of the fresh systems, on steps as fine as the answer's own; paths at the problem's instants."""
    problem, factor = transcribed.problem, transcribed.fineness
    traced = transcribed.traced if factor == 1 else numbers_to_arrays(problem.on_grid(problem.grid.finer(factor)))
    values = RESPOND(traced, points, decisions)
    each = zip(functionals_of(problem.expressions), map(np.asarray, values), strict=True)
    return [one[:, ::factor] if functional.is_path else one for functional, one in each]


def prepare_opinion(problem: Problem) -> None:
    """Begin to compile what `second_opinion` will need."""
    germs = problem.placements.germs
    if germs and functionals_of(problem.expressions):
        decisions = jax_array(problem.placements.vector("initial"))
        RESPOND.prepare(numbers_to_arrays(problem), jax_array(np.zeros((_FRESH, len(germs)))), decisions)


def _opinion(
    transcribed: AbstractTranscribed, fresh: Mapping[str, _Fresh], point: Float[np.ndarray, " variables"]
) -> SecondOpinion:
    # Functionals that only limits on the worst case use do not rely on their expansion.
    expanded = {one.text() for one in expanded_functionals(transcribed.problem.expressions)}
    fresh = {text: one for text, one in fresh.items() if text in expanded}
    misses = {text: one.miss() for text, one in fresh.items()}
    missed = [
        f"the expansion predicts fresh simulations of {text} with an error of {miss:.2g} of their standard deviation"
        for text, miss in misses.items()
        if not miss <= 2 * transcribed.problem.expansion.tolerance
    ]
    shifts, broken = _judged(transcribed, fresh, point)
    return SecondOpinion(_FRESH, misses, (*missed, *shifts), broken)


def _fresh(
    transcribed: AbstractTranscribed,
    systems: FreshSystems,
    values: list[np.ndarray],
    point: Float[np.ndarray, " variables"],
) -> dict[str, _Fresh]:
    samples, resolved = transcribed.at(point).samples, transcribed.resolve(point)
    predict = transcribed.basis.matrix(systems.points) @ np.asarray(transcribed.collocation.pseudo_inverse)
    fresh = {}
    for text, seen, known in zip(transcribed.texts.functionals, values, samples, strict=True):
        predicted = (predict @ np.asarray(known).reshape(len(known), -1)).reshape(seen.shape)
        moments = resolved[text]
        weights = systems.weights.reshape(-1, *[1] * (seen.ndim - 1))
        fresh[text] = _Fresh(seen, predicted, weights, np.asarray(moments.mean), np.asarray(moments.std) ** 2)
    return fresh


def _corrected(
    kind: AbstractStatistic, expanded: np.ndarray, one: _Fresh, off: _Corrections
) -> tuple[np.ndarray, np.ndarray]:
    """A statistic in all replicates, and its change by one standard deviation of its functional.

    Quantiles and the like are shifted and scaled with mean and spread; joint statistics are not corrected.
    """
    std, base = np.sqrt(one.variance), np.asarray(expanded)[..., None]
    if isinstance(kind, Mean):
        return base + off.mean, std
    if isinstance(kind, Variance):
        return base + off.variance, one.variance
    if isinstance(kind, Std):
        return base + off.std, std
    if isinstance(kind, _FOLLOW_THE_SPREAD):
        safe = np.where(std > 0, std, 1.0)[..., None]
        return base + off.mean + (base - one.mean[..., None]) / safe * off.std, std
    if isinstance(kind, Probability):
        inside = [_inside(kind, part) for part in (one.values, one.predicted)]
        return base + one.means(inside[0] - inside[1]), np.sqrt(np.clip(base[..., 0] * (1 - base[..., 0]), 0.0, None))
    return base + 0 * off.mean, 0 * std


def _inside(kind: Probability, values: np.ndarray) -> np.ndarray:
    above = -np.inf if kind.above is None else float(kind.above)
    below = np.inf if kind.below is None else float(kind.below)
    return ((values > above) & (values < below)).astype(float)


def _judged(
    transcribed: AbstractTranscribed, fresh: Mapping[str, _Fresh], point: Float[np.ndarray, " variables"]
) -> tuple[list[str], str]:
    """The expressions that change beyond chance, a sentence each, and what the correction breaks, if anything."""
    problem, meaning, expanded = transcribed.problem, transcribed.at(point), transcribed.statistics(point)
    known, spreads = {}, {}
    corrections = {text: one.corrections() for text, one in fresh.items()}
    # Statistics that occur in several expressions are equal in all.
    atoms = dict(zip(transcribed.texts.statistics, statistics_in(problem.expressions), strict=True))
    for text, atom in atoms.items():
        base = np.asarray(expanded[text])
        if len(atom.functionals) == 1:
            one = atom.functionals[0].text()
            known[text], spreads[text] = _corrected(atom.kind, base, fresh[one], corrections[one])
        else:
            known[text], spreads[text] = np.repeat(base[..., None], _FRESH + 2, axis=-1), 0 * base
    for i, (text, values) in enumerate(known.items()):
        moved = np.repeat(values[..., :1], len(spreads), axis=-1)
        moved[..., i] += spreads[text]
        known[text] = np.concatenate([values, moved], axis=-1)
    times = meaning.times
    step = float(times[1] - times[0]) if len(times) > 1 else 1.0
    scope = _Replicated(known, lambda: named_numbers(problem.simulation, jax_array(meaning.decisions)), step)
    sentences, broken = [], ""
    for which, expression in enumerate(problem.expressions):
        if not any(isinstance(leaf, Statistic) for leaf in expression.leaves):
            continue
        shift = _shift(np.asarray(expression.evaluate(scope)))
        if shift is None:
            continue
        sentences.append(f"{expression} differs by {shift.by:+.3g} ± {shift.error:.2g} in fresh simulations")
        broken = broken or _break(transcribed, which, shift, meaning)
    return sentences, broken


class _Shift(NamedTuple):
    """The largest error of an expression, in the entry `where`, and its change by one standard deviation."""

    by: float
    error: float
    scale: float
    where: int


def _shift(values: Float[np.ndarray, "... replicates"]) -> _Shift | None:
    """The change of an expression by fresh simulations, if beyond chance and not negligible; else None."""
    rows = values.reshape(-1, values.shape[-1])
    rest = rows[:, 2 : 2 + _FRESH]
    by = rows[:, 1] - rows[:, 0]
    error = np.sqrt((_FRESH - 1) * np.var(rest, axis=1))
    scale = float(np.max(np.sum(np.abs(rows[:, 2 + _FRESH :] - rows[:, :1]), axis=1)))
    reach = -scipy.special.stdtrit(_FRESH - 1, _RARE / 2 / len(rows))
    floor = max(_NONE * scale, _ROUNDING * float(np.max(np.abs(rows))))
    ratio = np.abs(by) / np.maximum(np.maximum(reach * error, floor), np.finfo(float).tiny)
    i = int(np.argmax(ratio))
    return _Shift(float(by[i]), float(error[i]), scale, i) if ratio[i] > 1 else None


def _break(transcribed: AbstractTranscribed, which: int, shift: _Shift, meaning: Meaning) -> str:
    """What a shift breaks: a limit, by a twentieth of a spread, or the whole gain; empty if nothing."""
    problem, margin = transcribed.problem, _BREAKS * shift.scale
    if which == 0:
        gained = abs(transcribed.at(transcribed.program.start).objective - meaning.objective)
        if abs(shift.by) <= max(gained, margin):
            return ""
        return f"the objective differs by {shift.by:+.3g} ± {shift.error:.2g}, more than was gained ({gained:.3g})"
    limit = problem.constraints[which - 1]
    value = float(meaning.constraints[which - 1][shift.where]) + shift.by
    beyond = max(value - float(limit.upper), float(limit.lower) - value)
    if beyond <= margin:
        return ""
    corrected = f"{shift.by:+.3g} ± {shift.error:.2g}"
    return f"'{limit.name}' is broken by {beyond:.3g} once the expansion is corrected by {corrected}"


def prepare_judges(factor: int, problem: Problem, discretised: Discretised) -> None:
    """Begin to compile the finer grid of `factor` times as many steps, if there is one, and the second opinion."""
    if factor > 1:
        prepare_reference(problem, discretised, factor)
    prepare_opinion(problem)
