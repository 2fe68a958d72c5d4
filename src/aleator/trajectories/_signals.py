"""Signals, functions of time: inputs of a system, prescribed motions; functions with parameters, and sums."""

import abc
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library, jax_array
from aleator._core.equations import as_time
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, stored_numbers

Fractions = Float[np.ndarray, " n"] | Float[Array, " n"]


class AbstractSignal(Module):
    """An input of a system as a function of time. It is part of the model: its numbers may be uncertain or decided.

    `unbounded` says that its values have no bound whatever its numbers are, as for a Gaussian process, and
    `declares_jumps` that it has no jumps but those that it declares.
    """

    unbounded: ClassVar[bool] = False
    declares_jumps: ClassVar[bool] = False

    @abc.abstractmethod
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        """The value at time `t`, s."""

    def span(self) -> tuple[float, float]:
        """The first and last time at which the signal is known; everywhere by default."""
        return -np.inf, np.inf

    def over(self, t_start: Any, t_final: Any) -> "AbstractSignal":
        """The signal on a grid from `t_start` to `t_final`, s: trajectories are stretched to fill it, inside it too."""

        def is_part(node: Any) -> bool:
            return isinstance(node, AbstractSignal) and node is not self

        # Not made anew: its numbers were checked, and may be traced.
        return jax.tree.map(lambda part: part.over(t_start, t_final) if is_part(part) else part, self, is_leaf=is_part)

    def sampled(self, fractions: Fractions, t_start: Any, t_final: Any) -> Float[Array, "n ..."]:
        """Its values at some fractions of the time from `t_start` to `t_final`."""
        over, times = self.over(t_start, t_final), instants(fractions, t_start, t_final)
        return jax.vmap(over)(times if self.declares_jumps else as_time(times))


def instants(fractions: Fractions, t_start: Any, t_final: Any) -> Float[Array, " n"]:
    """Fractions of the time from `t_start` to `t_final` as times; 1 is `t_final` to the last bit."""
    # A signal is undefined even a rounding error beyond its end, and so is an adaptive integrator's solution.
    xp, fractions, t_start, t_final = in_library(fractions, t_start, t_final)
    return jax_array(xp.where(fractions < 1, t_start + fractions * (t_final - t_start), t_final))


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


def signal(function: Callable[[Any, Any], Any], /, **parameters: Any) -> Parametrised:
    """The signal `function(t, p)`, where each parameter is an attribute of `p`.

    A parameter is a number or an array, a distribution, a `Decision` or another signal (a trajectory fills the time
    grid): `signal(lambda t, p: p.amplitude * jnp.sin(p.frequency * t), amplitude=Normal(1.0, 0.1), frequency=3.0)`. The
    function is written with `jax.numpy`, for one instant `t` in seconds. Uncertain coefficients of given functions of
    time also make a random process; `RandomProcess` makes one from its covariance.

    The function is part of a problem's structure: define it once and reuse it, and it is compiled once.

    Raises `ProblemError` if `function` is not a function, or for a parameter of any other kind.
    """
    return Parametrised(function, parameters)


def _parameter(name: str, value: Any) -> Any:
    """A parameter as it is stored: floats are data, which never cause recompilation; integers are structure."""
    is_structure = isinstance(value, int) and not isinstance(value, bool)
    keeps = is_structure or isinstance(value, AbstractSignal)
    return value if keeps else stored_numbers(f"signal: parameter '{name}'", value)


@final
class Total(AbstractSignal):
    """The sum of signals; see `total`. Its numbers are named after their signal's place: `inputs.force.parts.0...`."""

    parts: tuple[AbstractSignal, ...]

    def __init__(self, parts: Iterable[AbstractSignal]):
        self.parts = tuple(parts)
        for part in self.parts:
            if not isinstance(part, AbstractSignal):
                raise ProblemError(
                    "total: expected signals, such as al.processes.total(command, noise); received "
                    f"{type(part).__name__} {part!r}. Make a constant or a function of time a signal with "
                    "al.processes.signal."
                )
        if not self.parts:
            raise ProblemError("total: expected at least one signal; received none.")
        self.span()

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        first, *others = (part(t) for part in self.parts)
        return sum(others, start=first)

    @override
    def sampled(self, fractions: Float[np.ndarray | Array, " n"], t_start: Any, t_final: Any) -> Float[Array, "n ..."]:
        first, *others = (part.sampled(fractions, t_start, t_final) for part in self.parts)
        return sum(others, start=first)

    @override
    def span(self) -> tuple[float, float]:
        return common_span(part.span() for part in self.parts)


def total(*signals: AbstractSignal) -> Total:
    """The sum of signals: a command and the actuator's noise, a mean road and its roughness.

    Raises `ProblemError` for arguments that are not signals, and for signals with no common time.
    """
    return Total(signals)


def common_span(spans: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """The times that lie in all spans. Raises `ProblemError` if there are none."""
    spans = tuple(spans)
    first, last = max(start for start, _ in spans), min(end for _, end in spans)
    if not first < last:
        known = " and ".join(f"from {start:g} to {end:g} s" for start, end in spans)
        raise ProblemError(f"Signals that are added must be known at the same times; received signals known {known}.")
    return first, last
