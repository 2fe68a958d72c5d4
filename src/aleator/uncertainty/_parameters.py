"""Parameters of distributions: as a user gives them, and their canonical form."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer

from aleator._core.arrays import Scalar
from aleator._core.errors import ProblemError
from aleator._core.given import is_masked
from aleator.uncertainty._decision import Decision


class Canonical(NamedTuple):
    """A distribution as `location + scale * germ`, with the shape parameters of its germ (none, one or two numbers)."""

    location: Scalar
    scale: Scalar
    shape: tuple[Scalar, ...] = ()


class Form(NamedTuple):
    """One way to give a distribution's parameters: their canonical form, and which of them set the shape."""

    canonical: Callable[..., Canonical]
    shaped_by: frozenset[str] = frozenset()


def constant(tree: Any) -> Any:
    """The same numbers without their derivatives: plain ones under `jax.grad`, but traced ones under `jax.jit`."""
    with jax.ensure_compile_time_eval():
        return jax.lax.stop_gradient(tree)


def plain(name: str, value: Any, family: type) -> Any:
    """A parameter as a float, a scalar array or a scalar `Decision`."""
    if isinstance(value, Decision):
        if np.ndim(value.initial) == 0:
            return value
        received = f"a Decision of shape {np.shape(value.initial)}"
    elif isinstance(value, jax.Array) and value.ndim == 0:
        return value
    elif isinstance(value, int | float | np.number | np.ndarray) and _is_one_real(value):
        return float(value)
    else:
        received = f"{type(value).__name__} {value!r}"
    raise ProblemError(f"{family.__name__}: '{name}' takes one number or one Decision; received {received}.")


def _is_one_real(given: Any) -> bool:
    value = np.asarray(given)
    return not is_masked(given) and value.ndim == 0 and value.dtype.kind in "iuf"


def brief(value: Any) -> str:
    """A parameter as text."""
    if isinstance(value, Decision):
        return f"Decision({float(value.initial):g} in [{float(value.lower):g}, {float(value.upper):g}])"
    return f"{float(value):g}" if not isinstance(value, Tracer) else "traced"
