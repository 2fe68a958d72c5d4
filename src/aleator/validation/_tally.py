"""A large sample in stretches: which systems each has, what it finds, how they are put together and become evidence.

Each system has its own place in one stream of random numbers, so that a stretch can be simulated anywhere, and after a
crash alone. Sums over a sample are those over its stretches, in order, so that digits do not depend on who simulated
which.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator.design import (
    AbstractFunctional,
    Estimated,
    Problem,
    Statistic,
    functionals_of,
    is_over_time,
    joined,
    statistics_in,
)
from aleator.ensemble import Part, drawn_from, each, fill
from aleator.references._estimate import estimate, group_count
from aleator.solution import Solution
from aleator.statistics import Infimum, Mean, Sobol, Std, Supremum, TotalSobol, Variance
from aleator.validation._evidence import PERCENTILES, Checked, Evidence, Sample, Sampled, Trajectories, disagreements
from aleator.validation._limits import Compared, Proportion, compared, finer_by, is_counted, uncounted
from aleator.validation._sums import Sums
from aleator.validation._systems import Batch, Systems

# Stretches of a sample at most: a millisecond each is spent on beginning one elsewhere, and as much on keeping one.
_MOST = 128
# Systems times instants from which a second compilation, of a program without histories, is worth while.
_MANY = 2e8
# Without histories more systems are simulated at a time, because each step of a loop has a cost of its own.
_TOGETHER = 4


@final
class Plan(NamedTuple):
    """How a sample is taken: the arguments of `validate`, and how many systems come `before` those that are folded."""

    samples: int
    seed: int
    batch: int
    keep: int
    before: int

    @classmethod
    def of(cls, systems: Systems, samples: int, seed: int, batch: int, keep: int) -> "Plan":
        """The plan for some systems. Trajectories are kept of the first ones, so these are never folded."""
        batch, keep = min(batch, samples), min(keep, samples)
        before = samples
        if systems.folds and samples * systems.instants >= _MANY:
            before = min(-(-keep // batch) * batch, samples)
        return cls(samples, seed, batch, keep, before)

    @property
    def folded_batch(self) -> int:
        """How many systems are simulated at a time where no histories are stored."""
        return min(_TOGETHER * self.batch, max(self.samples - self.before, 1))

    @property
    def stretches(self) -> tuple["Stretch", ...]:
        """The sample in stretches, the same wherever they are simulated."""
        ends = (0, self.before, self.batch), (self.before, self.samples, self.folded_batch)
        return tuple(
            Stretch(first, min(length, end - first), batch)
            for begin, end, batch in ends
            for length in [batch * max(-(-self.samples // (_MOST * batch)), 1)]
            for first in range(begin, end, length)
        )


class Stretch(NamedTuple):
    """Systems of a sample, one after another: the first one's number, how many, and how many at a time."""

    first: int
    systems: int
    batch: int

    @property
    def end(self) -> int:
        """The number of the system after the last one."""
        return self.first + self.systems


class Simulated(NamedTuple):
    """What a stretch found, with the names of `Batch`.

    - `excess`: shape (constraints, count); `scalars`: shape (count,); `paths`: moments; `values`: of the systems whose
      trajectories are kept.
    """

    excess: Float[np.ndarray, "constraints count"]
    scalars: dict[int, Float[np.ndarray, " count"]]
    paths: dict[int, Sums]
    values: dict[int, Float[np.ndarray, "kept ..."]]

    @classmethod
    def of(cls, batch: Batch, part: Part, keep: int) -> "Simulated":
        """What one batch found; `keep`: trajectories of the first so many systems of the sample."""
        count, kept = len(part.points), max(min(keep - part.first, len(part.points)), 0)
        return cls(
            np.asarray(batch.excess)[:, :count],
            {i: np.asarray(values)[:count] for i, values in batch.scalars.items()},
            {i: Sums(count, *map(np.asarray, sums)) for i, sums in batch.paths.items()},
            {i: np.array(np.asarray(values)[:kept]) for i, values in batch.values.items()} if kept else {},
        )

    @classmethod
    def joined(cls, some: "Sequence[Simulated]") -> "Simulated":
        """Several, in the order of their systems."""
        first, *rest = some
        paths = dict(first.paths)
        for one in rest:
            paths = {i: sums.merged(one.paths[i]) for i, sums in paths.items()}
        return cls(
            np.concatenate([one.excess for one in some], axis=1),
            {i: np.concatenate([one.scalars[i] for one in some]) for i in first.scalars},
            paths,
            {i: np.concatenate([one.values[i] for one in some if i in one.values]) for i in first.values},
        )


def simulated(systems: Systems, plan: Plan, stretches: Sequence[Stretch]) -> Iterator[tuple[Stretch, Simulated]]:
    """What each of some stretches finds, in order, on all cores.

    Raises `SimulationError` if a system's results are not finite, naming its parameter values.
    """
    for is_folded in sorted({one.first >= plan.before for one in stretches}):
        systems.prepare(plan.folded_batch if is_folded else plan.batch, is_folded=is_folded)

    def parts() -> Iterator[Part]:
        for one in stretches:
            for first in range(one.first, one.end, one.batch):
                count = min(one.batch, one.end - first)
                yield Part(first, drawn_from(systems.germs, plan.seed, first, count))

    def batch(part: Part) -> Simulated:
        is_folded = part.first >= plan.before
        points = fill(part.points, plan.folded_batch if is_folded else plan.batch)
        return Simulated.of(systems.simulate(points, len(part.points), is_folded=is_folded), part, plan.keep)

    found = each(batch, parts())
    for one in stretches:
        some = [done for _, done in itertools.islice(found, -(-one.systems // one.batch))]
        yield one, Simulated.joined(some)


@final
class Tally:
    """The samples so far. Moments of paths are merged stretch by stretch."""

    def __init__(self, problem: Problem, tolerances: Float[np.ndarray, " constraints"], samples: int):
        self._problem = problem
        self._functionals = functionals_of(problem.expressions)
        self._tolerances = tolerances
        self._samples = samples
        self._scalars: dict[int, Float[np.ndarray, " samples"]] = {}
        self._paths: dict[int, Sums] = {}
        self._excess = np.empty((len(problem.constraints), samples))
        self._kept: dict[int, list[np.ndarray]] = {}

    def add(self, found: Simulated, start: int) -> None:
        """Add a stretch whose systems are numbered from `start`."""
        rows = slice(start, start + found.excess.shape[1])
        self._excess[:, rows] = found.excess
        for i, values in found.scalars.items():
            self._scalars.setdefault(i, np.empty(self._samples))[rows] = values
        for i, values in found.values.items():
            self._kept.setdefault(i, []).append(values)
        for i, sums in found.paths.items():
            self._paths[i] = self._paths[i].merged(sums) if i in self._paths else sums

    def evidence(self, solution: Solution, seed: int, seconds: float) -> Evidence:
        """Everything sampled, as evidence."""
        names = dict.fromkeys(one.name for one in self._problem.constraints if is_counted(one))
        broken = {name: self._breaks(name) for name in names}
        functionals = {one.text(): self._sampled(i, one, solution) for i, one in enumerate(self._functionals)}
        statistics = {one.text(): self._checked(one, solution) for one in self._countable_statistics()}
        shares = {name: Proportion(int(mask.sum()), self._samples) for name, mask in broken.items()}
        limits = self._compared(solution, functionals, statistics)
        found = Sample(solution, self._problem, self._samples, functionals, statistics, self._values(), shares, limits)
        joint = np.any([np.zeros(self._samples, bool), *broken.values()], axis=0)
        return Evidence(
            solution=solution,
            samples=self._samples,
            seed=seed,
            violations=shares,
            joint=Proportion(int(joint.sum()), self._samples),
            uncounted=uncounted(self._problem),
            instants=self._instants(solution),
            functionals=functionals,
            statistics=statistics,
            trajectories=tuple(self._trajectories(i, broken) for i in self._kept),
            seconds=seconds,
            broken=broken,
            compared=limits,
            disagreements=disagreements(found),
        )

    def _values(self) -> dict[str, Float[np.ndarray, " samples"]]:
        """The samples of the functionals that are numbers, by their texts."""
        return {self._functionals[i].text(): values for i, values in self._scalars.items()}

    def _compared(
        self, solution: Solution, functionals: Mapping[str, Sampled], statistics: Mapping[str, Checked]
    ) -> tuple[Compared, ...]:
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
            compared(self._problem, one, known, solution.vector, float(tolerance), freedom)
            for one, tolerance in rows
            if not is_counted(one)
        )
        return tuple(one for one in found if one is not None)

    def _instants(self, solution: Solution) -> int | None:
        """The number of instants at which limits over time were counted; None where there are no such limits."""
        if not any(is_over_time(one) and is_counted(one) for one in self._problem.constraints):
            return None
        return (len(solution.instants) - 1) * finer_by(solution) + 1

    def _countable_statistics(self) -> tuple[Statistic, ...]:
        """The statistics in the problem that can be estimated from the samples of functionals that are numbers."""
        known = [self._functionals[i] for i in self._scalars]
        return tuple(
            atom
            for atom in statistics_in(self._problem.expressions)
            if all(one in known for one in atom.functionals) and not isinstance(atom.kind, Sobol | TotalSobol)
        )

    def _checked(self, statistic: Statistic, solution: Solution) -> Checked:
        values = joined([jax_array(self._scalars[self._functionals.index(one)]) for one in statistic.functionals])
        expanded = float(solution.statistics[statistic.text()])
        if isinstance(statistic.kind, Supremum | Infimum):
            # A sample does not show how far its extremes are from those of the distribution.
            return Checked(statistic, expanded, float(statistic.kind.of_sample(values)), np.nan)
        found = estimate(statistic.kind.of_sample, np.asarray(values), group_count(self._samples))
        return Checked(statistic, expanded, float(found.value), float(found.standard_error))

    def _breaks(self, name: str) -> np.ndarray:
        rows = [i for i, one in enumerate(self._problem.constraints) if one.name == name and is_counted(one)]
        return np.any(self._excess[rows] > self._tolerances[rows, None], axis=0)

    def _sampled(self, i: int, functional: AbstractFunctional, solution: Solution) -> Sampled:
        moments = solution.moments[functional.text()]
        percentiles = None
        if i in self._scalars:
            sums = Sums.of(self._scalars[i])
            percentiles = np.percentile(self._scalars[i], PERCENTILES)
        else:
            sums = self._paths[i]
        return Sampled(
            text=functional.text(),
            mean=np.asarray(sums.mean),
            std=sums.std,
            standard_error=np.asarray(sums.std / np.sqrt(self._samples)),
            percentiles=percentiles,
            expanded_mean=moments.mean,
            expanded_std=moments.std,
            std_error=sums.std_error,
            values=self._scalars.get(i),
        )

    def _trajectories(self, i: int, broken: dict[str, np.ndarray]) -> Trajectories:
        constraint = self._problem.constraints[i]
        values = np.concatenate(self._kept[i])
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
