"""One batch of Monte Carlo: simulate fresh systems and reduce them to what evidence needs."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from aleator._core.compilation import Compiled
from aleator.design import (
    AbstractScope,
    Constraint,
    OneSystem,
    Problem,
    functionals_of,
    is_over_time,
    responses,
    step_at,
)
from aleator.ensemble import few_at_once
from aleator.uncertainty import named_numbers


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
