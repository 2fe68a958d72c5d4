"""The numbers of a shape: checked and stored as given, and returned as arrays once realised."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator._core.given import real_array
from aleator._core.leaves import AbstractLeaf, lowest, realised_shape


def stored(owner: str, name: str, value: Any) -> Any:
    """The numbers of a field as a shape keeps them.

    Plain numbers become a float or a NumPy copy, checked to be finite. Distributions, decisions and traced arrays are
    kept unchanged, even inside a sequence, which becomes a tuple. Raises `ProblemError` for anything else.
    """
    if _is_open(value):
        return value
    if isinstance(value, list | tuple) and _has_open(value):
        return tuple(stored(owner, name, part) for part in value)
    numbers = real_array(f"{owner}: '{name}'", value, "numbers, distributions, decisions or arrays")
    if not np.isfinite(numbers).all():
        raise ProblemError(f"{owner}: '{name}' must be finite; received {numbers}.")
    return numbers if numbers.ndim else float(numbers)


def shape_of(value: Any) -> tuple[int, ...]:
    """The shape of a stored field once it is realised."""
    if isinstance(value, tuple):
        return (len(value), *_common_shape(value))
    return realised_shape(value)


def plain(value: Any) -> np.ndarray | None:
    """The values of a stored field if they are known; `None` where they are uncertain, decided or traced."""
    return np.asarray(value) if isinstance(value, float | np.ndarray) else None


def check_point(owner: str, name: str, value: Any) -> None:
    """Raise `ProblemError` unless `value` is a vector of the plane or of space."""
    if shape_of(value) not in ((2,), (3,)):
        raise ProblemError(
            f"{owner}: '{name}' takes 2 numbers in the plane or 3 in space; received shape {shape_of(value)}. "
            "For a batch of shapes, use `jax.vmap`."
        )


def check_same_size(owner: str, **fields: Any) -> None:
    """Raise `ProblemError` unless two vectors have one size."""
    sizes = {name: shape_of(value) for name, value in fields.items()}
    if len(set(sizes.values())) > 1:
        received = " and ".join(f"'{name}' of shape {size}" for name, size in sizes.items())
        raise ProblemError(f"{owner}: expected vectors of the same size; received {received}.")


def check_number(owner: str, name: str, value: Any) -> None:
    """Raise `ProblemError` unless `value` is one number."""
    if shape_of(value) != ():
        raise ProblemError(f"{owner}: '{name}' takes one number; received shape {shape_of(value)}.")


def check_radius(owner: str, value: Any) -> None:
    """Raise `ProblemError` unless `value` is one number that cannot become negative, as far as that is known."""
    check_number(owner, "radius", value)
    least = lowest(value)
    if least is not None and least < 0:
        raise ProblemError(f"{owner}: 'radius' must be zero or more; {_received(value, least)}")


def check_lengths(owner: str, name: str, value: Any) -> None:
    """Raise `ProblemError` if one of several numbers can become zero or negative, as far as they are known."""
    least = lowest(value)
    if least is not None and least <= 0:
        raise ProblemError(f"{owner}: '{name}' must be positive; {_received(value, least)}")


def _received(value: Any, least: float) -> str:
    known = plain(value)
    if known is not None:
        return f"received {known}."
    reach = "numbers that are unbounded below" if least == -np.inf else f"numbers that can reach {least:g}"
    return (
        f"received {reach}. Give larger numbers, distributions that are bounded or spread less, or decisions with "
        "higher lower bounds."
    )


def realised(owner: str, name: str, value: Any) -> Float[Array, "..."]:
    """A field as an array. Raises `ProblemError` if it still holds a distribution or a decision."""
    if isinstance(value, list | tuple):
        return jnp.stack([realised(owner, name, part) for part in value])
    if isinstance(value, AbstractLeaf):
        raise ProblemError(
            f"{owner}: '{name}' holds {value}, which has no value yet. Take distances where the model is realised: in "
            "a system's outputs."
        )
    return jnp.asarray(value, dtype=float)


def realised_point(owner: str, name: str, value: Any) -> Float[Array, " d"]:
    """A vector of the plane or of space as an array, checked again: batches show only when distances are taken."""
    point = realised(owner, name, value)
    check_point(owner, name, point)
    return point


def _is_open(value: Any) -> bool:
    """Whether the value is not known yet: a distribution, a decision or a traced number."""
    return isinstance(value, AbstractLeaf | Tracer)


def _has_open(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(_has_open(part) for part in value)
    return _is_open(value)


def _common_shape(parts: tuple[Any, ...]) -> tuple[int, ...]:
    shapes = {shape_of(part) for part in parts}
    if len(shapes) > 1:
        raise ProblemError(f"A shape's numbers do not form an array: their parts have shapes {sorted(shapes)}.")
    return shapes.pop()
