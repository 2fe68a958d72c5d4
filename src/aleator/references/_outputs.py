"""What a function of uncertain inputs may give: a real array or a dict of them (any pytree)."""

from collections.abc import Callable
from typing import Any, TypeAlias

import jax
import numpy as np

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError

Function: TypeAlias = Callable[[Any], Pytree]

UNTRACEABLE = (jax.errors.JAXTypeError, jax.errors.NonConcreteBooleanIndexError)
"""What JAX raises of a function that needs to know its numbers while it is traced."""


def part(outputs: Pytree, name: str) -> Pytree:
    """One output of a dict."""
    if not isinstance(outputs, dict):
        raise ProblemError(f"There is one output, without a name; received '{name}'. Leave ['{name}'] away.")
    if name not in outputs:
        raise ProblemError(f"There is no output '{name}'; expected one of {list(outputs)}.")
    return outputs[name]


def real_array(value: Any, library: Any) -> Any:
    """One output as a 64-bit array of `library`, NumPy or its like in JAX."""
    kind = np.dtype(getattr(value, "dtype", type(value))).kind
    if kind not in "biuf":
        raise ProblemError(
            f"The function must return a real array or a dict of real arrays; received {type(value).__name__}. Return "
            "jnp.stack(...) of a list, the real part of a complex number."
        )
    return library.asarray(value, dtype=float)
