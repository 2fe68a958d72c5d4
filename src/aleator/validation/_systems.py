"""`Systems`: the uncertain systems of a design, simulated batch by batch, and the grids on which that is done."""

from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.errors import ProblemError, SimulationError
from aleator.design import (
    Problem,
    as_expression,
    first_broken,
    functionals_of,
    history,
    instants_at,
    is_over_time,
    responses,
    uncertain,
    unsolved,
)
from aleator.ensemble import fill, inputs_at, listed
from aleator.nlp import HELD
from aleator.solution import Solution
from aleator.uncertainty import refuse_intervals
from aleator.validation._batches import SIMULATE, Batch, folds
from aleator.validation._shares import is_counted

# A grid whose error is this part of the tolerance is as good as exact.
_AN_ORDER_BELOW = 0.1
# Where nothing is uncertain, the one system is simulated on so many times as many steps.
_ALONE = 10
# So many systems at a time are simulated on the grid for limits over time, those nearest to a limit first, until the
# others are further from it than so many times the largest difference that the finer grid has made.
_FEW, _FAR = 50, 10


def _factors(solution: Solution) -> tuple[int, int]:
    """The refinement factors, relative to a solution's own grid, of the grids for sampling systems, and for counting
    them against limits over time.

    The first is 1 if the error of its own grid is an order of magnitude below the tolerance; otherwise that of the grid
    used to estimate it. The second is that of the grid on which limits were held between instants, if they were;
    otherwise the first.
    """
    error, between = solution.certificate.grid_error, solution.certificate.between
    sampled = 1 if error is None or error.ratio <= _AN_ORDER_BELOW else error.factor
    return sampled, between.factor if between is not None and between.is_strict else sampled


@final
class Systems:
    """The uncertain systems of a solution, at its decisions: one for each germ point of a batch.

    - `problem`: the problem with its distributions restored; `germs`: their variables;
    - `factor`: how many times as many steps as the design's grid has that for simulations (see `al.validate`), on which
      `sampled` is the problem; `counted`: the same of the grid on which the limits `over_time` are counted. Where it is
      finer, systems are simulated on it too that are so near to a limit that the grids may disagree about them;
    - `folds`: whether systems can be simulated without storing histories.

    Raises `ProblemError`, in the name of the caller `who`, where there is nothing to simulate.
    """

    def __init__(self, solution: Solution, who: str):
        self.problem = uncertain(solution.problem)
        remedy = "Ask this of the design at single values of the intervals, solution.over_intervals."
        refuse_intervals(who, self.problem.placements, remedy)
        self.germs = tuple(self.problem.placements.germs.values())
        if not functionals_of(self.problem.expressions):
            raise ProblemError(
                f"{who}: this problem contains no functional of an output, so there is nothing to simulate."
            )
        self._decisions = jax_array(solution.vector)
        # So that rounding does not break a limit.
        self._tolerances = np.array([HELD * one.scale for one in solution.constraints]).reshape(-1, 1)
        self.factor, self.counted = _factors(solution)
        if not self.germs:
            self.factor = self.counted = _ALONE if self.problem.system.has_time else 1
        self.sampled = _on_finer(self.problem, self.factor)
        self.folds = folds(self.sampled)
        limits = self.problem.constraints
        self.over_time = [i for i, one in enumerate(limits) if is_over_time(one) and is_counted(self.problem, one)]
        self._finer = None
        if self.over_time and self.counted != self.factor:
            alone = as_expression(0.0), tuple(limits[i] for i in self.over_time)
            problem = eqx.tree_at(lambda one: (one.objective, one.constraints), self.problem, alone)
            self._finer = _on_finer(problem, self.counted)
        self._folds_finer = self._finer is not None and folds(self._finer)

    def prepare(self, batch: int, *, is_folded: bool = False) -> None:
        """Start compiling for batches of `batch` systems. The user's code is traced here, by one thread alone."""
        finer = self._finer, _FEW, 1, self._folds_finer
        for problem, size, *how in ((self.sampled, batch, self.factor, is_folded), finer):
            if problem is not None:
                germ = jax_array(np.zeros((size, len(self.germs))))
                SIMULATE.prepare(problem, germ, self._decisions, jax_array(size), *how)

    def simulate(
        self, germ: Float[np.ndarray, "systems variables"], batch: int, keep: int = 0, *, is_folded: bool = False
    ) -> Batch:
        """Simulate the systems at some germ points, at most as many as the `batch` that was prepared for.

        Excess over a limit is that beyond its tolerance. Values of path constraints are those of the first `keep`
        systems; there are none where they are folded.

        Raises `SimulationError` if a system's results are not finite, naming its parameter values.
        """
        found = self._simulated(self.sampled, germ, batch, keep, self.factor, is_folded)
        excess = found.excess - self._tolerances
        if self._finer is None:
            return found._replace(excess=excess)
        rows, apart, done = np.array(self.over_time), 0.0, 0
        sizes = self._tolerances[rows]
        distances = np.min(np.abs(excess[rows]) / sizes, axis=0)
        nearest = np.argsort(distances, kind="stable")
        while done < len(germ) and (not done or distances[nearest[done]] <= _FAR * apart):
            some = nearest[done : done + _FEW]
            beyond = self._simulated(self._finer, germ[some], _FEW, 0, 1, self._folds_finer).excess - sizes
            entries = rows[:, None], some
            apart = max(apart, float(np.max(np.abs(beyond - excess[entries]) / sizes)))
            excess[entries] = beyond
            done += _FEW
        return found._replace(excess=excess)

    def _simulated(
        self,
        problem: Problem,
        germ: Float[np.ndarray, "systems variables"],
        batch: int,
        keep: int = 0,
        factor: int = 1,
        is_folded: bool = False,
    ) -> Batch:
        count = len(germ)
        points = jax_array(fill(germ, batch))
        found, finite = SIMULATE(problem, points, self._decisions, jax_array(count), factor, is_folded)
        if not np.asarray(finite)[:count].all():
            failed = f"{np.sum(~np.asarray(finite)[:count])} of {count} systems fail"
            raise _not_finite(problem, jax_array(germ[np.argmin(np.asarray(finite))]), self._decisions, failed)
        return found.first(count, keep)


def _on_finer(problem: Problem, factor: int) -> Problem:
    """The problem on a grid `factor` times finer, with arrays in the place of numbers."""
    return numbers_to_arrays(problem if factor == 1 else problem.on_grid(problem.grid.finer(factor)))


def _not_finite(
    problem: Problem, point: Float[Array, " variables"], decisions: Float[Array, " n"], failed: str
) -> SimulationError:
    """The error for a system without a result: its numbers, and which output is not finite, and from when on."""
    numbers = listed(inputs_at(problem.placements, point, decisions))
    outputs = {name: np.asarray(values)[None] for name, values in history(problem, point, decisions).items()}
    what = ""
    if (broken := first_broken(outputs, problem.grid)) is not None:
        instant = instants_at(problem, np.asarray(decisions))[broken.instant]
        what = f": output '{broken.name}'" + (f" from t = {instant:.4g} s on" if problem.system.has_time else "")
    else:
        functionals = functionals_of(problem.expressions)
        values = zip(functionals, responses(problem, functionals, point[None], decisions), strict=True)
        # Alone, a system may be finite that is not in a batch.
        what = next((f": {one.text()}" for one, value in values if not np.isfinite(value).all()), "")
    steps = "Shorten the time step, use an implicit integrator (al.integrators.Rodas5P), or bound the distributions."
    remedy = steps if problem.system.has_time else "Bound the distributions."
    return SimulationError(
        f"Monte Carlo: the simulation of the system{numbers and ' with '}{numbers} is not finite{what}; {failed}. "
        f"{unsolved(problem, point, decisions) or remedy}"
    )
