"""Fresh random systems of a design: how they are simulated, and which of them a stretch of a large sample has.

Each system has its own place in one stream of random numbers, so that a stretch can be simulated anywhere, and after a
crash alone. Sums over a sample are those over its stretches, in order, so that digits do not depend on who simulated
which.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Array, Bool, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.errors import ProblemError, SimulationError
from aleator.design import (
    Problem,
    first_broken,
    functionals_of,
    grid_at,
    history,
    is_over_time,
    refuse_changed_code,
    responses,
    uncertain,
    unsolved,
)
from aleator.ensemble import Part, drawn_from, each, fill, inputs_at, listed
from aleator.solution import Solution
from aleator.validation._batches import EXCESS_OVER_TIME, SIMULATE_BATCH, SIMULATE_FOLDED, Batch, folds
from aleator.validation._limits import finer_by, is_counted, sampled_by


@final
class Systems:
    """The uncertain systems of a solution, at its decisions: one for each germ point of a batch.

    - `problem`: the problem with its distributions restored; `germs`: their variables;
    - `sampled`: the problem on the grid for simulations, whose error is an order of magnitude below the tolerance;
    - `folds`: whether it can be simulated without storing histories (`is_folded`).

    Raises `ProblemError`, in the name of the caller `who`, where nothing is uncertain or nothing can be sampled.
    """

    def __init__(self, solution: Solution, who: str):
        refuse_changed_code(solution.problem)
        self.problem = uncertain(solution.problem)
        self.germs = tuple(self.problem.placements.germs.values())
        if not self.germs:
            raise ProblemError(f"{who}: nothing in this problem is uncertain, so there is nothing to sample.")
        if not functionals_of(self.problem.expressions):
            raise ProblemError(
                f"{who}: this problem contains no functional of an output, so there is nothing to sample."
            )
        self._vector = solution.vector
        self._decisions, self._factor = jax_array(solution.vector), sampled_by(solution)
        self.sampled = _on_finer(self.problem, self._factor)
        self._traced = numbers_to_arrays(self.sampled)
        self.folds = folds(self.sampled)
        counted = finer_by(solution)
        self._finer = None if counted == self._factor else _for_limits(self.problem, counted)

    @property
    def instants(self) -> int:
        """The number of instants of each simulation."""
        return self.sampled.grid.steps + 1

    def prepare(self, batch: int, *, is_folded: bool = False) -> None:
        """Start compiling for batches of `batch` systems. The user's code is traced here, by one thread alone."""
        germ = jax_array(np.zeros((batch, len(self.germs))))
        program = SIMULATE_FOLDED if is_folded else SIMULATE_BATCH
        program.prepare(self._traced, germ, self._decisions, jax_array(batch), self._factor)
        if self._finer is not None:
            EXCESS_OVER_TIME.prepare(self._finer, germ, self._decisions)

    def simulate(self, germ: Float[np.ndarray, "systems variables"], count: int, *, is_folded: bool = False) -> Batch:
        """Simulate the systems at some germ points. Those after the first `count` are padding and do not count.

        - `is_folded`: without storing histories, and so without the values of path constraints.

        Raises `SimulationError` if a system's results are not finite, naming its parameter values.
        """
        program = SIMULATE_FOLDED if is_folded else SIMULATE_BATCH
        result = program(self._traced, jax_array(germ), self._decisions, jax_array(count), self._factor)
        refuse_broken(self.sampled, np.asarray(result.finite)[:count], germ[:count], self._vector)
        if self._finer is None:
            return result
        beyond = EXCESS_OVER_TIME(self._finer, jax_array(germ), self._decisions)
        refuse_broken(self._finer, np.isfinite(beyond).all(axis=0)[:count], germ[:count], self._vector)
        excess = np.array(result.excess)
        excess[[i for i, one in enumerate(self.problem.constraints) if is_over_time(one)]] = beyond
        return result._replace(excess=excess)


def _on_finer(problem: Problem, factor: int) -> Problem:
    """The problem on a grid `factor` times finer, where time plays a part."""
    return problem if factor == 1 else problem.on_grid(problem.grid.finer(factor))


def _for_limits(problem: Problem, factor: int) -> Problem | None:
    """The problem on a grid `factor` times finer; None where no limit over time is counted there."""
    limits = any(is_over_time(one) and is_counted(one) for one in problem.constraints)
    return numbers_to_arrays(_on_finer(problem, factor)) if limits else None


def refuse_broken(
    problem: Problem,
    finite: Bool[np.ndarray, " systems"],
    germ: Float[np.ndarray, "systems variables"],
    vector: np.ndarray,
) -> None:
    """Raise `SimulationError` for the first system that is not `finite`: its numbers, and what is not from when on.

    `problem`: on the grid on which they were simulated.
    """
    if finite.all():
        return
    point, decisions = jax_array(germ[np.argmin(finite)]), jax_array(vector)
    numbers = listed(inputs_at(problem.placements, point, decisions))
    remedy = "Shorten the time step, use an implicit integrator (al.integrators.Kvaerno5), or bound the distributions."
    raise SimulationError(
        f"Monte Carlo: the simulation of the system{numbers and ' with '}{numbers} is not finite"
        f"{_what(problem, point, decisions)}. {unsolved(problem, point, decisions) or remedy}"
    )


def _what(problem: Problem, point: Float[Array, " variables"], decisions: Float[Array, " n"]) -> str:
    """Which outputs of one system are not finite, and from when on; empty if simulated alone it is finite."""
    outputs = {name: np.asarray(values)[None] for name, values in history(problem, point, decisions).items()}
    if (broken := first_broken(outputs)) is not None:
        times = np.asarray(grid_at(problem, decisions).times)
        since = f" from t = {times[broken.instant]:.4g} s on" if problem.system.has_time else ""
        return f": output '{broken.name}'{since}"
    functionals = functionals_of(problem.expressions)
    values = responses(problem, functionals, point[None], decisions)
    bad = [one.text() for one, value in zip(functionals, values, strict=True) if not np.isfinite(value).all()]
    return f": {bad[0]}" if bad else ""


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


def simulated(systems: Systems, plan: Plan, stretches: Sequence[Stretch]) -> Iterator[tuple[Stretch, Batch]]:
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

    def batch(part: Part) -> Batch:
        is_folded = part.first >= plan.before
        points = fill(part.points, plan.folded_batch if is_folded else plan.batch)
        count = len(part.points)
        found = systems.simulate(points, count, is_folded=is_folded)
        return found.first(count, keep=max(min(plan.keep - part.first, count), 0))

    found = each(batch, parts())
    for one in stretches:
        some = [done for _, done in itertools.islice(found, -(-one.systems // one.batch))]
        yield one, Batch.joined(some)
