"""One batch of Monte Carlo whose histories are reduced while they are simulated: none is stored.

Memory is where large batches of long histories spend their time. At each instant the systems of a batch are summed at
once, so that what is left of a path are its moments, and of a limit over time the largest excess so far.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from aleator._core.compilation import Compiled
from aleator.design import (
    AbstractFunctional,
    AbstractIntegral,
    Constraint,
    OneSystem,
    Path,
    Problem,
    Statistic,
    Taken,
    Value,
    functionals_of,
    numbers_of,
    step_at,
)
from aleator.dynamics import Asked
from aleator.uncertainty import named_numbers, realise
from aleator.validation._sampling import Batch, judged

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
