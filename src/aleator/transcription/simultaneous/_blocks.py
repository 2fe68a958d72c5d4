"""Blocks: small functions of a few variables each, evaluated and differentiated many at once.

All that is nonlinear in a simultaneous program is a family of equal blocks: the rates at a mesh point of a realisation,
an output at an instant, a limit at an instant. A family is differentiated by `vmap` over its blocks, whatever their
number; which variables a block is given is known by construction, and which of them each row depends on follows from
its equations.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Num

from aleator._core.arrays import Pytree
from aleator.transcription.simultaneous._dependence import Dependence, dependence

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
    shared: Num[Array | np.ndarray, " shared"]
    own: Num[Array | np.ndarray, "outer inner own"]
    outer: Pytree = ()
    inner: Pytree = ()

    def mapped(self, operate: Callable[..., Any], *given: Array) -> Any:
        """`operate(block, shared, own, *given)` on every block: `given` has both axes of the family."""

        def one(outer: Pytree, inner: Pytree, own: Array, *each: Array) -> Any:
            return operate(lambda s, o: self.function(outer, inner, s, o), self.shared, own, *each)

        def row(outer: Pytree, own: Any, *each: Array) -> Any:
            return jax.vmap(lambda inner, o, *rest: one(outer, inner, o, *rest))(self.inner, own, *each)

        return jax.vmap(row)(self.outer, self.own, *given)

    @property
    def dependence(self) -> Dependence:
        """How the rows of a block depend on its shared variables, then its own. Variables may be their numbers."""

        def of_one(tree: Any) -> Any:
            return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), tree)

        variables = [jax.ShapeDtypeStruct((size,), float) for size in (self.shared.size, self.own.shape[2])]
        return dependence(self.function, (of_one(self.outer), of_one(self.inner)), variables)

    def differentiated(
        self, entries: Int[np.ndarray, " entries"]
    ) -> tuple[Float[Array, "outer inner rows"], Float[Array, "outer inner entries"]]:
        """The rows of every block and some of their derivatives by its shared variables, then by its own.

        - `entries`: which, row by row.
        """
        values, slopes = self.mapped(_differentiated)
        return values, slopes.reshape(*slopes.shape[:2], -1)[..., entries]

    def curved(
        self, weights: Float[Array, "outer inner rows"], entries: Int[np.ndarray, " entries"]
    ) -> Float[Array, "outer inner entries"]:
        """Some of the second derivatives of every block's weighted sum of rows.

        - `entries`: which, row by row.
        """
        bends = self.mapped(_curved, weights)
        return bends.reshape(*bends.shape[:2], -1)[..., entries]


def _differentiated(block: Callable[..., Array], shared: Array, own: Array) -> tuple[Array, Array]:
    values, along = jax.linearize(block, shared, own)
    by_shared = jax.vmap(lambda s: along(s, jnp.zeros_like(own)), out_axes=-1)(jnp.eye(shared.size))
    if not own.size:
        return values, by_shared
    by_own = jax.vmap(lambda o: along(jnp.zeros_like(shared), o), out_axes=-1)(jnp.eye(own.size))
    return values, jnp.concatenate([by_shared, by_own], axis=-1) if shared.size else by_own


def _curved(block: Callable[..., Array], shared: Array, own: Array, weights: Array) -> Array:
    def weighted(shared: Array, own: Array) -> Array:
        return weights @ block(shared, own)

    try:
        return _second(weighted, jax.grad, shared, own)
    except ValueError:
        # JAX takes no derivatives backward through loops that end when a condition holds.
        return _second(weighted, jax.jacfwd, shared, own)


def _second(function: Callable[..., Array], gradient: Callable[..., Any], shared: Array, own: Array) -> Array:
    """The second derivatives of a number, of which `gradient` takes the first."""
    slopes = gradient(function, argnums=(0, 1))
    bends = jax.jacfwd(lambda s, o: jnp.concatenate(slopes(s, o)), argnums=(0, 1))(shared, own)
    return jnp.concatenate(bends, axis=1)
