"""`signal`: a function of time whose parameters are numbers of the model."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf
from aleator.trajectories import AbstractSignal


@final
class Parametrised(AbstractSignal):
    """A function of time and parameters; see `signal`. A parameter's name is its place: `inputs.force.p.amplitude`."""

    function: Callable[[Any, Any], Any] = eqx.field(static=True)
    p: dict[str, Any]

    def __init__(self, function: Callable[[Any, Any], Any], parameters: dict[str, Any]):
        if not callable(function):
            raise ProblemError(
                "signal: expected a function of time and parameters, such as lambda t, p: p.rate * t; "
                f"received {type(function).__name__} {function!r}."
            )
        self.function = function
        self.p = {name: _parameter(name, value) for name, value in parameters.items()}

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        return jnp.asarray(self.function(t, SimpleNamespace(**self.p)), dtype=float)

    @override
    def span(self) -> tuple[float, float]:
        return -np.inf, np.inf


def signal(function: Callable[[Any, Any], Any], /, **parameters: Any) -> Parametrised:
    """The signal `function(t, p)`, where each parameter is an attribute of `p`.

    A parameter is a number or an array, a distribution, a `Decision` or another signal: `signal(lambda t, p:
    p.amplitude * jnp.sin(p.frequency * t), amplitude=Normal(1.0, 0.1),
    frequency=3.0)`. The function is written with `jax.numpy`, for one instant `t` in seconds.  Uncertain coefficients
    of given functions of time also make a random process; `RandomProcess` makes one from its covariance.

    The function is part of a problem's structure: define it once and reuse it, and it is compiled once.

    Raises `ProblemError` if `function` is not a function, or for a parameter of any other kind.
    """
    return Parametrised(function, parameters)


def _parameter(name: str, value: Any) -> Any:
    """A parameter as it is stored: floats are data, which never cause recompilation; integers are structure."""
    if isinstance(value, AbstractLeaf | AbstractSignal | jax.Array) or (
        isinstance(value, int) and not isinstance(value, bool)
    ):
        return value
    if (
        not isinstance(value, float | list | tuple | np.ndarray | np.generic)
        or np.asarray(value).dtype.kind not in "iuf"
    ):
        raise ProblemError(
            f"signal: parameter '{name}' takes numbers, a distribution, a Decision or a signal; "
            f"received {type(value).__name__} {value!r}."
        )
    numbers = np.array(value, dtype=float)  # copies the caller's arrays
    if not np.isfinite(numbers).all():
        raise ProblemError(f"signal: parameter '{name}' must be finite; received {value!r}.")
    return float(numbers) if numbers.ndim == 0 else numbers
