"""Ahead-of-time compilation, once per structure of the arguments, with its time on record."""

import math
import time
from collections import OrderedDict
from collections.abc import Callable
from itertools import accumulate, pairwise
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

# Enough for a session's problems; beyond, the one unused for longest is dropped, with the classes it holds.
_KEPT = 32
# On a CPU, XLA takes `jax.lax.optimization_barrier` away before it fuses loops, and then computes an intermediate
# result again wherever it is used: the sine of an angle for each derivative that it takes part in. With its pass of
# this name left out, barriers last.
_OPTIONS: dict[str, dict[str, str | bool]] = {"cpu": {"xla_disable_hlo_passes": "cse_barrier_expander"}}


@final
class Compiled:
    """A function compiled ahead of time: once for each structure of its arguments, whatever their numbers are.

    Arrays in the arguments (also deep inside a problem) are traced; all the rest is structure. `compilations` and
    `seconds` count what has been compiled so far.
    """

    def __init__(self, function: Callable[..., Any]):
        self._function = function
        self._executables: OrderedDict[Any, Callable[..., Any]] = OrderedDict()
        self.compilations = 0
        self.seconds = 0.0

    def __call__(self, *arguments: Any) -> Any:
        dynamic, static = eqx.partition(arguments, eqx.is_array)
        leaves, structure = jax.tree.flatten(dynamic)

        def flat(*leaves: jax.Array) -> Any:
            return self._function(*eqx.combine(jax.tree.unflatten(structure, leaves), static))

        return self._known("leaves", leaves, structure, static, lambda: self._compile(flat, *leaves))(*leaves)

    def bound(self, *fixed: Any) -> Callable[[Float[np.ndarray, " n"]], Any]:
        """The function with all arguments but the last fixed, for many calls that differ in that one: an array.

        At every call, each array that an executable is given or gives takes its time. So all real numbers of the fixed
        arguments travel as one vector, and so do those of the result: NumPy arrays, not to be written to.
        """
        reals, rest = eqx.partition(fixed, _is_real)
        vector, unpacked = ravel_pytree(reals)
        arrays, static = eqx.partition(rest, eqx.is_array)
        # Leaves in the place of trees, which would be taken apart at every call.
        others, structure = jax.tree.flatten(arrays)
        found: list[Callable[..., Any]] = []

        def result(vector: jax.Array, others: list[jax.Array], last: jax.Array) -> Any:
            return self._function(*eqx.combine(unpacked(vector), jax.tree.unflatten(structure, others), static), last)

        def call(last: Float[np.ndarray, " n"]) -> Any:
            given = vector, others, last
            if not found:
                parts = [*jax.tree.leaves(reals), *others, last], (jax.tree.structure(reals), structure), static
                found.append(self._known("packed", *parts, lambda: self._compile_packed(result, *given)))
            return found[0](*given)

        return call

    def _known(
        self, way: str, leaves: list[Any], structure: Any, static: Any, build: Callable[[], Callable[..., Any]]
    ) -> Callable[..., Any]:
        """What is called for arguments of this structure, built where none has been before."""
        static_leaves, static_structure = jax.tree.flatten(static)
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        kinds = tuple(type(leaf) for leaf in static_leaves)  # 1 and True are equal, but not the same structure
        key = (way, structure, static_structure, tuple(static_leaves), kinds, shapes)
        if key not in self._executables:
            self._executables[key] = build()
        self._executables.move_to_end(key)
        while len(self._executables) > _KEPT:
            self._executables.popitem(last=False)
        return self._executables[key]

    def _compile(self, function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
        start = time.perf_counter()
        options = _OPTIONS.get(jax.default_backend(), {})
        executable = jax.jit(function).lower(*arguments).compile(compiler_options=options)
        self.seconds += time.perf_counter() - start
        self.compilations += 1
        return executable

    def _compile_packed(self, function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
        layout: list[_Layout] = []

        def packed(*arguments: Any) -> tuple[Array, list[Array]]:
            result = function(*arguments)
            layout[:] = [_Layout.of(result)]
            leaves = jax.tree.leaves(result)
            reals = [jnp.ravel(leaf) for leaf in leaves if _is_real(leaf)]
            return jnp.concatenate([jnp.zeros(0), *reals]), [leaf for leaf in leaves if not _is_real(leaf)]

        executable = self._compile(packed, *arguments)
        return lambda *given: layout[0].unpacked(*executable(*given))


class _Layout(NamedTuple):
    """A tree of arrays, of which the real ones stand side by side in one vector.

    - `shapes` of the leaves in order, None for those that stand by themselves; `ends` of the others in the vector.
    """

    structure: Any
    shapes: tuple[tuple[int, ...] | None, ...]
    ends: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, tree: Any) -> "_Layout":
        leaves, structure = jax.tree.flatten(tree)
        shapes = tuple(leaf.shape if _is_real(leaf) else None for leaf in leaves)
        sizes = [math.prod(shape) for shape in shapes if shape is not None]
        return cls(structure, shapes, tuple(pairwise(accumulate(sizes, initial=0))))

    def unpacked(self, vector: jax.Array, others: list[jax.Array]) -> Any:
        """The tree of NumPy arrays."""
        numbers, alone, ends = np.asarray(vector), iter(others), iter(self.ends)
        leaves = [
            np.asarray(next(alone)) if shape is None else numbers[slice(*next(ends))].reshape(shape)
            for shape in self.shapes
        ]
        return jax.tree.unflatten(self.structure, leaves)


def _is_real(leaf: Any) -> bool:
    return eqx.is_array(leaf) and leaf.dtype == float
