"""`validate`: a design re-simulated on fresh random systems, independently of the expansion that found it."""

import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any, TypeAlias

import jax.numpy as jnp
import numpy as np

from aleator._core.arrays import NUMBER, numbers_to_arrays, refuse_beyond_memory
from aleator._core.border import Progress, check_progress, silent, whole
from aleator._core.errors import ExpansionWarning, ProblemError
from aleator._core.executors import check_executor, each_of
from aleator._core.journalled import journalled, part_by_part, parts_so_far
from aleator._core.parallel import working
from aleator.design import functionals_of, refuse_large_histories, refuse_other_code, uncertain
from aleator.nlp import HELD
from aleator.solution import Solution
from aleator.validation._batches import SIMULATE_BATCH, Batch
from aleator.validation._evidence import Evidence, Sampled
from aleator.validation._limits import Disagreement, tolerances
from aleator.validation._sample import Plan, Stretch, Systems, refuse_broken, simulated
from aleator.validation._tally import Tally, broken_by

_Simulate: TypeAlias = Callable[[Sequence[Stretch]], Iterator[tuple[Stretch, Batch]]]
"""What each of some stretches finds, in order."""


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
    if not isinstance(solution, Solution):
        raise ProblemError(f"validate: expected a Solution, from al.solve; received {type(solution).__name__}.")
    least = {"samples": (samples, 2), "batch": (batch, 1), "seed": (seed, 0), "keep": (keep, 0)}
    samples, batch, seed, keep = (whole(f"validate: {name}", one, least=n) for name, (one, n) in least.items())
    check_executor("validate", executor)
    check_progress("validate", progress)
    given = validated_from(solution, samples, seed=seed, batch=batch, keep=keep)
    evidence = journalled("validate", given, lambda: _sampled(solution, samples, seed, batch, keep, executor, progress))
    return _told(evidence if evidence.solution is solution else replace(evidence, solution=solution))


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
        return alone(solution, started)
    systems = Systems(solution, "validate")
    _refuse_large(systems, samples, min(batch, samples))
    plan = Plan.of(systems, samples, seed, batch, keep)
    batches: list[Batch] = []
    progress("Monte Carlo", 0, samples)
    for stretch, found in part_by_part(plan.stretches, _by(executor, solution, systems, plan), parts_so_far()):
        batches.append(found)
        progress("Monte Carlo", stretch.end, samples)
    tally = Tally(solution, systems.problem, Batch.joined(batches))
    return tally.evidence(seed, time.perf_counter() - started)


def _by(executor: Executor | None, solution: Solution, systems: Systems, plan: Plan) -> _Simulate:
    """How stretches are simulated: here, or by an executor."""
    if executor is None:
        return lambda stretches: simulated(systems, plan, stretches)
    given = {"solution": solution, "plan": plan}
    return lambda stretches: each_of(executor, _simulated_there, stretches, given, "validate")


def _simulated_there(solution: Solution, plan: Plan, items: Sequence[Stretch]) -> list[Batch]:
    refuse_other_code(solution.problem)
    return [found for _, found in simulated(Systems(solution, "validate"), plan, items)]


def _told(evidence: Evidence) -> Evidence:
    """Evidence, with a warning where it contradicts the solution."""
    if not evidence.agrees:
        warnings.warn(f"validate: {evidence.alarm()}", ExpansionWarning, stacklevel=3)
    return evidence


def _refuse_large(systems: Systems, samples: int, batch: int) -> None:
    """Refuse a run that would not fit into memory: a number per limit and functional of all systems, or one batch."""
    problem = systems.problem
    columns = 2 * len(problem.constraints) + len(functionals_of(problem.expressions))
    what = f"validate: {columns} numbers of each of {samples} systems"
    refuse_beyond_memory(what, NUMBER * columns * samples, "Ask for fewer samples.")
    refuse_large_histories(systems.sampled, working() * batch, 0, "Take a smaller batch.")


# Refinement factor of the grid.
_FINER = 10

# Relative differences up to this are ignored.
_RELATIVE = 1e-3


def alone(solution: Solution, started: float) -> Evidence:
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
        fine = np.asarray(batch.scalars[i][0]) if i in batch.scalars else np.asarray(batch.paths[i][0])[::factor]
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
