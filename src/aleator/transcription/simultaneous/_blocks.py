"""Blocks: small functions of a few variables each, evaluated and differentiated many at once.

All that is nonlinear in a simultaneous program is a family of equal blocks: the rates at a mesh point of a realisation,
an output at an instant, a limit at an instant. A family is differentiated by `vmap` over its blocks, whatever their
number; which variables a block is given is known by construction, and which of them each row depends on by its
equations. So one tangent takes the derivatives by all variables of which no row sees two.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Float, Int, Num

from aleator._core.arrays import Pytree
from aleator._core.dependence import Dependence, dependence, interpreted
from aleator.dynamics import column_groups, seeds_of

Block: TypeAlias = Callable[[Pytree, Pytree, Array, Array], Float[Array, " rows"]]
"""Of the data of the outer and of the inner index, of the shared and of the block's own variables."""

# From so far away slopes of affine blocks are told to the last digit, whatever is added: a power of two.
_FAR = 2.0**60
# So many equations take less time by NumPy, one after the other, than a compiler takes for few.
_MOST = 20_000


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

    def mapped(self, operate: Callable[..., Any], *arrays: Array) -> Any:
        """`operate(block, shared, own, *arrays)` on every block: the arrays have both axes of the family."""

        def one(outer: Pytree, inner: Pytree, own: Array, *each: Array) -> Any:
            return operate(lambda s, o: self.function(outer, inner, s, o), self.shared, own, *each)

        def row(outer: Pytree, own: Any, *each: Array) -> Any:
            return jax.vmap(lambda inner, o, *rest: one(outer, inner, o, *rest))(self.inner, own, *each)

        return jax.vmap(row)(self.outer, self.own, *arrays)

    @property
    def width(self) -> int:
        """How many variables each block is given."""
        return self.shared.size + self.own.shape[2]

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
        rows, columns, pattern = self._places(entries)
        groups = column_groups(pattern)
        seeds = jnp.asarray(seeds_of(groups))
        values, slopes = self.mapped(lambda block, shared, own: _differentiated(block, shared, own, seeds))
        return values, slopes[..., rows, groups[columns]]

    def affine(
        self, equations: ClosedJaxpr, entries: Int[np.ndarray, " entries"]
    ) -> tuple[Float[np.ndarray, "outer inner rows"], Float[np.ndarray, "outer inner entries"]] | None:
        """The same of affine blocks, their rows where all variables are zero: nothing is compiled. None where that
        would take longer.

        - `equations`: those of one block.
        """
        rows, columns, pattern = self._places(entries)
        groups = column_groups(pattern)
        points = np.concatenate([np.zeros((1, pattern.shape[1])), _FAR * seeds_of(groups)[: entries.size]])
        _, needed = dce_jaxpr(equations.jaxpr, [True])
        data, is_needed = (self.outer, self.inner), iter(needed)
        # Blocks that need no data of an index are the same along it.
        each = zip(data, self.own.shape, strict=False)
        counts = [count if _is_given(one) and next(is_needed) else 1 for one, count in each]
        if math.prod(counts) * len(points) * len(equations.eqns) > _MOST:
            return None

        def rows_at(which: tuple[int, ...], point: np.ndarray) -> np.ndarray:
            own = [one[i] for one, i in zip(data, which, strict=True) if _is_given(one)]
            return interpreted(equations.jaxpr, equations.consts, [*own, *_apart(point, self.shared)])[0]

        values = np.array([[rows_at(which, one) for one in points] for which in np.ndindex(*counts)])
        values = values.reshape(*counts, *values.shape[1:])
        still, slopes = values[:, :, 0], (values[:, :, 1:] - values[:, :, :1]) / _FAR
        shape, slopes = self.own.shape[:2], slopes[:, :, groups[columns], rows]
        return np.broadcast_to(still, (*shape, still.shape[2])), np.broadcast_to(slopes, (*shape, entries.size))

    def curved(
        self, weights: Float[Array, "outer inner rows"], entries: Int[np.ndarray, " entries"]
    ) -> Float[Array, "outer inner entries"]:
        """Some of the second derivatives of every block's weighted sum of rows.

        - `entries`: which, row by row.
        """
        if not entries.size:  # What bends nowhere need not be traced.
            return jnp.zeros((*weights.shape[:2], 0))
        rows, columns, pattern = self._places(entries)
        groups = column_groups(pattern | pattern.T)
        seeds = jnp.asarray(seeds_of(groups))
        bends = self.mapped(lambda block, shared, own, each: _curved(block, shared, own, each, seeds), weights)
        return bends[..., rows, groups[columns]]

    def _places(self, entries: Int[np.ndarray, " entries"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The rows and columns of entries, and all of these as a table, at least as high as wide."""
        rows, columns = np.divmod(entries, max(self.width, 1))
        pattern = np.zeros((rows.max(initial=self.width - 1) + 1, self.width), dtype=bool)
        pattern[rows, columns] = True
        return rows, columns, pattern


def _is_given(data: Pytree) -> bool:
    return not isinstance(data, tuple)


def _apart(seed: Any, shared: Any) -> list[Any]:
    """A direction's parts along shared and own variables."""
    return [seed[: shared.size], seed[shared.size :]]


def _differentiated(block: Callable[..., Array], shared: Array, own: Array, seeds: Array) -> tuple[Array, Array]:
    values, along = jax.linearize(block, shared, own)
    return values, jax.vmap(lambda seed: along(*_apart(seed, shared)), out_axes=-1)(seeds)


def _curved(block: Callable[..., Array], shared: Array, own: Array, weights: Array, seeds: Array) -> Array:
    def weighted(shared: Array, own: Array) -> Array:
        return weights @ block(shared, own)

    def along(gradient: Callable[..., Any], seed: Array) -> Array:
        slopes = gradient(weighted, argnums=(0, 1))
        return jnp.concatenate(jax.jvp(slopes, (shared, own), tuple(_apart(seed, shared)))[1])

    try:
        return jax.vmap(lambda seed: along(jax.grad, seed), out_axes=-1)(seeds)
    except ValueError:
        # JAX takes no derivatives backward through loops that end when a condition holds.
        return jax.vmap(lambda seed: along(jax.jacfwd, seed), out_axes=-1)(seeds)
