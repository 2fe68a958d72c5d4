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
from typing import Any

import numpy as np

from aleator._core.arrays import NUMBER, refuse_beyond_memory
from aleator._core.border import Progress, check_progress, one_of, silent, whole
from aleator._core.errors import ExpansionWarning
from aleator._core.executors import check_executor, each_of
from aleator._core.journalled import journalled, part_by_part, parts_so_far
from aleator._core.parallel import working
from aleator.design import functionals_of, refuse_large_histories, refuse_other_code
from aleator.ensemble import drawn_from, each
from aleator.solution import Solution
from aleator.validation._batches import Batch
from aleator.validation._evidence import Evidence
from aleator.validation._systems import Systems
from aleator.validation._tally import evidence_of


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

    Where numbers are intervals (see `Interval`), which have no probability, so many systems are simulated at each of
    `Solution.over_intervals`: the scenarios of the design, corners of the box and points inside. Proportions are then
    the largest of these.

    Issues an `ExpansionWarning` where samples and solution disagree. Raises `ProblemError` if there is nothing to
    simulate or if the results would not fit into memory, and `SimulationError` if a system's results are not finite,
    naming its parameter values.
    """
    one_of("validate", solution, Solution, "that of al.solve")
    least = {"samples": (samples, 2), "batch": (batch, 1), "seed": (seed, 0), "keep": (keep, 0)}
    samples, batch, seed, keep = (whole(f"validate: {name}", one, least=n) for name, (one, n) in least.items())
    check_executor("validate", executor)
    check_progress("validate", progress)
    if solution.over_intervals:
        how = {"seed": seed, "batch": batch, "keep": keep, "executor": executor, "progress": progress}
        every = tuple(validate(one, samples, **how) for one in solution.over_intervals)
        worst = max(every, key=lambda one: one.joint.count if one.broken else 0)
        disagreements = tuple(itertools.chain.from_iterable(one.disagreements for one in every))
        return replace(worst, solution=solution, disagreements=disagreements, over_intervals=every)

    def sampled() -> Evidence:
        started = time.perf_counter()
        systems, before = Systems(solution, "validate"), samples
        if not systems.germs:
            only = systems.simulate(np.zeros((1, 0)), 1)
            return evidence_of(solution, systems, only, 0, time.perf_counter() - started)
        size = min(batch, samples)
        _refuse_large(systems, samples, size)
        if systems.folds and samples * (systems.sampled.grid.steps + 1) >= _MANY:
            # Trajectories are kept of the first systems, so these are not folded.
            before = min(-(-keep // size) * size, samples)
        own = {"seed": seed, "keep": keep, "before": before}

        def work(some: Sequence[range]) -> Iterator[tuple[range, Batch]]:
            if executor is None:
                return simulated(systems, some, **own)
            return each_of(executor, _simulated_there, some, {"solution": solution, **own}, "validate")

        batches: list[Batch] = []
        progress("Monte Carlo", 0, samples)
        for stretch, found in part_by_part(stretches(samples, size, before), work, parts_so_far()):
            batches.append(found)
            progress("Monte Carlo", stretch.stop, samples)
        return evidence_of(solution, systems, Batch.joined(batches), seed, time.perf_counter() - started)

    given = validated_from(solution, samples, seed=seed, batch=batch, keep=keep)
    evidence = journalled("validate", given, sampled)
    if not evidence.agrees:
        warnings.warn(f"validate: {evidence.alarm()}", ExpansionWarning, stacklevel=2)
    # What a journal has read belongs to nobody else: a copy would be another result to it.
    object.__setattr__(evidence, "solution", solution)
    return evidence


def validated_from(
    solution: Solution, samples: int = 100_000, seed: int = 0, batch: int = 250, keep: int = 200
) -> dict[str, Any]:
    """All that the evidence of `validate` follows from, by name, for the same arguments."""
    return {"solution": solution, "how": (samples, seed, batch, keep)}


def _simulated_there(solution: Solution, seed: int, keep: int, before: int, items: Sequence[range]) -> list[Batch]:
    refuse_other_code(solution.problem)
    return [found for _, found in simulated(Systems(solution, "validate"), items, seed, keep, before)]


def _refuse_large(systems: Systems, samples: int, batch: int) -> None:
    """Refuse a run that would not fit into memory: a number per limit and functional of all systems, or one batch."""
    problem = systems.problem
    columns = 2 * len(problem.constraints) + len(functionals_of(problem.expressions))
    what = f"validate: {columns} numbers of each of {samples} systems"
    refuse_beyond_memory(what, NUMBER * columns * samples, "Ask for fewer samples.")
    refuse_large_histories(systems.sampled, working() * batch, 0, "Take a smaller batch.")


# Stretches of a sample at most: a millisecond each is spent on beginning one elsewhere, and as much on keeping one.
_MOST = 128
# Systems times instants from which a second compilation, of a program without histories, is worth while.
_MANY = 3e7
# Without histories more systems are simulated at a time, because each step of a loop has a cost of its own.
_TOGETHER = 8


def stretches(samples: int, batch: int, before: int) -> tuple[range, ...]:
    """A sample in stretches, the same wherever they are simulated: the numbers of their systems, in steps of a batch.

    All systems but those `before` are folded.
    """
    together = min(_TOGETHER * batch, max(samples - before, 1))
    return tuple(
        range(first, min(first + length, end), size)
        for begin, end, size in ((0, before, batch), (before, samples, together))
        for length in [size * max(-(-samples // (_MOST * size)), 1)]
        for first in range(begin, end, length)
    )


def simulated(
    systems: Systems, some: Sequence[range], seed: int, keep: int, before: int
) -> Iterator[tuple[range, Batch]]:
    """What each of some stretches gives, in order, on all cores; values of path constraints for the first `keep`.

    Raises `SimulationError` if a system's results are not finite, naming its parameter values.
    """
    for size, is_folded in {(one.step, one.start >= before) for one in some}:
        systems.prepare(size, is_folded=is_folded)

    def batch_of(item: tuple[range, int]) -> Batch:
        stretch, first = item
        points = drawn_from(systems.germs, seed, first, min(stretch.step, stretch.stop - first))
        return systems.simulate(points, stretch.step, max(keep - first, 0), is_folded=first >= before)

    batches = each(batch_of, [(stretch, first) for stretch in some for first in stretch])
    for one in some:
        yield one, Batch.joined([done for _, done in itertools.islice(batches, len(one))])
