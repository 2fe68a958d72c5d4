"""Evidence from what systems of a sample gave, and where it contradicts the solution."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator.design import (
    AbstractFunctional,
    Estimated,
    Problem,
    Statistic,
    expanded_functionals,
    functionals_of,
    is_worst_case,
    joined,
    statistics_in,
)
from aleator.nlp import HELD
from aleator.references._estimate import estimate, group_count
from aleator.solution import Solution
from aleator.statistics import Infimum, Mean, Probability, Quantile, Sobol, Std, Supremum, Variance
from aleator.validation._batches import Batch, Sums
from aleator.validation._comparisons import RELATIVE, ROUNDING, Disagreement, compared, is_rare, worst_disagreement
from aleator.validation._evidence import PERCENTILES, Checked, Evidence, Sampled, Trajectories
from aleator.validation._shares import broken_by
from aleator.validation._systems import Systems

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
    evidence = replace(
        evidence, compared=tuple(compared(solution, problem, _estimates(problem, evidence), group_count(samples) - 1))
    )
    # A deterministic design has no expansion that they could contradict.
    if not solution.problem.placements.germs:
        return evidence
    return replace(evidence, disagreements=(*_moments(evidence), *_statistics(evidence), *_limits(evidence)))


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
    """The statistics that samples estimate with a standard error, by their texts; of paths the first two moments."""
    known = {
        text: Estimated(np.asarray(one.estimate), np.asarray(one.standard_error))
        for text, one in evidence.statistics.items()
    }
    for atom in statistics_in(problem.expressions):
        one, *others = (evidence.functionals[functional.text()] for functional in atom.functionals)
        # The second functional of a noisy statistic is what noise adds to the variance.
        noise = [part.mean for part in others] if getattr(atom.kind, "noisy", False) else []
        variance = np.asarray(one.std**2 + sum(noise))
        of_path: dict[type, Estimated] = {
            Mean: Estimated(one.mean, one.standard_error),
            Std: Estimated(np.sqrt(variance), one.std_error),
            Variance: Estimated(variance, np.asarray(2 * one.std * one.std_error)),
        }
        if atom.is_path and type(atom.kind) in of_path:
            known[atom.text()] = of_path[type(atom.kind)]
    return known


def _moments(evidence: Evidence) -> Iterator[Disagreement]:
    """Means and standard deviations; functionals with only a worst case do not use the expansion."""
    solution, certificate = evidence.solution, evidence.solution.certificate
    deviations = {} if certificate.grid_error is None else certificate.grid_error.functionals
    for functional in expanded_functionals(solution.problem.expressions):
        text, is_path = functional.text(), functional.is_path
        one = evidence.functionals[text]
        ignored = (
            ROUNDING * float(np.max(np.abs(one.mean))),
            # Some are mere rounding, such as of a rate that is zero at the end of every motion.
            _ROUNDING_OF_REACH * certificate.reaches.get(text, 0.0),
            RELATIVE * float(np.max(one.std)) if is_path else 0.0,
            # The known error of the grid, by which samples on a finer grid differ; NaN where it is not known.
            deviations[text].error if text in deviations else 0.0,
        )
        for part in (
            (f"μ[{text}]", one.expanded_mean, one.mean, one.standard_error),
            (f"σ[{text}]", one.expanded_std, one.std, one.std_error),
        ):
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
        if isinstance(kind, Mean | Std) or any(np.std(one) <= ROUNDING * np.max(np.abs(one)) for one in samples):
            contradicts = False  # told by their moments
        elif isinstance(kind, Probability):
            count = round(one.estimate * evidence.samples)
            contradicts = is_rare(count, evidence.samples, min(max(expected, 0.0), 1.0))
        elif isinstance(kind, Quantile):
            contradicts = is_rare(int(np.sum(samples[0] <= expected)), evidence.samples, float(kind.level))
        elif isinstance(kind, Supremum | Infimum):
            past = one.estimate - expected if isinstance(kind, Supremum) else expected - one.estimate
            contradicts = past > RELATIVE * samples[0].std()
        else:
            numbers = np.asarray(expected), np.asarray(one.estimate), np.asarray(one.standard_error)
            freedom = group_count(evidence.samples) - 1
            found = worst_disagreement(text, *numbers, samples=evidence.samples, freedom=freedom)
            contradicts = found is not None
        if contradicts:
            yield Disagreement(text, expected, one.estimate, one.standard_error)


def _limits(evidence: Evidence) -> Iterator[Disagreement]:
    """Limits on statistics that the samples break, and limits for all systems that some samples break."""
    for one in evidence.compared:
        if one.meets is False:
            yield Disagreement(one.text, one.bound, one.value, one.standard_error, one.time, "its bound")
    for limit in evidence.solution.problem.constraints:
        share = evidence.violations.get(limit.name)
        atoms = (atom for atom in limit.expression.atoms if isinstance(atom, Statistic))
        for_all = is_worst_case(limit) or any(isinstance(atom.kind, Supremum | Infimum) for atom in atoms)
        if share is not None and share.count and for_all:
            yield Disagreement(f"The share of systems that break '{limit.name}'", 0.0, share.estimate, np.nan)
