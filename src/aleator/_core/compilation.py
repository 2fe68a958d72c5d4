"""Ahead-of-time compilation, once per structure of the arguments, with its time on record."""

import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, final

import equinox as eqx
import jax

# Enough for a session's problems; beyond, the one unused for longest is dropped, with the classes it holds.
_KEPT = 32


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
        static_leaves, static_structure = jax.tree.flatten(static)
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        kinds = tuple(type(leaf) for leaf in static_leaves)  # 1 and True are equal, but not the same structure
        key = (structure, static_structure, tuple(static_leaves), kinds, shapes)
        if key not in self._executables:
            self._executables[key] = self._compile(leaves, structure, static)
        self._executables.move_to_end(key)
        while len(self._executables) > _KEPT:
            self._executables.popitem(last=False)
        return self._executables[key](*leaves)

    def bound(self, *fixed: Any) -> Callable[..., Any]:
        """The function with its first arguments fixed and all others arrays: for many calls that differ in these alone.

        What tells the structure of the fixed arguments is found once, at the first call.
        """
        leaves = jax.tree.leaves(eqx.filter(fixed, eqx.is_array))
        found: list[Callable[..., Any]] = []

        def call(*arrays: jax.Array) -> Any:
            if found:
                return found[0](*leaves, *arrays)
            result = self(*fixed, *arrays)
            found.append(next(reversed(self._executables.values())))
            return result

        return call

    def _compile(self, leaves: list[jax.Array], structure: Any, static: Any) -> Callable[..., Any]:
        def flat(*leaves: jax.Array) -> Any:
            arguments = eqx.combine(jax.tree.unflatten(structure, leaves), static)
            return self._function(*arguments)

        start = time.perf_counter()
        executable = jax.jit(flat).lower(*leaves).compile()
        self.seconds += time.perf_counter() - start
        self.compilations += 1
        return executable
