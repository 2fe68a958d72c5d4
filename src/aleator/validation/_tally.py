"""Evidence from what systems of a sample gave, and where it contradicts the solution."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import final

import numpy as np
from jaxtyping import Bool, Float

from aleator._core.arrays import jax_array
from aleator.design import (
    AbstractFunctional,
    Estimated,
    Problem,
    Statistic,
    expanded_functionals,
    functionals_of,
    is_over_time,
    is_worst_case,
    joined,
    statistics_in,
)
from aleator.references._estimate import estimate, group_count
from aleator.solution import Solution
from aleator.statistics import (
    Correlation,
    Covariance,
    Infimum,
    Kurtosis,
    Mean,
    Probability,
    Quantile,
    Skewness,
    Sobol,
    Std,
    Supremum,
    TotalSobol,
    Variance,
)
from aleator.validation._batches import Batch, Sums
from aleator.validation._evidence import PERCENTILES, Checked, Evidence, Sampled, Trajectories
from aleator.validation._limits import (
    Compared,
    Disagreement,
    compared,
    finer_by,
    is_counted,
    is_rare,
    tolerances,
    worst_disagreement,
)


def broken_by(
    problem: Problem, excess: Float[np.ndarray, "constraints systems"], tolerances: Float[np.ndarray, " constraints"]
) -> dict[str, Bool[np.ndarray, " systems"]]:
    """Which systems break any limit of each name against which they are counted."""
    broken: dict[str, Bool[np.ndarray, " systems"]] = {}
    for limit, beyond, tolerance in zip(problem.constraints, excess, tolerances, strict=True):
        if is_counted(limit):
            broken[limit.name] = broken.get(limit.name, False) | (beyond > tolerance)
    return broken


@final
class Tally:
    """What all systems of a sample gave, beside the solution whose `problem` has its distributions restored."""

    def __init__(self, solution: Solution, problem: Problem, whole: Batch):
        self._solution, self._problem, self._whole = solution, problem, whole
        self._functionals = functionals_of(problem.expressions)
        self._samples = whole.excess.shape[1]
        self._tolerances = tolerances(solution)

    def evidence(self, seed: int, seconds: float) -> Evidence:
        """Everything sampled, as evidence."""
        broken = broken_by(self._problem, self._whole.excess, self._tolerances)
        functionals = {one.text(): self._sampled(i, one) for i, one in enumerate(self._functionals)}
        statistics = {one.text(): self._checked(one) for one in self._countable_statistics()}
        found = Evidence(
            solution=self._solution,
            samples=self._samples,
            seed=seed,
            instants=self._instants(),
            functionals=functionals,
            statistics=statistics,
            trajectories=tuple(self._trajectories(i, broken) for i in self._whole.values),
            seconds=seconds,
            broken=broken,
            compared=self._compared(functionals, statistics),
        )
        return replace(found, disagreements=_disagreements(found))

    def _compared(self, functionals: Mapping[str, Sampled], statistics: Mapping[str, Checked]) -> tuple[Compared, ...]:
        """The limits against which no system is counted, with sampled statistics, where these are known."""
        known = {
            text: Estimated(np.asarray(one.estimate), np.asarray(one.standard_error))
            for text, one in statistics.items()
        }
        for atom in statistics_in(self._problem.expressions):
            one = functionals[atom.functionals[0].text()]
            if atom.functionals[0].is_path and isinstance(atom.kind, Mean | Std | Variance):
                known[atom.text()] = _of_path(atom, one)
        rows = zip(self._problem.constraints, self._tolerances, strict=True)
        freedom = group_count(self._samples) - 1
        found = (
            compared(self._problem, one, known, self._solution.vector, float(tolerance), freedom)
            for one, tolerance in rows
            if not is_counted(one)
        )
        return tuple(one for one in found if one is not None)

    def _instants(self) -> int | None:
        """The number of instants at which limits over time were counted; None where there are no such limits."""
        if not any(is_over_time(one) and is_counted(one) for one in self._problem.constraints):
            return None
        return (len(self._solution.instants) - 1) * finer_by(self._solution) + 1

    def _countable_statistics(self) -> tuple[Statistic, ...]:
        """The statistics in the problem that can be estimated from the samples of functionals that are numbers."""
        known = [self._functionals[i] for i in self._whole.scalars]
        return tuple(
            atom
            for atom in statistics_in(self._problem.expressions)
            if all(one in known for one in atom.functionals) and not isinstance(atom.kind, Sobol | TotalSobol)
        )

    def _checked(self, statistic: Statistic) -> Checked:
        places = map(self._functionals.index, statistic.functionals)
        values = joined([jax_array(self._whole.scalars[i]) for i in places])
        expanded = float(self._solution.statistics[statistic.text()])
        if isinstance(statistic.kind, Supremum | Infimum):
            # A sample does not show how far its extremes are from those of the distribution.
            return Checked(statistic, expanded, float(statistic.kind.of_sample(values)), np.nan)
        found = estimate(statistic.kind.of_sample, np.asarray(values), group_count(self._samples))
        return Checked(statistic, expanded, float(found.value), float(found.standard_error))

    def _sampled(self, i: int, functional: AbstractFunctional) -> Sampled:
        moments, values = self._solution.moments[functional.text()], self._whole.scalars.get(i)
        sums = self._whole.paths[i] if values is None else Sums.of(values)
        return Sampled(
            text=functional.text(),
            mean=np.asarray(sums.mean),
            std=sums.std,
            standard_error=np.asarray(sums.std / np.sqrt(self._samples)),
            percentiles=None if values is None else np.percentile(values, PERCENTILES),
            expanded_mean=moments.mean,
            expanded_std=moments.std,
            std_error=sums.std_error,
            values=values,
        )

    def _trajectories(self, i: int, broken: Mapping[str, Bool[np.ndarray, " systems"]]) -> Trajectories:
        constraint, values = self._problem.constraints[i], self._whole.values[i]
        return Trajectories(
            name=constraint.name,
            lower=float(constraint.lower),
            upper=float(constraint.upper),
            values=values,
            violating=broken.get(constraint.name, np.zeros(self._samples, bool))[: len(values)],
        )


def _of_path(atom: Statistic, one: Sampled) -> Estimated:
    """The mean, standard deviation or variance of a path, with its standard error."""
    if isinstance(atom.kind, Mean):
        return Estimated(one.mean, one.standard_error)
    if isinstance(atom.kind, Std):
        return Estimated(one.std, one.std_error)
    return Estimated(np.asarray(one.std**2), np.asarray(2 * one.std * one.std_error))


# A spread below this fraction of the magnitude behind a functional is rounding.
_ROUNDING = 1e-11


def _disagreements(evidence: Evidence) -> tuple[Disagreement, ...]:
    """The numbers that samples contradict; none for a deterministic design, which has no expansion."""
    problem = evidence.solution.problem
    if not problem.placements.germs:
        return ()
    found = [*_moments(evidence), *_statistics(evidence), *_limits(evidence)]
    if not found:
        return ()
    # Some are mere rounding, such as of a rate that is zero at the end of every motion.
    reaches = evidence.solution.certificate.reaches
    rounding = {f"{symbol}[{text}]": _ROUNDING * reach for text, reach in reaches.items() for symbol in "μσ"}
    return tuple(one for one in found if not abs(one.estimate - one.expected) <= rounding.get(one.text, -1.0))


def _moments(evidence: Evidence) -> Iterator[Disagreement]:
    times, samples = evidence.solution.instants, evidence.samples
    # Functionals with only a worst case do not use the expansion.
    for text in (one.text() for one in expanded_functionals(evidence.solution.problem.expressions)):
        one = evidence.functionals[text]
        when = times if np.ndim(one.mean) else None
        size = float(np.max(np.abs(one.mean)))
        spread = 0.0 if when is None else float(np.max(one.std))
        told_before = _of_the_grid(evidence.solution, text)
        parts = (
            (f"μ[{text}]", one.expanded_mean, one.mean, one.standard_error),
            (f"σ[{text}]", one.expanded_std, one.std, one.std_error),
        )
        for part in parts:
            told = worst_disagreement(
                *part,
                samples=samples,
                freedom=samples - 1,
                size=size,
                spread=spread,
                known=told_before,
                times=when,
            )
            if told is not None:
                yield told


def _of_the_grid(solution: Solution, text: str) -> float:
    """The known grid error of a functional, by which samples on a finer grid differ."""
    error = solution.certificate.grid_error
    deviation = None if error is None else error.functionals.get(text)
    return 0.0 if deviation is None or np.isnan(deviation.error) else deviation.error


def _statistics(evidence: Evidence) -> Iterator[Disagreement]:
    for text, one in evidence.statistics.items():
        kind = one.statistic.kind
        if isinstance(kind, Mean | Std):
            continue
        expected, estimate, error = one.expanded, one.estimate, one.standard_error
        samples = [np.asarray(evidence.functionals[each.text()].values) for each in one.statistic.functionals]
        values = samples[0]
        if isinstance(kind, Probability):
            contradicts = is_rare(round(estimate * evidence.samples), evidence.samples, min(max(expected, 0.0), 1.0))
        elif isinstance(kind, Quantile):
            contradicts = is_rare(int(np.sum(values <= expected)), evidence.samples, float(kind.level))
        elif isinstance(kind, Supremum | Infimum):
            past = estimate - expected if isinstance(kind, Supremum) else expected - estimate
            contradicts = past > 0.01 * values.std()
        else:
            numbers = np.asarray(expected), np.asarray(estimate), np.asarray(error)
            freedom = group_count(evidence.samples) - 1
            size = _size(one.statistic, samples)
            told = worst_disagreement(text, *numbers, samples=evidence.samples, freedom=freedom, size=size)
            contradicts = told is not None
        if contradicts:
            yield Disagreement(text, expected, estimate, error)


def _size(statistic: Statistic, values: list[Float[np.ndarray, " samples"]]) -> float:
    """The magnitude to which rounding of a statistic is relative; zero for dimensionless statistics."""
    largest = [float(np.max(np.abs(one))) for one in values]
    if isinstance(statistic.kind, Covariance | Variance):
        return largest[0] * largest[-1]
    return 0.0 if isinstance(statistic.kind, Skewness | Kurtosis | Correlation) else largest[0]


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
