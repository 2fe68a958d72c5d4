"""Array types shared by all parts, and the conversion of a user's numbers into arrays that JAX traces."""

from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Scalar: TypeAlias = float | Float[np.ndarray, ""] | Float[Array, ""]
Pytree: TypeAlias = Any

Number: TypeAlias = Any
"""A number of a model: plain, uncertain or decided. (A type checker cannot follow how it is realised.)"""


def numbers_to_arrays(tree: Pytree) -> Pytree:
    """Turn every float and NumPy array of `tree` into a 64-bit JAX array, so that changing it recompiles nothing.

    Whole numbers and everything else stay as they are: they may steer Python control flow.
    """

    def convert(leaf: Any) -> Any:
        return jnp.asarray(leaf, dtype=float) if is_number(leaf) else leaf

    return jax.tree.map(convert, tree)


def is_number(leaf: Any) -> bool:
    """Whether `leaf` is a real number or an array of them: a Python float, or a floating NumPy or JAX array."""
    return isinstance(leaf, float) or jnp.issubdtype(getattr(leaf, "dtype", None) or bool, jnp.floating)
