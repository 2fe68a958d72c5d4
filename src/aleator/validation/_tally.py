"""Evidence from what systems of a sample gave, and where it contradicts the solution.

Two numbers disagree if they differ by more than four standard errors of the sampled one, and by more than a hundredth
of what one system contributes (the standard error times the square root of the number of samples): a larger sample
resolves more, but a difference of a thousandth is never a disagreement. Where many instants are compared, Bonferroni's
correction accounts for the worst of them by chance.

Over time, a difference below a hundredth of the largest spread at any instant is not a disagreement either, as in the
second opinion on a solution. For example, where a distance is initially to a part that does not move, its spread starts
from zero with a kink: all points of the expansion may agree there to rounding, while one system in a thousand has moved
slightly.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import scipy
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator.design import (
    AbstractFunctional,
    Constraint,
    Estimated,
    Expression,
    Problem,
    Statistic,
    estimated,
    expanded_functionals,
    functionals_of,
    is_worst_case,
    joined,
    statistics_in,
    variances_by_noise,
)
from aleator.nlp import HELD
from aleator.references._estimate import estimate, group_count
from aleator.solution import Solution
from aleator.statistics import Infimum, Mean, Probability, Quantile, Sobol, Std, Supremum, Variance
from aleator.validation._batches import Batch, Sums
from aleator.validation._evidence import PERCENTILES, Checked, Compared, Disagreement, Evidence, Sampled, Trajectories
from aleator.validation._shares import Proportion, broken_by, is_counted
from aleator.validation._systems import Systems

# The two-sided probability beyond four standard deviations of a normal variable.
_RARE = math.erfc(4 / math.sqrt(2))
# Differences up to this fraction of one system's contribution, or of the largest spread over time, are ignored, and
# those of rounding.
_RELATIVE, _ROUNDING = 0.01, 1e-9
# Differences below this part of the magnitude behind a functional are rounding.
_ROUNDING_OF_REACH = 1e-11
# Differences of a single system up to this part of its largest value are ignored.
_ALONE = 1e-3


def evidence_of(solution: Solution, systems: Systems, whole: Batch, seed: int, seconds: float) -> Evidence:
    """Evidence from what all systems of a sample gave, or the one system where nothing is uncertain."""
    problem, samples, limits = systems.problem, whole.excess.shape[1], systems.problem.constraints
    broken = broken_by(problem, whole.excess)
    functionals = functionals_of(problem.expressions)
    known = {functionals[i]: values for i, values in whole.scalars.items()} if systems.germs else {}
    evidence = Evidence(
        solution=solution,
        samples=samples,
        seed=seed,
        instants=(len(solution.instants) - 1) * systems.counted + 1 if systems.over_time else None,
        functionals={one.text(): _sampled(solution, whole, i, one) for i, one in enumerate(functionals)},
        statistics={
            atom.text(): _checked(solution, atom, [known[one] for one in atom.functionals])
            for atom in statistics_in(problem.expressions)
            if all(one in known for one in atom.functionals) and not isinstance(atom.kind, Sobol)
        },
        trajectories=tuple(
            Trajectories(
                name=limits[i].name,
                lower=float(limits[i].lower),
                upper=float(limits[i].upper),
                values=values,
                violating=broken.get(limits[i].name, np.zeros(samples, bool))[: len(values)],
            )
            for i, values in whole.values.items()
        ),
        seconds=seconds,
        broken=broken,
        alone=None if systems.germs else systems.factor,
    )
    if not systems.germs:
        return replace(evidence, disagreements=tuple(_from_finer(evidence)))
    each = tuple(compared(evidence, problem, _estimates(problem, evidence)))
    evidence = replace(evidence, compared=tuple(one for limit, one in each if not is_counted(problem, limit)))
    # A deterministic design has no expansion that they could contradict.
    if not solution.problem.placements.germs:
        return evidence
    return replace(evidence, disagreements=(*_moments(evidence), *_statistics(evidence), *_limits(evidence, each)))


def _from_finer(evidence: Evidence) -> Iterator[Disagreement]:
    """Where the one system on a finer grid contradicts the design's own grid."""
    solution = evidence.solution
    paths = {one.text(): one for one in functionals_of(solution.problem.expressions) if one.is_path}
    for text, one in evidence.functionals.items():
        times = solution.times_of(paths[text]) if text in paths else None
        floor = _ALONE * max(float(np.max(np.abs(one.expanded_mean))), HELD)
        numbers = one.expanded_mean, one.mean, one.standard_error
        if found := worst_disagreement(text, *numbers, samples=1, freedom=1, floor=floor, times=times):
            yield replace(found, source="the design's own grid")


def _sampled(solution: Solution, whole: Batch, i: int, functional: AbstractFunctional) -> Sampled:
    moments, values = solution.moments[functional.text()], whole.scalars.get(i)
    sums = whole.paths[i] if values is None else Sums.of(values)
    values = None if sums.number == 1 else values
    return Sampled(
        text=functional.text(),
        mean=np.asarray(sums.mean),
        std=sums.std,
        standard_error=np.asarray(sums.std / np.sqrt(sums.number)),
        percentiles=None if values is None else np.percentile(values, PERCENTILES),
        expanded_mean=moments.mean,
        expanded_std=moments.std,
        std_error=sums.std_error,
        values=values,
    )


def _checked(solution: Solution, statistic: Statistic, values: list[Float[np.ndarray, " samples"]]) -> Checked:
    expanded, together = float(solution.statistics[statistic.text()]), joined([jax_array(one) for one in values])
    if isinstance(statistic.kind, Supremum | Infimum):
        # A sample does not show how far its extremes are from those of the distribution.
        return Checked(statistic, expanded, float(statistic.kind.of_sample(together)), np.nan)
    sampled = estimate(statistic.kind.of_sample, np.asarray(together), group_count(len(together)))
    return Checked(statistic, expanded, float(sampled.value), float(sampled.standard_error))


def _estimates(problem: Problem, evidence: Evidence) -> dict[str, Estimated]:
    """The statistics that samples estimate with a standard error, by their texts; of paths and arrays the first two
    moments.
    """
    known = {
        text: Estimated(np.asarray(one.estimate), np.asarray(one.standard_error))
        for text, one in evidence.statistics.items()
    }
    for atom in statistics_in(problem.expressions):
        one, *others = (evidence.functionals[functional.text()] for functional in atom.functionals)
        # The second functional of a noisy statistic is what noise adds to the variance.
        noise = [part.mean for part in others] if getattr(atom.kind, "noisy", False) else []
        variance = np.asarray(one.std**2 + sum(noise))
        moments: dict[type, Estimated] = {
            Mean: Estimated(one.mean, one.standard_error),
            Std: Estimated(np.sqrt(variance), one.std_error),
            Variance: Estimated(variance, np.asarray(2 * one.std * one.std_error)),
        }
        if atom.text() not in known and type(atom.kind) in moments:
            known[atom.text()] = moments[type(atom.kind)]
    return known


def _moments(evidence: Evidence) -> Iterator[Disagreement]:
    """Means and standard deviations; functionals with only a worst case do not use the expansion."""
    solution, certificate = evidence.solution, evidence.solution.certificate
    deviations = {} if certificate.grid_error is None else certificate.grid_error.functionals
    by_noise = variances_by_noise(solution.problem.expressions).values()
    for functional in expanded_functionals(solution.problem.expressions):
        text, is_path = functional.text(), functional.is_path
        one = evidence.functionals[text]
        ignored = (
            _ROUNDING * float(np.max(np.abs(one.mean))),
            # Some are mere rounding, such as of a rate that is zero at the end of every motion.
            _ROUNDING_OF_REACH * certificate.reaches.get(text, 0.0),
            _RELATIVE * float(np.max(one.std)) if is_path else 0.0,
            # The known error of the grid, by which samples on a finer grid differ; NaN where it is not known.
            deviations[text].error if text in deviations else 0.0,
        )
        parts = [(f"μ[{text}]", one.expanded_mean, one.mean, one.standard_error)]
        # Of what white noise adds to a variance nothing but the mean is asked.
        if functional not in by_noise:
            parts.append((f"σ[{text}]", one.expanded_std, one.std, one.std_error))
        for part in parts:
            found = worst_disagreement(
                *part,
                samples=evidence.samples,
                freedom=evidence.samples - 1,
                floor=float(np.nanmax(ignored)),
                times=solution.times_of(functional) if is_path else None,
            )
            if found is not None:
                yield found


def _statistics(evidence: Evidence) -> Iterator[Disagreement]:
    """Statistics of functionals that are numbers, besides their means and standard deviations."""
    for text, one in evidence.statistics.items():
        kind, expected = one.statistic.kind, one.expanded
        samples = [np.asarray(evidence.functionals[each.text()].values) for each in one.statistic.functionals]
        if isinstance(kind, Mean | Std) or any(np.std(one) <= _ROUNDING * np.max(np.abs(one)) for one in samples):
            contradicts = False  # told by their moments
        elif isinstance(kind, Probability):
            count = round(one.estimate * evidence.samples)
            contradicts = is_rare(count, evidence.samples, min(max(expected, 0.0), 1.0))
        elif isinstance(kind, Quantile):
            contradicts = is_rare(int(np.sum(samples[0] <= expected)), evidence.samples, float(kind.level))
        elif isinstance(kind, Supremum | Infimum):
            past = one.estimate - expected if isinstance(kind, Supremum) else expected - one.estimate
            contradicts = past > _RELATIVE * samples[0].std()
        else:
            numbers = np.asarray(expected), np.asarray(one.estimate), np.asarray(one.standard_error)
            freedom = group_count(evidence.samples) - 1
            found = worst_disagreement(text, *numbers, samples=evidence.samples, freedom=freedom)
            contradicts = found is not None
        if contradicts:
            yield Disagreement(text, expected, one.estimate, one.standard_error)


def _limits(evidence: Evidence, each: tuple[tuple[Constraint, Compared], ...]) -> Iterator[Disagreement]:
    """Limits whose statistics the samples break, and limits for all systems that some samples break."""
    for _, one in each:
        if one.meets is False:
            yield Disagreement(one.text, one.bound, one.value, one.standard_error, one.time, "its bound")
    for limit in evidence.solution.problem.constraints:
        share = evidence.violations.get(limit.name)
        atoms = (atom for atom in limit.expression.atoms if isinstance(atom, Statistic))
        for_all = is_worst_case(limit) or any(isinstance(atom.kind, Supremum | Infimum) for atom in atoms)
        if share is None or not for_all:
            continue
        outside = _outside(evidence.solution.problem)
        if Proportion(share.count, share.samples, confidence=1 - _RARE).lower > outside:
            source = "the zones of its numbers" if outside > _ROUNDING else "the expansion"
            text = f"The share of systems that break '{limit.name}'"
            yield Disagreement(text, outside, share.estimate, np.nan, source=source)


def _outside(problem: Problem) -> float:
    """The probability of a number outside of its zone, where a limit for all systems says nothing; 0 without zones."""
    ends = (
        germ.cumulative(np.array(one.reach()))
        for place, one in problem.placements.distributions.items()
        for germ in one.germs(place).values()
    )
    return 1 - math.prod(float(high - low) for low, high in ends)


# --- Comparisons -----------------------------------------------------------------------------------------------------


def reach(freedom: int, comparisons: int = 1) -> float:
    """How many standard errors are beyond chance, by Student's t: four for one comparison and a large sample."""
    return float(-scipy.special.stdtrit(freedom, _RARE / 2 / comparisons))


def worst_disagreement(
    text: str,
    expected: Float[np.ndarray, "*shape"],
    estimate: Float[np.ndarray, "*shape"],
    standard_error: Float[np.ndarray, "*shape"],
    *,
    samples: int,
    freedom: int,
    floor: float = 0.0,
    times: Float[np.ndarray, " instants"] | None = None,
) -> Disagreement | None:
    """The worst disagreement of a sampled number, or one per instant, with the expected one; None if it agrees.

    Differences up to `floor` are ignored.
    """
    expected, estimate, error = np.broadcast_arrays(expected, np.asarray(estimate, float), standard_error)
    floor = max(floor, _ROUNDING * float(np.max(np.abs([expected, estimate]))), 1e-300)
    limit = max(reach(freedom, estimate.size), _RELATIVE * np.sqrt(samples)) * error
    with np.errstate(invalid="ignore"):
        ratio = np.nan_to_num(np.abs(estimate - expected) / np.maximum(limit, floor), nan=np.inf)
    ratio = np.where(np.isnan(error), 0.0, ratio)  # without a standard error there is no verdict
    i = int(np.argmax(ratio))
    if not ratio.flat[i] > 1:
        return None
    numbers = float(expected.flat[i]), float(estimate.flat[i]), float(error.flat[i])
    return Disagreement(text, *numbers, _instant(times, i, estimate.size))


def _instant(times: Float[np.ndarray, " instants"] | None, place: int, size: int) -> float | None:
    """The instant of a number among all of a path, whose values may have several components."""
    return None if times is None else float(times[place // (size // len(times))])


def is_rare(count: int, samples: int, probability: float) -> bool:
    """Whether a count disagrees with a probability, by the exact interval and by an amount that matters."""
    share = Proportion(count, samples, confidence=1 - _RARE)
    inside = share.lower <= probability <= share.upper
    return not inside and abs(share.estimate - probability) > _RELATIVE * np.sqrt(probability * (1 - probability))


def compared(
    evidence: Evidence, problem: Problem, known: Mapping[str, Estimated]
) -> Iterator[tuple[Constraint, Compared]]:
    """The limits on statistics, without those that need statistics other than the `known`, by text.

    Where systems are counted against a limit, its statistics are compared as moments are: up to a hundredth of one
    system's contribution and the grid's error.
    """
    solution, freedom = evidence.solution, group_count(evidence.samples) - 1
    for limit, solved in zip(problem.constraints, solution.constraints, strict=True):
        if not any(isinstance(leaf, Statistic) for leaf in limit.expression.leaves):
            continue
        if (sampled := estimated(problem, limit.expression, known, solution.vector)) is None:
            continue
        value, error = np.ravel(sampled.value), np.ravel(sampled.error)
        lower, upper = float(limit.lower), float(limit.upper)
        beyond = np.maximum(value - upper, lower - value)
        sure, tolerance = reach(freedom, value.size), np.full(value.size, HELD * solved.scale)
        if is_counted(problem, limit):
            tolerance += _RELATIVE * np.sqrt(evidence.samples) * error + _of_grid(solution, limit.expression)
        i = int(np.argmax(beyond - sure * error - tolerance))
        yield (
            limit,
            Compared(
                name=limit.name,
                text=str(limit),
                value=float(value[i]),
                standard_error=float(error[i]),
                time=_instant(solution.times_of(limit) if limit.is_path else None, i, value.size),
                bound=upper if value[i] - upper >= lower - value[i] else lower,
                beyond=float(beyond[i]),
                tolerance=float(tolerance[i]),
                reach=sure,
            ),
        )


def _of_grid(solution: Solution, expression: Expression) -> float:
    """The known error of an expression on the solution's grid, zero where none is."""
    error = solution.certificate.grid_error
    known = {} if error is None else error.functionals
    each = (
        abs(float(factor)) * known[one.text()].error
        for factor, atom in zip(expression.factors, expression.atoms, strict=True)
        for part in atom.parts
        if isinstance(part, Statistic)
        for one in part.functionals
        if one.text() in known
    )
    return float(np.nansum(list(each)))
