"""A user's functions: what they return, and their equations, traced once, where they are given."""

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, final

import jax
import numpy as np

from aleator._core.arrays import Layout, Pytree, is_number, numbers_to_arrays
from aleator._core.equations import Digest, TracedFunction, digest_of
from aleator._core.errors import AleatorError, ProblemError
from aleator._core.leaves import AbstractLeaf, is_leaf, realised_shape

# As much of an error's text as a message repeats.
_LONGEST = 160


def returned(who: str, function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """What a user's function `who` returns. Raises `ProblemError` for whatever it raises, with a remedy if known."""
    try:
        return function(*arguments, **named)
    except (AleatorError, jax.errors.JaxRuntimeError):
        raise
    except jax.errors.TracerBoolConversionError as error:
        raise ProblemError(
            f"{who} branches on a number that is only known at run time: use jnp.where(condition, a, b) instead of "
            "`if`, and jnp.minimum or jnp.maximum instead of min or max."
        ) from error
    except jax.errors.JAXTypeError as error:
        raise ProblemError(
            f"{who} converts a number that is only known at run time to plain Python or NumPy: use jax.numpy, such as "
            "jnp.sin, instead of numpy and math, and avoid float(), int(), range(), .item() and .tolist()."
        ) from error
    except Exception as error:
        raise ProblemError(f"{who} raised {type(error).__name__}: {first_line(error)}{_hint(error)}") from error


def first_line(error: Exception) -> str:
    """The first line of an error's text, as much of it as a message repeats."""
    text = (str(error).splitlines() or [""])[0]
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


def _hint(error: Exception) -> str:
    """The names of a state, where the code asked for an unknown one, and what else a state may lack."""
    if isinstance(error, IndexError) and "0-dimensional" in str(error):
        return ". A state without a value in initial() is a single number, zero: arrays are given there."
    names = getattr(getattr(error, "obj", None), "_fields", ())
    return f"; expected one of {names}." if isinstance(error, AttributeError) and names else ""


@final
class OwnFunction:
    """A user's function of trees of numbers as its equations; equal to another one if these are.

    - `given`: the function; `arguments`: its own, with any numbers of the same shapes, or leaves in their places.

    A pickle has the function and their digest: where it is read, they are traced again and compared when they are
    needed. Only for arguments of another structure, as a user may give outside of problems, is the function called.
    """

    def __init__(self, who: str, function: Any, arguments: tuple[Pytree, ...], digest: Digest | None = None):
        self._who, self.given, self._digest = who, function, digest
        self._arguments = jax.tree.map(_zeros, arguments, is_leaf=is_leaf)
        self.digest = digest or digest_of(self.traced.closed)

    @cached_property
    def traced(self) -> TracedFunction:
        """Its equations. Raises `ProblemError` if they are others than in the process that it comes from."""
        traced = TracedFunction(partial(returned, self._who, self.given), *self._arguments)
        if self._digest is not None:
            self._digest.refuse_other(digest_of(traced.closed), self._who)
        return traced

    def __call__(self, *arguments: Pytree) -> Pytree:
        is_same = Layout.of(numbers_to_arrays(arguments), packed=False) == self.traced.layout
        return self.traced(*arguments) if is_same else self.given(*arguments)

    def __reduce__(self) -> tuple[Any, ...]:
        return OwnFunction, (self._who, self.given, self._arguments, self.digest)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, OwnFunction) or not self.digest.is_whole:
            return self is other
        return self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)


def _zeros(number: Any) -> Any:
    return np.zeros(realised_shape(number)) if isinstance(number, AbstractLeaf) or is_number(number) else number
