"""Arrays: their types, how numbers become what JAX traces, how they are passed, and the memory that they take."""

import math
import os
from collections.abc import Sequence
from functools import lru_cache
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeGuard

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError

Scalar: TypeAlias = float | Float[np.ndarray, ""] | Float[Array, ""]
Pytree: TypeAlias = Any

Number: TypeAlias = Any
"""A number of a model: plain, uncertain or decided. (A type checker cannot follow its realisation.)"""


def numbers_to_arrays(tree: Pytree) -> Pytree:
    """Turn every float and NumPy array of `tree` into a 64-bit JAX array, so that changing it recompiles nothing.

    Whole numbers and everything else are unchanged, because Python control flow may depend on them.
    """
    leaves, structure = jax.tree.flatten(tree)
    known = [i for i, leaf in enumerate(leaves) if is_number(leaf) and not isinstance(leaf, jax.Array)]
    # All at once: each transfer alone takes as long as some hundred numbers.
    for i, array in zip(known, _sent([np.array(leaves[i], dtype=float) for i in known]), strict=True):
        leaves[i] = array
    converted = [jnp.asarray(leaf, dtype=float) if _is_array_of_numbers(leaf) else leaf for leaf in leaves]
    return jax.tree.unflatten(structure, converted)


def _is_array_of_numbers(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and leaf.dtype != float and is_number(leaf)


def _sent(numbers: Any) -> Any:
    """Arrays of NumPy as arrays of JAX, which may be kept and so must not belong to a function that is being traced."""
    with jax.ensure_compile_time_eval():
        return jax.device_put(numbers)


def jax_array(numbers: Any, kind: type | None = None) -> Array:
    """Numbers as an array of JAX, of another `kind` if one is given; known numbers are copied.

    `jnp.asarray` would compile a copying program for each new shape.
    """
    if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(numbers)):
        return jnp.asarray(numbers, dtype=kind)
    return _sent(np.array(numbers, dtype=kind))


def block_diagonal(library: Any, *blocks: Any) -> Any:
    """A matrix with some matrices along its diagonal: SciPy's takes a quarter of a second to load."""
    ends = np.cumsum([0, *(one.shape[1] for one in blocks)]).tolist()
    sides = [(first, ends[-1] - last) for first, last in pairwise(ends)]
    return library.concatenate([library.pad(one, ((0, 0), side)) for one, side in zip(blocks, sides, strict=True)])


# NumPy would warn of NaN and infinite values, which are results here.
quietly = np.errstate(all="ignore")


def in_library(*trees: Pytree) -> tuple[Any, ...]:
    """The library to compute with, and trees of its arrays: NumPy if every number is known, else `jax.numpy`.

    Outside traced code, JAX compiles a program for each operation on arrays of a new shape; NumPy needs none.
    """
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees)):
        return jnp, *trees
    return np, *(jax.tree.map(np.asarray, tree) for tree in trees)


def alike(result: Any, *causes: Pytree) -> Any:
    """A result as an array of JAX if it or what it follows from is one, else of NumPy: a transfer takes as long as a
    statistic of a history.
    """
    is_of_jax = any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves((result, causes)))
    return jax_array(result) if is_of_jax else np.asarray(result)


def is_number(leaf: Any) -> bool:
    """Whether `leaf` is a real number or an array of them: a Python float, or a floating NumPy or JAX array."""
    return isinstance(leaf, float) or jnp.issubdtype(getattr(leaf, "dtype", None) or bool, jnp.floating)


NUMBER = 8
"""Bytes of a real number."""

# The part of the machine's memory that one array program may take: the rest of a solve, and the machine, need some.
_SHARE = 0.5

# Used if the machine's memory is unknown.
_ASSUMED = 8 * 2**30

# Larger numbers of bytes are not printed.
_BEYOND = 2**100

_GROUPS = Path("/sys/fs/cgroup")
_OWN_GROUP = Path("/proc/self/cgroup")


def refuse_beyond_memory(what: str, size: int, advice: str) -> None:
    """Raise `ProblemError` if `what`, a noun, needs more memory than is available: `size` in bytes.

    `advice`: a sentence with the remedy. Check counts before anything is enumerated.
    """
    if not may_hold(size):
        raise ProblemError(
            f"{what} would need {_gibibytes(size)} of memory; this machine has {_gibibytes(memory())}, of which half "
            f"may be used. {advice}"
        )


def may_hold(size: int) -> bool:
    """Whether so many bytes are at most the share of the machine's memory that one thing may take."""
    return size <= _SHARE * memory()


@lru_cache(maxsize=1)
def memory() -> int:
    """The memory of this machine in bytes, or the limit of a container."""
    try:
        machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        machine = 0
    return min([machine if machine > 0 else _ASSUMED, *_group_limits()])


def _group_limits() -> list[int]:
    """The limits of this process's control groups, of both versions; empty if there are none."""
    limits = []
    for line in _read(_OWN_GROUP).splitlines():
        _, _, own = line.partition("::")
        places = [_GROUPS / own.strip("/"), *(_GROUPS / own.strip("/")).parents] if own else []
        limits += [place / "memory.max" for place in places if place.is_relative_to(_GROUPS)]
    texts = [_read(one).strip() for one in [*limits, _GROUPS / "memory" / "memory.limit_in_bytes"]]
    return [int(text) for text in texts if text.isdecimal() and int(text) > 0]


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return ""


def _gibibytes(size: int) -> str:
    return f"{size / 2**30:.3g} GiB" if size < _BEYOND else f"more than {_BEYOND / 2**30:.0e} GiB"


class _Array(NamedTuple):
    """An array in a tree."""

    shape: tuple[int, ...]
    dtype: Any


class _Other(NamedTuple):
    """Anything else in a tree, with its type, because 1 and True are equal."""

    kind: type
    value: Any


class Layout(NamedTuple):
    """The layout of a tree as it is passed to an executable or from it; what is no array is a part of it.

    Every array that is passed costs time at each call, so that real numbers may be packed in a vector, which is passed
    first; copying large arrays takes longer.
    """

    structure: Any
    leaves: tuple[_Array | _Other, ...]
    is_packed: bool

    @classmethod
    def of(cls, tree: Pytree, *, packed: bool) -> "Layout":
        leaves, structure = jax.tree.flatten(tree)
        kinds = tuple(
            _Array(leaf.shape, leaf.dtype) if _is_passed(leaf) else _Other(type(leaf), leaf) for leaf in leaves
        )
        return cls(structure, kinds, packed and any(map(_is_real, kinds)))

    def arrays(self, tree: Pytree) -> list[Any]:
        """The arrays that are passed, or their shapes."""
        arrays = list(filter(_is_passed, jax.tree.leaves(tree)))
        if not self.is_packed:
            return arrays
        library, packed = in_library(list(filter(_is_real, arrays)))
        vector = library.concatenate([library.ravel(one) for one in packed])
        return [vector, *(one for one in arrays if not _is_real(one))]

    def read(self, arrays: Sequence[Any]) -> Pytree:
        """The tree of arrays that were passed."""
        passed, packed = iter(arrays), iter(())
        if self.is_packed:
            packed = iter(_split(next(passed), [one.shape for one in self.leaves if _is_real(one)]))
        leaves = [
            one.value if isinstance(one, _Other) else next(packed if self.is_packed and _is_real(one) else passed)
            for one in self.leaves
        ]
        return jax.tree.unflatten(self.structure, leaves)

    def shapes(self) -> Pytree:
        """The tree with the shapes of its arrays in their places."""
        leaves = [one.value if isinstance(one, _Other) else jax.ShapeDtypeStruct(*one) for one in self.leaves]
        return jax.tree.unflatten(self.structure, leaves)


def _split(vector: Any, shapes: list[tuple[int, ...]]) -> list[Any]:
    sizes = [math.prod(shape) for shape in shapes]
    if isinstance(vector, Tracer):  # one equation
        parts = jax.lax.split(vector, sizes)
    else:
        parts = [vector[start:stop] for start, stop in pairwise(accumulate(sizes, initial=0))]
    return [part if part.shape == shape else part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


def _is_passed(leaf: Any) -> bool:
    return eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)


def _is_real(one: Any) -> TypeGuard[_Array]:
    return not isinstance(one, _Other) and one.dtype == float
