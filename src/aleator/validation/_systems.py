"""Systems of a design, simulated batch by batch and reduced to what evidence needs.

Large batches of long histories are folded: at each instant the systems of a batch are summed at once, so that what is
left of a path are its moments, and of a limit over time the largest excess so far. None is stored, since memory is
where such batches spend their time.
"""

from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.compilation import Compiled
from aleator._core.errors import ProblemError, SimulationError
from aleator.design import (
    AbstractFunctional,
    AbstractIntegral,
    AbstractScope,
    Constraint,
    OneSystem,
    Path,
    Problem,
    Statistic,
    Taken,
    Value,
    first_broken,
    functionals_of,
    grid_at,
    history,
    is_over_time,
    numbers_of,
    refuse_changed_code,
    responses,
    step_at,
    uncertain,
    unsolved,
)
from aleator.dynamics import Asked
from aleator.ensemble import few_at_once, inputs_at, listed
from aleator.solution import Solution
from aleator.uncertainty import named_numbers, realise
from aleator.validation._limits import finer_by, is_counted, sampled_by


class Batch(NamedTuple):
    """The results of one batch of systems.

    - `scalars`: by functional (those that are numbers), shape (systems,);
    - `paths`: by functional (those that are paths), the mean and the sums of the second, third and fourth powers of
      deviations from it, each of shape (instants,);
    - `excess`: by constraint, the largest excess over its bounds, shape (constraints, systems);
    - `values`: by path constraint, its expression, shape (systems, instants);
    - `finite`: whether every functional of a system is finite, shape (systems,).
    """

    scalars: dict[int, Float[Array, " systems"]]
    paths: dict[int, tuple[Float[Array, "..."], ...]]
    excess: Float[Array, "constraints systems"]
    values: dict[int, Float[Array, "systems ..."]]
    finite: Bool[Array, " systems"]


def _simulate_batch(
    problem: Problem,
    germ: Float[Array, "systems variables"],
    decisions: Float[Array, " n"],
    count: Int[Array, ""],
    finer: int,
) -> Batch:
    """Simulate one system per germ point. Those after the first `count` are padding and do not count.

    Of paths, every `finer`th instant is kept, where the grid is that many times finer than the design's.
    """
    functionals = functionals_of(problem.expressions)
    samples = responses(problem, functionals, germ, decisions)
    numbers = named_numbers(problem.simulation, decisions)
    step = step_at(problem, decisions)

    def judge(values: tuple[Array, ...]) -> tuple[list[Array], dict[int, Array]]:
        scope = OneSystem(dict(zip(functionals, values, strict=True)), numbers, step)
        both = [judged(constraint, scope) for constraint in problem.constraints]
        paths = {i: value[::finer] for i, (_, value) in enumerate(both) if problem.constraints[i].is_path}
        return [excess for excess, _ in both], paths

    excess, values = jax.vmap(judge)(samples)
    systems = len(germ)
    wanted = jnp.arange(systems) < count

    paths = {i: _sums(one[:, ::finer], wanted) for i, one in enumerate(samples) if one.ndim > 1}
    finite = [jnp.isfinite(one).reshape(systems, -1).all(axis=1) for one in samples]
    return Batch(
        scalars={i: one for i, one in enumerate(samples) if one.ndim == 1},
        paths=paths,
        excess=jnp.stack(excess) if excess else jnp.zeros((0, systems)),
        values=values,
        finite=jnp.stack([jnp.ones(systems, bool), *finite]).all(axis=0),
    )


def _sums(
    values: Float[Array, "systems *shape"], wanted: Bool[Array, " systems"]
) -> tuple[Float[Array, "*shape"], ...]:
    """Over the `wanted` systems, the mean and the sums of the second, third and fourth powers of deviations."""
    counted = wanted.reshape(len(wanted), *(1,) * (values.ndim - 1))
    mean = jnp.sum(jnp.where(counted, values, 0.0), axis=0) / jnp.sum(wanted)
    away = jnp.where(counted, values - mean[None], 0.0)
    square = away**2

    def added(one: tuple[Array, ...], other: tuple[Array, ...]) -> tuple[Array, ...]:
        return tuple(a + b for a, b in zip(one, other, strict=True))

    # One pass over all values; three separate sums would each read and raise them to powers again.
    zeros = (jnp.zeros((), values.dtype),) * 3
    return mean, *jax.lax.reduce((square, square * away, square**2), zeros, added, (0,))


def judged(constraint: Constraint, scope: AbstractScope) -> tuple[Array, Array]:
    """One system's largest excess over a constraint's bounds, and the constraint's expression."""
    value = jnp.asarray(constraint.expression.evaluate(scope))
    excess = jnp.max(jnp.maximum(value - constraint.upper, constraint.lower - value))
    return excess, value


def _excess_over_time(
    problem: Problem, germ: Float[Array, "systems variables"], decisions: Float[Array, " n"]
) -> Float[Array, "limits systems"]:
    """Each system's largest excess over each limit over time.

    A few systems at a time, so that a fine grid needs no more memory than a coarse one for all.
    """
    limits = tuple(one for one in problem.constraints if is_over_time(one))
    functionals = functionals_of(tuple(one.expression for one in limits))
    numbers = named_numbers(problem.simulation, decisions)
    step = step_at(problem, decisions)

    def judge(point: Float[Array, " variables"]) -> Float[Array, " limits"]:
        values = responses(problem, functionals, point[None], decisions)
        scope = OneSystem({one: value[0] for one, value in zip(functionals, values, strict=True)}, numbers, step)
        return jnp.stack([judged(limit, scope)[0] for limit in limits])

    return few_at_once(judge, germ).T


SIMULATE_BATCH = Compiled(_simulate_batch)
EXCESS_OVER_TIME = Compiled(_excess_over_time)

# The name of the axis over which batches are summed.
_SYSTEMS = "systems"


def folds(problem: Problem) -> bool:
    """Whether all that evidence needs of a problem's histories can be told instant by instant.

    That is so for integrals, and for sums of statistics of paths and of the model's numbers.
    """
    functionals = functionals_of(problem.expressions)
    known = all(isinstance(one, AbstractIntegral | Path) for one in functionals)
    over_time = [one for one in problem.constraints if one.is_path]
    return known and problem.simulation.folds and all(map(_is_pointwise, over_time))


def _is_pointwise(constraint: Constraint) -> bool:
    return all(
        isinstance(atom, Value)
        or (isinstance(atom, Statistic) and all(isinstance(one, Path) for one in atom.functionals))
        for atom in constraint.expression.atoms
    )


def _simulate_folded(
    problem: Problem,
    germ: Float[Array, "systems variables"],
    decisions: Float[Array, " n"],
    count: Int[Array, ""],
    finer: int,
) -> Batch:
    """The same as `_simulate_batch` for a problem that `folds`, without the values of path constraints."""
    functionals = functionals_of(problem.expressions)
    integrals = tuple(one for one in functionals if isinstance(one, AbstractIntegral))
    paths = tuple(one for one in functionals if isinstance(one, Path))
    numbers, step = named_numbers(problem.simulation, decisions), step_at(problem, decisions)
    limits = [one for one in problem.constraints if one.is_path]
    others = [one for one in problem.constraints if not one.is_path]

    def simulated(point: Float[Array, " variables"], is_wanted: Bool[Array, ""]) -> Any:
        def fold(carried: Any, found: dict[str, Array]) -> tuple[Any, Any]:
            values: dict[AbstractFunctional, Array] = {one: found[one.output] for one in paths}
            scope = OneSystem(values, numbers, step)
            excess = [judged(one, scope)[0] for one in limits]
            # Zero unless some number is not finite, from when on it stays NaN.
            spoilt = sum((jnp.sum(0.0 * one) for one in values.values()), start=jnp.zeros(()))
            if carried is not None:
                excess = [jnp.maximum(before, now) for before, now in zip(carried[0], excess, strict=True)]
                spoilt = spoilt + carried[1]
            moments = {one.text(): _moments(value, is_wanted, count) for one, value in values.items()}
            return (excess, spoilt), moments

        asked = Asked(
            instants=frozenset(one.output for one in paths),
            integrands=tuple(one.integrand for one in integrals),
            integrated=frozenset(name for one in integrals for name in one.outputs),
            fold=fold,
        )
        realised = realise(problem.simulation, point, decisions)
        record = realised.record(asked)
        totals = numbers_of(integrals, Taken({}, dict(zip(integrals, record.integrals, strict=True))), realised.grid)
        scope = OneSystem(dict(zip(integrals, totals, strict=True)), numbers, step)
        excess, spoilt = record.folded
        at_end = [judged(one, scope)[0] for one in others]
        is_finite = jnp.isfinite(jnp.stack([spoilt, *(jnp.sum(0.0 * one) for one in totals)])).all()
        return (totals, excess, at_end, is_finite), record.history

    wanted = jnp.arange(len(germ)) < count
    own, moments = jax.vmap(simulated, axis_name=_SYSTEMS, out_axes=(0, None))(germ, wanted)
    totals, over_time, at_end, finite = own
    rows = {id(one): row for one, row in zip([*limits, *others], [*over_time, *at_end], strict=True)}
    excess = [rows[id(one)] for one in problem.constraints]
    places = {one: i for i, one in enumerate(functionals)}
    return Batch(
        scalars={places[one]: total for one, total in zip(integrals, totals, strict=True)},
        paths={places[one]: tuple(part[::finer] for part in moments[one.text()]) for one in paths},
        excess=jnp.stack(excess) if excess else jnp.zeros((0, len(germ))),
        values={},
        finite=finite,
    )


def _moments(value: Array, is_wanted: Bool[Array, ""], count: Int[Array, ""]) -> tuple[Array, ...]:
    """Over the wanted systems of a batch, the mean and the sums of the powers 2 to 4 of deviations from it."""
    mean = _over_systems(jnp.where(is_wanted, value, 0.0)) / count
    away = jnp.where(is_wanted, value - mean, 0.0)
    square = away**2
    return mean, _over_systems(square), _over_systems(square * away), _over_systems(square**2)


def _over_systems(value: Array) -> Array:
    return jax.lax.psum(value, _SYSTEMS)


SIMULATE_FOLDED = Compiled(_simulate_folded)


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
        return result._replace(excess=jax_array(excess))


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
