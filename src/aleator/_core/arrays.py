"""Array types shared by all parts, and the conversion of a user's numbers into arrays that JAX traces."""

from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

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


# NumPy would warn of NaN and infinite values, which are results here.
quietly = np.errstate(all="ignore")


def in_library(*trees: Pytree) -> tuple[Any, ...]:
    """The library to compute with, and trees of its arrays: NumPy if every number is known, else `jax.numpy`.

    Outside traced code, JAX compiles a program for each operation on arrays of a new shape; NumPy needs none.
    """
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees)):
        return jnp, *trees
    return np, *(jax.tree.map(np.asarray, tree) for tree in trees)


def is_number(leaf: Any) -> bool:
    """Whether `leaf` is a real number or an array of them: a Python float, or a floating NumPy or JAX array."""
    return isinstance(leaf, float) or jnp.issubdtype(getattr(leaf, "dtype", None) or bool, jnp.floating)
