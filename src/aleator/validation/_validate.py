"""`validate`: a design re-simulated on fresh random systems, independently of the expansion that found it.

Each system has its own place in one stream of random numbers, so that a stretch of a sample can be simulated anywhere,
and after a crash alone. Sums over a sample are those over its stretches, in order, so that digits do not depend on who
simulated which.
"""

import itertools
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any, NamedTuple, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from aleator._core.arrays import NUMBER, jax_array, numbers_to_arrays, refuse_beyond_memory
from aleator._core.border import Progress, check_progress, one_of, silent, whole
from aleator._core.errors import ExpansionWarning, ProblemError, SimulationError
from aleator._core.executors import check_executor, each_of
from aleator._core.journalled import journalled, part_by_part, parts_so_far
from aleator._core.parallel import working
from aleator.design import (
    Problem,
    first_broken,
    functionals_of,
    grid_at,
    history,
    is_over_time,
    refuse_changed_code,
    refuse_large_histories,
    refuse_other_code,
    responses,
    uncertain,
    unsolved,
)
from aleator.ensemble import Part, drawn_from, each, fill, inputs_at, listed
from aleator.nlp import HELD
from aleator.solution import Solution
from aleator.validation._batches import EXCESS_OVER_TIME, SIMULATE_BATCH, SIMULATE_FOLDED, Batch, folds
from aleator.validation._evidence import Evidence, Sampled
from aleator.validation._limits import Disagreement, finer_by, is_counted, sampled_by, tolerances
from aleator.validation._tally import Tally, broken_by


def validate(
    solution: Solution,
    samples: int = 100_000,
    *,
    seed: int = 0,
    batch: int = 250,
    keep: int = 200,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Evidence:
    """Simulate `samples` fresh random systems at a solution's decisions, from the problem's own distributions.

    A deterministic design is validated on the uncertain systems that it stands for. Systems are simulated `batch` at a
    time on each core, so that memory does not grow with their number; the trajectories of `keep` of them are kept, for
    plots. `seed` makes the result reproducible. An `executor` (see `al.pareto`) simulates parts of the sample at once,
    with the same result. Within `al.journal(folder)` what takes long is kept part by part, every few seconds: after a
    crash the same call goes on from there.

    Systems are simulated on the design's own grid if its error is an order of magnitude below the tolerance (see
    `Solution.grid_error`), and otherwise on the finer grid used to estimate it. Where the design's limits over time
    also hold between the instants of its grid, systems are counted against them on that finer grid.

    Every sampled statistic is compared with the expansion's (see `Disagreement`), and limits on statistics are compared
    with their bounds. Where nothing is uncertain, the one system is simulated on a grid ten times finer.

    Issues an `ExpansionWarning` where samples and solution disagree. Raises `ProblemError` if there is nothing to
    simulate or if the results would not fit into memory, and `SimulationError` if a system's results are not finite,
    naming its parameter values.
    """
    one_of("validate", solution, Solution, "that of al.solve")
    least = {"samples": (samples, 2), "batch": (batch, 1), "seed": (seed, 0), "keep": (keep, 0)}
    samples, batch, seed, keep = (whole(f"validate: {name}", one, least=n) for name, (one, n) in least.items())
    check_executor("validate", executor)
    check_progress("validate", progress)
    given = validated_from(solution, samples, seed=seed, batch=batch, keep=keep)
    evidence = journalled("validate", given, lambda: _sampled(solution, samples, seed, batch, keep, executor, progress))
    if not evidence.agrees:
        warnings.warn(f"validate: {evidence.alarm()}", ExpansionWarning, stacklevel=2)
    return evidence if evidence.solution is solution else replace(evidence, solution=solution)


def validated_from(
    solution: Solution, samples: int = 100_000, seed: int = 0, batch: int = 250, keep: int = 200
) -> dict[str, Any]:
    """All that the evidence of `validate` follows from, by name, for the same arguments."""
    return {"solution": solution, "how": (samples, seed, batch, keep)}


def _sampled(
    solution: Solution, samples: int, seed: int, batch: int, keep: int, executor: Executor | None, progress: Progress
) -> Evidence:
    """The evidence: see `validate`."""
    started = time.perf_counter()
    if not uncertain(solution.problem).placements.germs:
        return _alone(solution, started)
    systems = Systems(solution, "validate")
    _refuse_large(systems, samples, min(batch, samples))
    plan = Plan.of(systems, samples, seed, batch, keep)

    def work(stretches: Sequence["Stretch"]) -> Iterator[tuple["Stretch", Batch]]:
        if executor is None:
            return simulated(systems, plan, stretches)
        return each_of(executor, _simulated_there, stretches, {"solution": solution, "plan": plan}, "validate")

    batches: list[Batch] = []
    progress("Monte Carlo", 0, samples)
    for stretch, found in part_by_part(plan.stretches, work, parts_so_far()):
        batches.append(found)
        progress("Monte Carlo", stretch.end, samples)
    tally = Tally(solution, systems.problem, Batch.joined(batches))
    return tally.evidence(seed, time.perf_counter() - started)


def _simulated_there(solution: Solution, plan: "Plan", items: Sequence["Stretch"]) -> list[Batch]:
    refuse_other_code(solution.problem)
    return [found for _, found in simulated(Systems(solution, "validate"), plan, items)]


def _refuse_large(systems: "Systems", samples: int, batch: int) -> None:
    """Refuse a run that would not fit into memory: a number per limit and functional of all systems, or one batch."""
    problem = systems.problem
    columns = 2 * len(problem.constraints) + len(functionals_of(problem.expressions))
    what = f"validate: {columns} numbers of each of {samples} systems"
    refuse_beyond_memory(what, NUMBER * columns * samples, "Ask for fewer samples.")
    refuse_large_histories(systems.sampled, working() * batch, 0, "Take a smaller batch.")


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


# Refinement factor of the grid.
_FINER = 10

# Relative differences up to this are ignored.
_RELATIVE = 1e-3


def _alone(solution: Solution, started: float) -> Evidence:
    """Simulate the one system of a design without uncertainty, on a finer grid if it evolves in time.

    Raises `ProblemError` if there is nothing to simulate.
    """
    problem, factor = solution.problem, 1
    functionals = functionals_of(problem.expressions)
    if not functionals:
        raise ProblemError(
            "validate: this problem contains no functional of an output, so there is nothing to simulate."
        )
    if problem.system.has_time:
        factor = _FINER
        problem = problem.on_grid(problem.grid.finer(factor))
    batch = SIMULATE_BATCH(
        numbers_to_arrays(problem), jnp.zeros((1, 0)), jnp.asarray(solution.vector), jnp.asarray(1), 1
    )
    refuse_broken(problem, np.asarray(batch.finite), np.zeros((1, 0)), solution.vector)
    sampled, told = {}, []
    for i, one in enumerate(functionals):
        text = one.text()
        fine = np.asarray(batch.scalars[i][0]) if i in batch.scalars else np.asarray(batch.paths[i].mean)[::factor]
        expected = np.asarray(solution.moments[text].mean)
        zero = np.zeros(np.shape(expected))
        sampled[text] = Sampled(text, fine, zero, zero, None, expected, zero, zero)
        away = np.abs(fine - expected)
        where = int(np.argmax(away))
        if not away.flat[where] <= _RELATIVE * max(float(np.max(np.abs(expected))), HELD):
            when = None if not one.is_path else float(solution.instants[where // (away.size // len(solution.instants))])
            numbers = float(expected.flat[where]), float(fine.flat[where])
            told.append(Disagreement(text, *numbers, 0.0, when, "the design's own grid"))
    return Evidence(
        solution=solution,
        samples=1,
        seed=0,
        instants=None,
        functionals=sampled,
        statistics={},
        trajectories=(),
        seconds=time.perf_counter() - started,
        broken=broken_by(problem, np.asarray(batch.excess), tolerances(solution)),
        disagreements=tuple(told),
        alone=factor,
    )
