"""Outputs of a function of uncertain inputs, checked to be real and finite; errors name the inputs."""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeAlias

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree, jax_array
from aleator._core.border import is_masked
from aleator._core.errors import AleatorError, ProblemError, SimulationError
from aleator.uncertainty import Placements, uncertain_numbers

Function: TypeAlias = Callable[[Any], Pytree]
"""A function of a realised model, in which plain or traced numbers have replaced the distributions."""

UNTRACEABLE = (jax.errors.JAXTypeError, jax.errors.NonConcreteBooleanIndexError)
"""Errors that JAX raises if a function needs concrete values while it is traced."""


# As much of an error's text as a message repeats.
_LONGEST = 200


def name_of(function: Callable[..., Any]) -> str:
    """The name of a user's function in messages."""
    return f"'{getattr(function, '__name__', type(function).__name__)}'"


def outputs_of(function: Function, realised: Pytree, library: Any, point: Callable[[], str] | None = None) -> Pytree:
    """The outputs of a user's function for a realised model, as arrays of `library` (`numpy` or `jax.numpy`).

    - `point`: describes the realisation, if they are evaluated one at a time.

    Raises `ProblemError` for an output that is no real array or is empty, for an unknown input, and for any other
    exception of the function (`SimulationError` if the point is known); errors of JAX's tracing pass unchanged.
    """
    name = name_of(function)
    try:
        given = function(realised)
    except (MemoryError, jax.errors.JaxRuntimeError, *UNTRACEABLE):
        raise
    except Exception as error:
        if isinstance(error, AleatorError) and point is None:
            raise
        if missing := absent(error, realised):
            raise ProblemError(f"{name} asks for {missing}.") from error
        said = next(iter(str(error).splitlines()), "")[:_LONGEST].rstrip(".")
        raised = f"{name} raised {type(error).__name__}{said and ': '}{said}"
        if point is None:
            raise ProblemError(f"{raised}.") from error
        raise SimulationError(f"{raised}, at {point()}.") from error
    return as_outputs(given, name, library)


def as_outputs(given: Pytree, name: str, library: Any) -> Pytree:
    """What the function called `name` returned, as arrays of `library`.

    Raises `ProblemError` for an output that is no real array or is empty.
    """
    if given is None:
        raise ProblemError(f"{name} returns nothing; expected an array or a dict of arrays.")
    _refuse_odd_names(given, name)
    outputs = jax.tree.map(lambda value: real_array(value, name, library), given, is_leaf=lambda one: one is None)
    for path, leaf in jax.tree_util.tree_leaves_with_path(outputs):
        if leaf.size == 0:
            raise ProblemError(
                f"{name}, {_output(path)}: expected one number at least; received an array of shape {leaf.shape}, of "
                "which there are no statistics. Leave it out."
            )
    return outputs


def _refuse_odd_names(given: Pytree, name: str) -> None:
    """Raise `ProblemError` for dicts with names of several types, which have no order."""
    if isinstance(given, dict):
        kinds = sorted({type(one).__name__ for one in given})
        if len(kinds) > 1:
            raise ProblemError(f"{name} must return dicts by texts; received names of the types {', '.join(kinds)}.")
    for part in given.values() if isinstance(given, dict) else given if isinstance(given, list | tuple) else ():
        _refuse_odd_names(part, name)


def absent(error: Exception, realised: Pytree) -> str:
    """The name that a function asks its model for in vain, and those that there are; empty for other errors."""
    if isinstance(error, KeyError) and isinstance(realised, dict) and error.args and error.args[0] not in realised:
        return f"the input {error.args[0]!r}: expected one of {list(realised)}"
    if isinstance(error, AttributeError) and getattr(error, "obj", None) is realised and is_dataclass(realised):
        return f"'{error.name}': expected one of {[one.name for one in fields(realised)]}"
    return ""


def _output(path: tuple[Any, ...]) -> str:
    """An output by its place among all, in words."""
    name = jax.tree_util.keystr(path, simple=True, separator=".")
    return f"output '{name}'" if name else "its output"


def real_array(value: Any, name: str, library: Any) -> Any:
    """One output of the function called `name` as a 64-bit array of `library` (NumPy or its like in JAX)."""
    kind = getattr(value, "dtype", None)
    real = isinstance(value, bool | int | float) if kind is None else np.dtype(kind).kind in "biuf"
    if not real:
        raise ProblemError(
            f"{name} must return a real array or a dict of real arrays; received {type(value).__name__}"
            f"{'' if kind is None else f' of {kind}'}. Stack a list with jnp.stack; take real parts of a complex array."
        )
    if is_masked(value):
        raise ProblemError(f"{name} returned masked numbers; expected numbers, or NaN where there are none.")
    try:
        value = float(value) if isinstance(value, int) else value
    except OverflowError as error:
        raise ProblemError(
            f"{name} returned a whole number beyond 1e308, which no number of this machine is."
        ) from error
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


def is_finite(numbers: Pytree) -> bool:
    """Whether all numbers are finite, as far as they are known."""
    known = map(concrete, jax.tree.leaves(numbers))
    return all(array is None or bool(np.isfinite(array).all()) for array in known)


def inputs_at(places: Placements, point: Float[Any, " variables"], decisions: Float[Array, " n"]) -> dict[str, float]:
    """The uncertain inputs at one germ point, by name."""
    numbers = uncertain_numbers(places, jax_array(point), decisions)
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
        raise SimulationError(
            f"{who} is not finite at {bad.sum()} of {len(bad)} points{after}: {_output(path)} first at point "
            f"{before + first + 1} ({inputs(first)}). Narrow the distributions of the inputs, or fix it there."
        )
