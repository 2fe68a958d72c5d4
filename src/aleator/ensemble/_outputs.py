"""Outputs of a function of uncertain inputs, checked to be real and finite; errors name the inputs."""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError, SimulationError
from aleator.uncertainty import Placements, uncertain_numbers

Function: TypeAlias = Callable[[Any], Pytree]
"""A function of a realised model, in which plain or traced numbers have replaced the distributions."""

UNTRACEABLE = (jax.errors.JAXTypeError, jax.errors.NonConcreteBooleanIndexError)
"""Errors that JAX raises if a function needs concrete values while it is traced."""


def name_of(function: Callable[..., Any]) -> str:
    """The name of a user's function in messages."""
    return f"'{getattr(function, '__name__', type(function).__name__)}'"


def real_array(value: Any, name: str, library: Any) -> Any:
    """One output of the function called `name` as a 64-bit array of `library` (NumPy or its like in JAX)."""
    kind = getattr(value, "dtype", None)
    real = isinstance(value, bool | int | float) if kind is None else np.dtype(kind).kind in "biuf"
    if not real:
        raise ProblemError(
            f"{name} must return a real array or a dict of real arrays; received {type(value).__name__}"
            f"{'' if kind is None else f' of {kind}'}. Stack a list with jnp.stack; take real parts of a complex array."
        )
    # A called function may return the same array each time, with other numbers in it.
    return np.array(value, dtype=float) if library is np else library.asarray(value, dtype=float)


def part(outputs: Pytree, name: str) -> Pytree:
    """One output of a dict."""
    if not isinstance(outputs, dict):
        raise ProblemError(f"There is one output, without a name; received '{name}'. Drop ['{name}'].")
    if name not in outputs:
        raise ProblemError(f"There is no output '{name}'; expected one of {list(outputs)}.")
    return outputs[name]


def concrete(array: Any) -> np.ndarray | None:
    """An array's current values, stripped of differentiation; None while it is being compiled."""
    below = jax.lax.stop_gradient(array)
    return None if isinstance(below, Tracer) else np.asarray(below)


def inputs_at(places: Placements, point: Float[Any, " variables"], decisions: Float[Array, " n"]) -> dict[str, float]:
    """The uncertain inputs at one germ point, by name."""
    numbers = uncertain_numbers(places, jnp.asarray(point), decisions)
    return {name: float(jax.lax.stop_gradient(number)) for name, number in numbers.items()}


def listed(numbers: Mapping[str, float]) -> str:
    """Numbers with their names, for messages."""
    return ", ".join(f"{name}={number:.6g}" for name, number in numbers.items())


def refuse_nonfinite(who: str, outputs: Pytree, inputs: Callable[[int], str], before: int = 0) -> None:
    """Raise `SimulationError` where an output is not finite, as far as values are known.

    - `who`: the function or other source of the outputs; `outputs`: each with a leading axis for the points;
    - `inputs`: gives the inputs at the point with an index, as text; `before`: how many points came earlier.
    """
    for path, leaf in jax.tree_util.tree_leaves_with_path(outputs):
        known = concrete(leaf)
        if known is None or np.isfinite(known).all():
            continue
        bad = np.asarray(~np.isfinite(known.reshape(len(known), -1)).all(axis=1))
        first = int(np.argmax(bad))
        after = f" after {before} finite ones" if before else ""
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        what = f"output '{name}'" if name else "its output"
        raise SimulationError(
            f"{who} is not finite at {bad.sum()} of {len(bad)} points{after}: {what} first at point "
            f"{before + first + 1} ({inputs(first)}). Narrow the distributions of the inputs, or fix it there."
        )
