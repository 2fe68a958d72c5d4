"""`validate`: a design on fresh random systems, batch by batch, independent of the expansion that found it."""

import time
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.errors import ProblemError, SimulationError
from aleator._core.progress import Progress, silent
from aleator.design import (
    HELD,
    AbstractFunctional,
    Problem,
    Solution,
    Statistic,
    functionals_of,
    is_over_time,
    joined,
    statistics_in,
    uncertain,
    unsolved,
)
from aleator.dynamics import Grid
from aleator.references import estimate, group_count
from aleator.statistics import Infimum, Sobol, Supremum, TotalSobol
from aleator.uncertainty import uncertain_numbers
from aleator.validation._counted import finer_by, is_counted, uncounted
from aleator.validation._evidence import PERCENTILES, Checked, Evidence, Sampled, Trajectories
from aleator.validation._proportion import Proportion
from aleator.validation._sampling import EXCESS_OVER_TIME, SIMULATE_BATCH, Batch, draw


def validate(
    solution: Solution,
    samples: int = 100_000,
    *,
    seed: int = 0,
    batch: int = 500,
    keep: int = 200,
    progress: Progress = silent,
) -> Evidence:
    """Simulate `samples` fresh random systems at a solution's decisions, with the distributions the problem declared.

    A deterministic design is validated on the uncertain systems it stands for. Systems are simulated `batch` at a time,
    so that memory does not grow with their number; `keep` of them are kept whole, for drawing. `seed` makes it
    repeatable.

    Where the design holds its limits over time between the instants of its grid too, systems are counted against them
    on that finer grid. All else is taken on the design's own grid, as the expansion beside it is.

    Raises `ProblemError` if nothing is uncertain and `SimulationError` if a system gives numbers that are not finite,
    naming its parameter values.
    """
    if not isinstance(solution, Solution):
        raise ProblemError(f"validate: expected a Solution, from al.solve; received {type(solution).__name__}.")
    if not all(isinstance(number, int | np.integer) for number in (samples, seed, batch, keep)):
        raise ProblemError("validate: samples, seed, batch and keep are whole numbers.")
    if samples < 2 or batch < 1 or seed < 0 or keep < 0:
        raise ProblemError(
            f"validate: expected at least 2 samples and a positive batch; received {samples} and {batch}."
        )
    started = time.perf_counter()
    problem = uncertain(solution.problem)
    germs = tuple(problem.survey.germs.values())
    if not germs:
        raise ProblemError("validate: nothing in this problem is uncertain, so there is nothing to sample.")
    if not functionals_of(problem.expressions):
        raise ProblemError("validate: no functional of an output stands in this problem: there is nothing to sample.")
    generator = np.random.default_rng(seed)
    scales = tuple(one.scale for one in solution.constraints)
    tally = _Tally(problem, scales, samples, min(keep, samples))
    traced, decisions = numbers_to_arrays(problem), jnp.asarray(solution.vector)
    finer = _finer(problem, finer_by(solution))
    batch = min(batch, samples)
    for done in range(0, samples, batch):
        progress("Monte Carlo", done, samples)
        # The last batch is drawn in full too, so that one compiled size serves all; what is left over is dropped.
        germ, count = draw(germs, batch, generator), min(batch, samples - done)
        result = SIMULATE_BATCH(traced, jnp.asarray(germ), decisions, jnp.asarray(count))
        if finer is not None:
            result = _with_limits(problem, result, EXCESS_OVER_TIME(finer, jnp.asarray(germ), decisions))
        _refuse_broken(problem, result, germ[:count], solution.vector)
        tally.add(result, done, count)
    progress("Monte Carlo", samples, samples)
    return tally.evidence(solution, seed, time.perf_counter() - started)


def _finer(problem: Problem, factor: int) -> Problem | None:
    """The problem on a grid `factor` times finer; None where no limit over time is counted there."""
    limits = any(is_over_time(one) and is_counted(one) for one in problem.constraints)
    if factor == 1 or not limits or not isinstance(problem.grid, Grid):
        return None
    return numbers_to_arrays(eqx.tree_at(lambda tree: tree.grid, problem, problem.grid.finer(factor)))


def _with_limits(problem: Problem, batch: Batch, beyond: Float[Array, "limits systems"]) -> Batch:
    """A batch with its limits over time judged on a finer grid."""
    rows = jnp.array([i for i, one in enumerate(problem.constraints) if is_over_time(one)])
    finite = batch.finite & jnp.isfinite(beyond).all(axis=0)
    return batch._replace(excess=batch.excess.at[rows].set(beyond), finite=finite)


def _refuse_broken(problem: Problem, batch: Batch, germ: np.ndarray, decisions: np.ndarray) -> None:
    good = np.asarray(batch.finite)[: len(germ)]
    if good.all():
        return
    point = jnp.asarray(germ[np.argmin(good)])
    numbers = uncertain_numbers(problem.survey, point, jnp.asarray(decisions))
    where = ", ".join(f"{name}={float(number):.6g}" for name, number in numbers.items())
    remedy = "Shorten the time step, use an implicit integrator (al.Kvaerno5), or bound the distributions."
    raise SimulationError(
        f"Monte Carlo: the simulation of the system with {where} is not finite. "
        f"{unsolved(problem, point, jnp.asarray(decisions)) or remedy}"
    )


@final
class _Tally:
    """What has been sampled so far. Moments of paths are merged batch by batch (Chan, Golub and LeVeque, 1983)."""

    def __init__(self, problem: Problem, scales: tuple[float, ...], samples: int, keep: int):
        self._problem = problem
        self._functionals = functionals_of(problem.expressions)
        # A limit that is met to a solver's tolerance is not broken by rounding.
        self._tolerances = np.array([HELD * scale for scale in scales])
        self._samples, self._keep = samples, keep
        self._seen = 0
        self._scalars: dict[int, Float[np.ndarray, " samples"]] = {}
        self._mean: dict[int, np.ndarray] = {}
        self._square: dict[int, np.ndarray] = {}
        self._excess = np.empty((len(problem.constraints), samples))
        self._kept: dict[int, list[np.ndarray]] = {}

    def add(self, batch: Batch, start: int, count: int) -> None:
        """Add the first `count` systems of a batch, numbered from `start`."""
        rows = slice(start, start + count)
        self._excess[:, rows] = np.asarray(batch.excess)[:, :count]
        for i, values in batch.scalars.items():
            self._scalars.setdefault(i, np.empty(self._samples))[rows] = np.asarray(values)[:count]
        for i, values in batch.values.items():
            wanted = min(count, self._keep - start)
            if wanted > 0:
                self._kept.setdefault(i, []).append(np.asarray(values[:wanted]))
        self._merge(batch, count)

    def _merge(self, batch: Batch, count: int) -> None:
        total = self._seen + count
        for i, mean in batch.path_mean.items():
            old_mean, old_square = self._mean.get(i, 0.0), self._square.get(i, 0.0)
            shift = np.asarray(mean) - old_mean
            self._mean[i] = old_mean + shift * count / total
            self._square[i] = old_square + np.asarray(batch.path_square[i]) + shift**2 * self._seen * count / total
        self._seen = total

    def evidence(self, solution: Solution, seed: int, seconds: float) -> Evidence:
        """Everything sampled, as evidence."""
        broken = {name: self._breaks(name) for name in self._sampled_names()}
        joint = np.any([np.zeros(self._samples, bool), *broken.values()], axis=0)
        return Evidence(
            solution=solution,
            samples=self._samples,
            seed=seed,
            violations={name: Proportion(int(mask.sum()), self._samples) for name, mask in broken.items()},
            joint=Proportion(int(joint.sum()), self._samples),
            uncounted=uncounted(self._problem),
            instants=self._instants(solution),
            functionals={one.text(): self._sampled(i, one, solution) for i, one in enumerate(self._functionals)},
            statistics={one.text(): self._checked(one, solution) for one in self._countable_statistics()},
            trajectories=tuple(self._trajectories(i, broken) for i in self._kept),
            seconds=seconds,
        )

    def _instants(self, solution: Solution) -> int | None:
        """At how many instants limits over time were counted; None where there are none to count."""
        if not any(is_over_time(one) and is_counted(one) for one in self._problem.constraints):
            return None
        return (len(solution.instants) - 1) * finer_by(solution) + 1

    def _countable_statistics(self) -> tuple[Statistic, ...]:
        """The statistics in the problem that the samples of its functionals, kept where they are numbers, can tell."""
        known = [self._functionals[i] for i in self._scalars]
        return tuple(
            atom
            for atom in statistics_in(self._problem.expressions)
            if all(one in known for one in atom.functionals) and not isinstance(atom.kind, Sobol | TotalSobol)
        )

    def _checked(self, statistic: Statistic, solution: Solution) -> Checked:
        values = joined([jnp.asarray(self._scalars[self._functionals.index(one)]) for one in statistic.functionals])
        expanded = float(solution.statistics[statistic.text()])
        if isinstance(statistic.kind, Supremum | Infimum):
            # How far the extremes of a sample are from those of the law, the sample does not tell.
            return Checked(statistic, expanded, float(statistic.kind.of_sample(values)), np.nan)
        found = estimate(statistic.kind.of_sample, np.asarray(values), group_count(self._samples))
        return Checked(statistic, expanded, float(found.value), float(found.standard_error))

    def _sampled_names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(one.name for one in self._problem.constraints if is_counted(one)))

    def _breaks(self, name: str) -> np.ndarray:
        rows = [i for i, one in enumerate(self._problem.constraints) if one.name == name and is_counted(one)]
        return np.any(self._excess[rows] > self._tolerances[rows, None], axis=0)

    def _sampled(self, i: int, functional: AbstractFunctional, solution: Solution) -> Sampled:
        moments = solution.moments[functional.text()]
        if i in self._scalars:
            values = self._scalars[i]
            mean, std = values.mean(), values.std(ddof=1)
            percentiles = np.percentile(values, PERCENTILES)
        else:
            percentiles = None
            mean, std = self._mean[i], np.sqrt(self._square[i] / (self._samples - 1))
        return Sampled(
            text=functional.text(),
            mean=np.asarray(mean),
            std=np.asarray(std),
            standard_error=np.asarray(std / np.sqrt(self._samples)),
            percentiles=percentiles,
            expanded_mean=moments.mean,
            expanded_std=moments.std,
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
