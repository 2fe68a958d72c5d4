"""Functions of time: signals (inputs of a system, prescribed motions), and trajectories.

Trajectories are functions over a duration that is set elsewhere, with their derivatives.
"""

import abc
from collections.abc import Callable, Iterable
from functools import partial
from types import SimpleNamespace
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library, jax_array
from aleator._core.border import refusal, takes
from aleator._core.equations import as_time
from aleator._core.errors import ProblemError
from aleator._core.functions import OwnFunction
from aleator._core.leaves import Module, is_traced, lowest, realised_shape, stored_numbers

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
        # What is known is one program, not one for each operation; within a trace an equation, which tells of jumps.
        return (_along if is_traced((over, times)) else eqx.filter_jit(_along))(over, times)


def _along(signal: AbstractSignal, times: Float[Array, " n"]) -> Float[Array, "n ..."]:
    return jax.vmap(signal)(times if signal.declares_jumps else as_time(times))


def instants(fractions: Fractions, t_start: Any, t_final: Any) -> Float[Array, " n"]:
    """Fractions of the time from `t_start` to `t_final` as times; 1 is `t_final` to the last bit."""
    # A signal is undefined even a rounding error beyond its end, and so is an adaptive integrator's solution.
    xp, fractions, t_start, t_final = in_library(fractions, t_start, t_final)
    # They go on at 1: the time of an event there follows from the slopes of inputs by it.
    duration = t_final - t_start
    return jax_array(xp.where(fractions < 1, t_start + fractions * duration, t_final + (fractions - 1) * duration))


@final
class Parametrised(AbstractSignal):
    """A function of time and parameters; see `signal`. A parameter's name is its place: `inputs.force.p.amplitude`."""

    function: OwnFunction = eqx.field(static=True)
    p: dict[str, Any]

    def __init__(self, function: Callable[[Any, Any], Any], parameters: dict[str, Any]):
        if not takes(function, "t", "p"):
            raise ProblemError(
                "signal: expected a function of time and parameters, such as lambda t, p: p.rate * t; "
                f"received {type(function).__name__} {function!r}."
            )
        self.p = {name: _parameter(name, value) for name, value in parameters.items()}
        over = {name: one.over(0.0, 1.0) if isinstance(one, AbstractSignal) else one for name, one in self.p.items()}
        self.function = OwnFunction("The function of a signal", partial(_value, function), (0.0, over))

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        return self.function(t, self.p)


def _value(function: Callable[[Any, Any], Any], t: Any, parameters: dict[str, Any]) -> Float[Array, "..."]:
    return jnp.asarray(function(t, SimpleNamespace(**parameters)), dtype=float)


def signal(function: Callable[[Any, Any], Any], /, **parameters: Any) -> Parametrised:
    """The signal `function(t, p)`, where each parameter is an attribute of `p`.

    A parameter is a number or an array, a distribution, a `Decision` or another signal, which is called, `p.gust(t)` (a
    trajectory fills the time grid): `signal(lambda t, p: p.amplitude * jnp.sin(p.frequency * t), amplitude=Normal(1.0,
    0.1), frequency=3.0)`. The function is written with `jax.numpy`, for one instant `t` in seconds. Uncertain
    coefficients of given functions of time also make a random process; `RandomProcess` makes one from its covariance.

    The function is traced here, once: to change its code, make the signal again.

    Raises `ProblemError` if `function` is not a function of both, or raises, and for a parameter of any other kind.
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


class AbstractTrajectory(AbstractSignal):
    """A signal that spans the time grid of its problem: a free final time only scales it.

    It is a function of the fraction of the duration, from 0 at the start to 1 at the end; its derivatives are with
    respect to time, in seconds. When called by itself it lasts one second. `curve_fields` names the fields in which the
    curve is affine, to which a solution of a coarser problem can be refitted.
    """

    declares_jumps: ClassVar[bool] = True
    curve_fields: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def values(self, fractions: Fractions, duration: Any = 1.0, order: int = 0) -> Float[Array, "n ..."]:
        """The time derivative of order `order` (0: the value) at fractions of the duration (s): shape (n, ...)."""

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, ...]:
        """The shape of one value: `()` for a number, `(n,)` for n joints."""

    @property
    def derivatives(self) -> float:
        """How many time derivatives it has whatever its numbers are; any number by default."""
        return np.inf

    def breaks(self) -> Float[np.ndarray, " ends"]:
        """The fractions at which the smooth pieces of a realised trajectory begin and end; one piece by default."""
        return np.array([0.0, 1.0])

    def derivative(self, order: int = 1) -> "Derivative":
        """The time derivative as a trajectory of its own. Raises `ProblemError` for a negative order."""
        if isinstance(order, bool) or not isinstance(order, int) or order < 0:
            raise ProblemError(f"derivative: expected an order of 0, 1, 2, ...; received {order!r}.")
        return Derivative(self, order)

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        return self.values(jnp.asarray(t)[None])[0]

    @override
    def over(self, t_start: Any, t_final: Any) -> AbstractSignal:
        return _Stretched(self, t_start, t_final)

    @override
    def sampled(self, fractions: Fractions, t_start: Any, t_final: Any) -> Float[Array, "n ..."]:
        """As for any signal; at fixed fractions, whatever depends on these alone is computed once."""
        return self.values(fractions, t_final - t_start)


@final
class Derivative(AbstractTrajectory):
    """A time derivative of a trajectory; see `AbstractTrajectory.derivative`."""

    trajectory: AbstractTrajectory
    order: int = eqx.field(static=True)

    @override
    def values(self, fractions: Fractions, duration: Any = 1.0, order: int = 0) -> Float[Array, "n ..."]:
        return self.trajectory.values(fractions, duration, self.order + order)

    @property
    @override
    def shape(self) -> tuple[int, ...]:
        return self.trajectory.shape


@final
class Stack(AbstractTrajectory):
    """Scalar trajectories side by side: one trajectory of several joints."""

    parts: tuple[AbstractTrajectory, ...]

    @property
    @override
    def derivatives(self) -> float:
        return min(part.derivatives for part in self.parts)

    @override
    def values(self, fractions: Fractions, duration: Any = 1.0, order: int = 0) -> Float[Array, "n parts"]:
        xp, parts = in_library([part.values(fractions, duration, order) for part in self.parts])
        return jax_array(xp.stack(parts, axis=-1))

    @property
    @override
    def shape(self) -> tuple[int, ...]:
        return (len(self.parts),)


@final
class _Stretched(AbstractSignal):
    """A trajectory stretched between two times."""

    trajectory: AbstractTrajectory
    t_start: Any
    t_final: Any

    @override
    def over(self, t_start: Any, t_final: Any) -> "_Stretched":
        return self

    @override
    def __call__(self, t: Float[Array, ""] | float) -> Float[Array, "..."]:
        duration = self.t_final - self.t_start
        return self.trajectory.values(jax_array((t - self.t_start) / duration)[None], duration)[0]


def as_array(number: Any) -> Float[Array, "..."]:
    """A realised number, or a sequence of them, as an array."""
    if isinstance(number, list | tuple):
        xp, *entries = in_library(*(as_array(one) for one in number))
        return jax_array(xp.stack(entries))
    return jax_array(number, float)


def conditions(kind: str, where: str, values: Any, shape: tuple[int, ...]) -> tuple[Any, ...]:
    """Conditions at one end, `(value, velocity, acceleration)` or the first of them, each of the trajectory's shape.

    Zero stands for zeros of any shape. Raises `ProblemError` for more than three or for other shapes.
    """
    values = tuple(values) if isinstance(values, list | tuple) else (values,)
    if len(values) > 3:
        raise ProblemError(
            f"{kind}: expected at the {where} a value, a velocity and an acceleration, or the first one or two of "
            f"them; received {len(values)} conditions."
        )
    stored = []
    for number, name in zip(values, ("value", "velocity", "acceleration"), strict=False):
        is_zero = isinstance(number, int | float) and number == 0
        if realised_shape(number) != shape and not is_zero:
            raise ProblemError(
                f"{kind}: expected a {name} of shape {shape} at the {where}, that of its control points; "
                f"received shape {realised_shape(number)}."
            )
        stored.append(np.zeros(shape) if is_zero else stored_numbers(f"{kind}: {name} at the {where}", number))
    return tuple(stored)


@final
class WhiteNoise(AbstractSignal):
    """White noise `w` of mean zero, `E[w(t) w(s)] = intensity δ(t - s)`: an input of a problem, or a sensor's noise.

    - `intensity`: in the unit of the signal squared times a second, the two-sided power spectral density per hertz: a
      number, a distribution or a `Decision`, or several, whose noises are independent.

    A problem carries the covariance of the states beside each realisation, by its differential equation: no germ
    variables. By itself the signal is its mean, zero.

    Raises `ProblemError` for an intensity that is, or may be, negative.
    """

    intensity: Any

    def __init__(self, intensity: Any):
        self.intensity = stored_numbers("WhiteNoise: intensity", intensity)
        least = lowest(self.intensity)
        if least is not None and least < 0:
            raise refusal("WhiteNoise: intensity", "no negative number", intensity)

    @property
    def covariance(self) -> Float[Array, " n"]:
        """The intensities, side by side."""
        return jnp.ravel(as_array(self.intensity))

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        del t
        return jnp.zeros(realised_shape(self.intensity))
