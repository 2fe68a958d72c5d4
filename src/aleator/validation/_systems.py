"""Systems of a design, simulated batch by batch for evidence."""

from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.errors import ProblemError, SimulationError
from aleator.design import Problem, functionals_of, is_over_time, refuse_changed, uncertain, unsolved
from aleator.ensemble import inputs_at, listed
from aleator.solution import Solution
from aleator.validation._counted import finer_by, is_counted, sampled_by
from aleator.validation._sampling import EXCESS_OVER_TIME, SIMULATE_BATCH, Batch


@final
class Systems:
    """The uncertain systems of a solution, at its decisions: one for each germ point of a batch.

    - `problem`: the problem with its distributions restored; `germs`: their variables;
    - `sampled`: the problem on the grid for simulations, whose error is an order of magnitude below the tolerance.

    Raises `ProblemError`, in the name of the caller `who`, where nothing is uncertain or nothing can be sampled, and
    where the code of the system has changed since the design was solved.
    """

    def __init__(self, solution: Solution, who: str):
        refuse_changed(who, solution.problem, "when the design was solved")
        self.problem = uncertain(solution.problem)
        self.germs = tuple(self.problem.placements.germs.values())
        if not self.germs:
            raise ProblemError(f"{who}: nothing in this problem is uncertain, so there is nothing to sample.")
        if not functionals_of(self.problem.expressions):
            raise ProblemError(
                f"{who}: this problem contains no functional of an output, so there is nothing to sample."
            )
        self._vector = solution.vector
        self._decisions, self._factor = jnp.asarray(solution.vector), sampled_by(solution)
        self.sampled = _on_finer(self.problem, self._factor)
        self._traced = numbers_to_arrays(self.sampled)
        counted = finer_by(solution)
        self._finer = None if counted == self._factor else _for_limits(self.problem, counted)

    def prepare(self, batch: int) -> None:
        """Start compiling for batches of `batch` systems. The user's code is traced here, by one thread alone."""
        germ = jnp.zeros((batch, len(self.germs)))
        SIMULATE_BATCH.prepare(self._traced, germ, self._decisions, jnp.asarray(batch), self._factor)
        if self._finer is not None:
            EXCESS_OVER_TIME.prepare(self._finer, germ, self._decisions)

    def simulate(self, germ: Float[np.ndarray, "systems variables"], count: int) -> Batch:
        """Simulate the systems at some germ points. Those after the first `count` are padding and do not count.

        Raises `SimulationError` if a system's results are not finite, naming its parameter values.
        """
        result = SIMULATE_BATCH(self._traced, jnp.asarray(germ), self._decisions, jnp.asarray(count), self._factor)
        if self._finer is not None:
            beyond = EXCESS_OVER_TIME(self._finer, jnp.asarray(germ), self._decisions)
            result = _with_limits(self.problem, result, beyond)
        _refuse_broken(self.problem, result, germ[:count], self._vector)
        return result


def _on_finer(problem: Problem, factor: int) -> Problem:
    """The problem on a grid `factor` times finer, where time plays a part."""
    return problem if factor == 1 else problem.on_grid(problem.grid.finer(factor))


def _for_limits(problem: Problem, factor: int) -> Problem | None:
    """The problem on a grid `factor` times finer; None where no limit over time is counted there."""
    limits = any(is_over_time(one) and is_counted(one) for one in problem.constraints)
    return numbers_to_arrays(_on_finer(problem, factor)) if limits else None


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
    where = listed(inputs_at(problem.placements, point, jnp.asarray(decisions)))
    remedy = "Shorten the time step, use an implicit integrator (al.integrators.Kvaerno5), or bound the distributions."
    raise SimulationError(
        f"Monte Carlo: the simulation of the system with {where} is not finite. "
        f"{unsolved(problem, point, jnp.asarray(decisions)) or remedy}"
    )
