"""Systems without states: their outputs follow from what is known at one instant alone."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree
from aleator.dynamics._grid import Grid
from aleator.dynamics._integrators import History, Inputs, Observe, sampled
from aleator.dynamics._system import System, initial_state


class Known(NamedTuple):
    """What is known at each instant, as one row of numbers: the time, and all inputs side by side.

    - `rows`: shape (instants, numbers); `inputs`: the shape of each input by name, in order.
    """

    rows: Float[Array, "instants numbers"]
    inputs: Mapping[str, tuple[int, ...]]

    def unpack(self, row: Float[Array, " numbers"]) -> tuple[Array, dict[str, Array]]:
        """The time and the inputs of one row."""
        found, start = {}, 1
        for name, shape in self.inputs.items():
            size = math.prod(shape)
            found[name] = row[start : start + size].reshape(shape)
            start += size
        return row[0], found


def known_at(system: System, grid: Grid, inputs: Inputs) -> Known:
    """What a realised system and its inputs make known at each instant of a grid."""
    at = sampled({**system.signals(), **inputs}, grid, grid.fractions)
    columns = [values.reshape(len(values), -1) for values in at.values()]
    rows = jnp.concatenate([grid.times[:, None], *columns], axis=1)
    return Known(rows, {name: values.shape[1:] for name, values in at.items()})


def observed_at(system: System, known: Known, row: Float[Array, " numbers"], observe: Observe) -> dict[str, Array]:
    """What `observe` takes of a system without states at one row of what is known."""
    t, now = known.unpack(row)
    return observe(system, t, initial_state(system), now)


def observed(system: System, grid: Grid, inputs: Inputs, observe: Observe) -> History:
    """What `observe` takes of a system without states at every instant."""
    known = known_at(system, grid, inputs)
    return at_each_instant(lambda one, row: observed_at(one, known, row, observe), system, known.rows)


def at_each_instant(
    function: Callable[[Any, Array], Pytree], parameters: Pytree, known: Float[Array, "instants numbers"]
) -> Pytree:
    """`function(parameters, row)` at every instant: arrays with a leading axis of instants.

    However many decisions move the numbers of an instant, what they can do there is said by the derivatives by these
    few numbers. They are taken once, and multiplied with the change of the numbers: the chain rule in the order that is
    cheap for many decisions.
    """
    numbers, rest = eqx.partition(parameters, eqx.is_inexact_array)

    def one(given: Pytree, row: Array) -> Pytree:
        return function(eqx.combine(given, rest), row)

    every = jax.vmap(one, in_axes=(None, 0))

    @jax.custom_jvp
    def evaluated(given: Pytree, rows: Array) -> Pytree:
        return every(given, rows)

    def tangent(primals: tuple[Pytree, Array], tangents: tuple[Pytree, Any]) -> tuple[Pytree, Pytree]:
        given, rows = primals
        given_dot, rows_dot = tangents
        values = every(given, rows)
        slopes = jax.vmap(jax.jacfwd(one, argnums=1), in_axes=(None, 0))(given, rows)
        moved = jnp.zeros_like(rows) if _is_zero(rows_dot) else rows_dot
        change = jax.tree.map(lambda slope: jnp.einsum("t...k,tk->t...", slope, moved), slopes)
        if any(not _is_zero(leaf) for leaf in jax.tree.leaves(given_dot, is_leaf=_is_zero)):
            along = jax.tree.map(_materialised, given, given_dot)
            direct = jax.jvp(lambda where: every(where, rows), (given,), (along,))[1]
            change = jax.tree.map(jnp.add, change, direct)
        return values, change

    evaluated.defjvp(tangent, symbolic_zeros=True)
    return evaluated(numbers, known)


def _is_zero(leaf: Any) -> bool:
    return isinstance(leaf, SymbolicZero)


def _materialised(primal: Array, tangent: Any) -> Array:
    return jnp.zeros_like(primal) if _is_zero(tangent) else tangent
