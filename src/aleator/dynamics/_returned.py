"""What a user's methods return, as arrays; checked at trace time."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from aleator._core.border import traceable
from aleator._core.errors import ProblemError


def starting(what: str, names: tuple[str, ...], given: Mapping[str, Any]) -> list[Array]:
    """Initial values or guesses by name as arrays, zero where not given; known ones are checked to be finite."""
    values = [traceable(f"{what}, '{name}'", given.get(name, 0.0)) for name in names]
    for name, value in zip(names, values, strict=True):
        if not isinstance(value, Tracer) and not np.isfinite(value).all():
            raise ProblemError(f"{what}, '{name}': expected finite numbers; received {given[name]}.")
    return values


def as_outputs(system: eqx.Module, values: Any) -> dict[str, Array]:
    """The return value of `system.outputs` as arrays by name."""
    if not isinstance(values, dict):
        raise ProblemError(
            f"{system.title}.outputs returns a dict of arrays by name; received {type(values).__name__}."
        )
    who = f"{system.title}.outputs"
    found = {}
    for name, value in values.items():
        if not isinstance(name, str):
            raise ProblemError(f"{who}: expected names of outputs; received {name!r}.")
        found[name] = traceable(f"{who}, '{name}'", value)
        if found[name].size == 0:
            raise ProblemError(
                f"{who}, '{name}': expected at least one number; received an array of shape {found[name].shape}, on "
                "which every constraint would hold. Drop the output."
            )
    return found


def as_equations(
    system: eqx.Module, values: Any, unknowns: tuple[str, ...], expected: int
) -> Float[Array, " expected"]:
    """The return value of `system.residual` as one vector, of as many entries as there are numbers in `unknowns`."""
    name = system.title
    if not isinstance(values, tuple | list):
        received = f"an array of shape {values.shape}" if isinstance(values, jax.Array) else type(values).__name__
        raise ProblemError(
            f"{name}.residual returns the equations as a tuple, one equation too: 'return (left - right,)'; "
            f"received {received}."
        )
    vector = jnp.concatenate([jnp.zeros(0), *(jnp.ravel(traceable(f"{name}.residual", value)) for value in values)])
    if vector.size != expected:
        raise ProblemError(
            f"{name}.residual: expected as many equations as there are numbers in the unknowns {unknowns}, "
            f"{expected}; received {vector.size}."
        )
    return vector
