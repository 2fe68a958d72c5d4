"""Array types shared by all parts, and the conversion of a user's numbers into arrays that JAX traces."""

from typing import Any, TypeAlias

import equinox as eqx
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


def realised_shape(leaf: Any) -> tuple[int, ...]:
    """The shape of what realisation leaves in the place of a leaf: a decision's own, one number for a law."""
    if isinstance(leaf, eqx.Module):
        bounds = decided_bounds(leaf)
        return () if bounds is None else np.shape(bounds[0])
    return np.shape(leaf)


def decided_bounds(leaf: Any) -> tuple[Any, Any] | None:
    """The bounds of a decision; None for everything else.

    The layers below decisions know them by their parts alone: a start and its bounds.
    """
    parts = [getattr(leaf, name, None) for name in ("initial", "lower", "upper")]
    return None if any(part is None or callable(part) for part in parts) else (parts[1], parts[2])
