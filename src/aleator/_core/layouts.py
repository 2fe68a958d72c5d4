"""Layouts of trees of arrays as the arguments and results of executables: leaf by leaf, or packed into one vector."""

import math
from itertools import accumulate, pairwise
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from aleator._core.arrays import in_library


class Leaves(NamedTuple):
    """The layout of a tree of arrays that are passed one by one."""

    structure: Any

    @classmethod
    def of(cls, tree: Any) -> "Leaves":
        return cls(jax.tree.structure(tree))

    @staticmethod
    def arrays(tree: Any) -> list[Array]:
        return jax.tree.leaves(tree)

    def read(self, arrays: list[jax.Array]) -> Any:
        """The tree of the same arrays."""
        return jax.tree.unflatten(self.structure, arrays)


class Packed(NamedTuple):
    """The layout of a tree of arrays whose real ones are packed into one vector.

    - `shapes`: of the leaves in order, None for those passed separately; `ends`: of the others in the vector.
    """

    structure: Any
    shapes: tuple[tuple[int, ...] | None, ...]
    ends: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, tree: Any) -> "Packed":
        leaves, structure = jax.tree.flatten(tree)
        shapes = tuple(leaf.shape if is_real(leaf) else None for leaf in leaves)
        sizes = [math.prod(shape) for shape in shapes if shape is not None]
        return cls(structure, shapes, tuple(pairwise(accumulate(sizes, initial=0))))

    @staticmethod
    def arrays(tree: Any) -> list[Array]:
        leaves = jax.tree.leaves(tree)
        library, numbers = in_library([leaf for leaf in leaves if is_real(leaf)])
        vector = library.concatenate([library.zeros(0), *map(library.ravel, numbers)])
        return [vector, *(leaf for leaf in leaves if not is_real(leaf))]

    def read(self, arrays: list[jax.Array]) -> Any:
        """The tree of NumPy arrays."""
        numbers, alone, ends = np.asarray(arrays[0]), iter(arrays[1:]), iter(self.ends)
        leaves = [
            np.asarray(next(alone)) if shape is None else numbers[slice(*next(ends))].reshape(shape)
            for shape in self.shapes
        ]
        return jax.tree.unflatten(self.structure, leaves)


Way: TypeAlias = type[Leaves] | type[Packed]


def is_real(leaf: Any) -> bool:
    return eqx.is_array(leaf) and leaf.dtype == float
