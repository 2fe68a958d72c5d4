"""Systems of a design, simulated batch by batch and reduced to what evidence needs.

Large batches of long histories are folded: at each instant the systems of a batch are summed at once, so that what is
left of a path are its moments, and of a limit over time the largest excess so far. None is stored, since memory is
where such batches spend their time.
"""

from collections.abc import Sequence
from functools import reduce
from typing import Any, NamedTuple, Self, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from aleator._core.compilation import Compiled
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
    functionals_of,
    is_over_time,
    numbers_of,
    responses,
    step_at,
)
from aleator.dynamics import Asked
from aleator.ensemble import few_at_once
from aleator.uncertainty import named_numbers, realise


@final
class Sums(NamedTuple):
    """The number of samples, their mean, and the sums of the powers 2 to 4 of deviations from it.

    Numbers, or arrays of one shape: of JAX in a program, of NumPy outside. They are merged as by Pébay (Formulas for
    robust, one-pass parallel computation, 2008).
    """

    number: Any
    mean: Any
    second: Any
    third: Any
    fourth: Any

    @classmethod
    def of(cls, values: Float[np.ndarray, "samples *shape"]) -> Self:
        """The sums of one batch."""
        mean = values.mean(axis=0)
        away = values - mean
        return cls(len(values), mean, *(np.sum(away**power, axis=0) for power in (2, 3, 4)))

    def merged(self, other: Self) -> Self:
        """The sums of both batches together."""
        (n, mean, second, third, fourth), (m, *_) = self, other
        total, shift = n + m, other.mean - mean
        return type(self)(
            total,
            mean + shift * m / total,
            second + other.second + shift**2 * n * m / total,
            third
            + other.third
            + shift**3 * n * m * (n - m) / total**2
            + 3 * shift * (n * other.second - m * second) / total,
            fourth
            + other.fourth
            + shift**4 * n * m * (n**2 - n * m + m**2) / total**3
            + 6 * shift**2 * (n**2 * other.second + m**2 * second) / total**2
            + 4 * shift * (n * other.third - m * third) / total,
        )

    @property
    def std(self) -> Float[np.ndarray, "*shape"]:
        """The standard deviation."""
        return np.asarray(np.sqrt(self.second / (self.number - 1)))

    @property
    def std_error(self) -> Float[np.ndarray, "*shape"]:
        """The standard error of the standard deviation, from the fourth moment; zero where nothing varies."""
        n, variance = self.number, self.second / (self.number - 1)
        spread = np.maximum(self.fourth / n - variance**2 * (n - 3) / (n - 1), 0.0) / n
        return np.asarray(np.sqrt(spread) / (2 * np.sqrt(np.where(variance > 0, variance, np.inf))))


class Batch(NamedTuple):
    """What some systems give: arrays of JAX, of one batch with padding, or of NumPy, of all systems of a stretch.

    - `scalars`: by functional (those that are numbers), shape (systems,); `paths`: by functional (those that are
      paths), their moments at each instant;
    - `excess`: by constraint, the largest excess over its bounds, shape (constraints, systems);
    - `values`: by path constraint, its expression, shape (systems, instants), of those systems of which it is kept;
    - `finite`: whether every functional of a system is finite, shape (systems,).
    """

    scalars: dict[int, Any]
    paths: dict[int, Sums]
    excess: Any
    values: dict[int, Any]
    finite: Any

    def first(self, count: int, keep: int) -> "Batch":
        """As arrays of NumPy, without the padding after `count` systems, and with values of the first `keep`."""
        return Batch(
            {i: np.asarray(values)[:count] for i, values in self.scalars.items()},
            {i: Sums(count, *map(np.asarray, sums[1:])) for i, sums in self.paths.items()},
            np.asarray(self.excess)[:, :count],
            {i: np.array(np.asarray(values)[:keep]) for i, values in self.values.items()} if keep else {},
            np.asarray(self.finite)[:count],
        )

    @classmethod
    def joined(cls, some: "Sequence[Batch]") -> "Batch":
        """Several, in the order of their systems. Moments are merged in that order, so that digits are the same."""
        head = some[0]
        return cls(
            {i: np.concatenate([one.scalars[i] for one in some]) for i in head.scalars},
            {i: reduce(Sums.merged, [one.paths[i] for one in some]) for i in head.paths},
            np.concatenate([one.excess for one in some], axis=1),
            {i: np.concatenate([one.values[i] for one in some if i in one.values]) for i in head.values},
            np.concatenate([one.finite for one in some]),
        )


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

    paths = {i: Sums(count, *_sums(one[:, ::finer], wanted)) for i, one in enumerate(samples) if one.ndim > 1}
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
        paths={places[one]: Sums(count, *(part[::finer] for part in moments[one.text()])) for one in paths},
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
