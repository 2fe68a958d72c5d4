"""Blocks: small functions of a few variables each, evaluated and differentiated many at once.

All that is nonlinear in a simultaneous program is a family of equal blocks: the rates at a mesh point of a realisation,
an output at an instant, a limit at an instant. A family is differentiated by `vmap` over its blocks, whatever their
number; which variables a block depends on is known by construction.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num

from aleator._core.arrays import Pytree

Block: TypeAlias = Callable[[Pytree, Pytree, Array, Array], Float[Array, " rows"]]
"""Of the data of the outer and of the inner index, of the shared and of the block's own variables."""


class Family(NamedTuple):
    """Blocks with two indices, such as realisation and mesh point.

    - `function`: gives the rows of one block;
    - `shared`: the variables that all blocks depend on; `own`: those of each block: their values, or their numbers;
    - `outer`, `inner`: data of each index: trees of arrays with that first axis.

    What depends on the outer data and the shared variables alone, such as a realised model, is computed once for all
    inner indices.
    """

    function: Block
    shared: Num[Array, " shared"]
    own: Num[Array, "outer inner own"]
    outer: Pytree = ()
    inner: Pytree = ()

    def mapped(self, operate: Callable[..., Any], *given: Array) -> Any:
        """`operate(block, shared, own, *given)` on every block: `given` has both axes of the family."""

        def one(outer: Pytree, inner: Pytree, own: Array, *each: Array) -> Any:
            return operate(lambda s, o: self.function(outer, inner, s, o), self.shared, own, *each)

        def row(outer: Pytree, own: Array, *each: Array) -> Any:
            return jax.vmap(lambda inner, o, *rest: one(outer, inner, o, *rest))(self.inner, own, *each)

        return jax.vmap(row)(self.outer, self.own, *given)

    @property
    def row_count(self) -> int:
        """How many rows a block has. The variables may be their numbers: nothing is computed."""

        def of_one(tree: Any) -> Any:
            return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), tree)

        shared, own = (jax.ShapeDtypeStruct((size,), float) for size in (self.shared.size, self.own.shape[2]))
        return jax.eval_shape(self.function, of_one(self.outer), of_one(self.inner), shared, own).size

    def differentiated(
        self,
    ) -> tuple[Float[Array, "outer inner rows"], Float[Array, "outer inner rows columns"]]:
        """The rows of every block and their derivatives by its shared variables, then by its own."""
        return self.mapped(_differentiated)

    def curved(self, weights: Float[Array, "outer inner rows"]) -> Float[Array, "outer inner lower"]:
        """The second derivatives of every block's weighted sum of rows: the lower triangle, row by row."""
        return self.mapped(_curved, weights)


def _differentiated(block: Callable[..., Array], shared: Array, own: Array) -> tuple[Array, Array]:
    values, along = jax.linearize(block, shared, own)
    by_shared = jax.vmap(lambda s: along(s, jnp.zeros_like(own)), out_axes=-1)(jnp.eye(shared.size))
    if not own.size:
        return values, by_shared
    by_own = jax.vmap(lambda o: along(jnp.zeros_like(shared), o), out_axes=-1)(jnp.eye(own.size))
    return values, jnp.concatenate([by_shared, by_own], axis=-1) if shared.size else by_own


def _curved(block: Callable[..., Array], shared: Array, own: Array, weights: Array) -> Array:
    slopes = jax.grad(lambda s, o: weights @ block(s, o), argnums=(0, 1))
    bends = jax.jacfwd(lambda s, o: jnp.concatenate(slopes(s, o)), argnums=(0, 1))(shared, own)
    whole = jnp.concatenate(bends, axis=1)
    return whole[np.tril_indices(shared.size + own.size)]
