"""The motion of an FMU over a grid: model exchange integrated from event to event, co-simulation by its own steps."""

import itertools
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.integrate
from jaxtyping import Float

from aleator._core.errors import SimulationError
from aleator.foreign._fmu._description import Variable
from aleator.foreign._fmu._library import Instance

# How finely the time of an event is determined, as a part of the step in which it happens.
_FINE = 1e-13


class Sampled(NamedTuple):
    """Names and values, shape (instants, inputs), of inputs at instants."""

    names: list[str]
    times: Float[np.ndarray, " instants"]
    values: Float[np.ndarray, "instants inputs"]


class Inputs(NamedTuple):
    """Values of inputs at instants, shape (instants, inputs)."""

    variables: list[Variable]
    times: Float[np.ndarray, " instants"]
    values: Float[np.ndarray, "instants inputs"]

    @property
    def references(self) -> list[int]:
        """By which the FMU knows them."""
        return [one.valueReference for one in self.variables]

    def at(self, t: float) -> Float[np.ndarray, " inputs"]:
        """The values at a time."""
        return np.array([np.interp(t, self.times, column) for column in self.values.T], dtype=float)

    @property
    def first(self) -> dict[Variable, float]:
        """The values at the start, by variable."""
        return dict(zip(self.variables, self.values[0].tolist(), strict=True))

    def apply(self, instance: Instance, t: float) -> None:
        """Set the values at a time."""
        if self.references:
            instance.set(self.references, self.at(t))

    def kink_after(self, t: float) -> float:
        """The next instant at which their slopes change; inf without inputs."""
        later = self.times[self.times > t]
        return float(later[0]) if self.references and len(later) else np.inf


def stepped(
    instance: Instance, outputs: list[int], inputs: Inputs, times: Float[np.ndarray, " instants"]
) -> Float[np.ndarray, "instants outputs"]:
    """The outputs at all instants. During a step, each input has its value in the middle of it."""
    inputs.apply(instance, float(times[0]))
    found = [instance.get(outputs)]
    for now, then in itertools.pairwise(times):
        inputs.apply(instance, float(now + then) / 2)
        instance.step(float(now), float(then - now))
        found.append(instance.get(outputs))
    return np.stack(found)


class EventError(Exception):
    """An event happened where none is allowed."""


class Motion(NamedTuple):
    """What is integrated, `y`, of which the first `states` numbers are the FMU's.

    - `rates`: `(t, y) -> dy/dt`; `observe`: `(t, y) -> recorded`; `apply`: sets the inputs at a time;
    - `kink_after`: the next time, after one, at which the rates have a kink;
    - `rtol`, `atol`: tolerances of the integrator; `through_events`: whether events are handled, or raise `EventError`.
    """

    states: int
    rates: Callable[[float, np.ndarray], np.ndarray]
    observe: Callable[[float, np.ndarray], np.ndarray]
    apply: Callable[[float], None]
    kink_after: Callable[[float], float]
    rtol: float
    atol: Any
    through_events: bool


def integrated(
    instance: Instance, motion: Motion, start: Float[np.ndarray, " n"], times: Float[np.ndarray, " instants"]
) -> np.ndarray:
    """What is observed at all instants, with an instant on the first axis; before an event where one falls on it.

    By LSODA (Petzold 1983), which chooses between methods for stiff equations and others. Events are looked for between
    the integrator's steps, which are no longer than the grid's where the FMU has event indicators.

    Raises `SimulationError` if the FMU or the integrator fails, and `EventError`.
    """
    t, y, end = float(times[0]), start, float(times[-1])
    found = [motion.observe(t, y)]
    next_event = instance.first.next_event
    signs = _Signs(instance, motion)
    longest = float(np.min(np.diff(times))) if len(signs.at(t, y)) else np.inf
    while t < end:
        if t >= next_event:
            y, next_event = _after_event(instance, motion, t, y)
        bound = min(end, next_event, motion.kink_after(t))
        before, had = signs.at(t, y), False
        solver = _solver(motion, t, y, bound, longest)
        while solver.status == "running":
            t_before = t
            t, y, curve = _one_step(solver, motion)
            after = signs.at(t, y)
            if signs.changed(before, after):
                t, y = signs.change(t_before, t, curve, before)
                had = True
            for instant in times[len(found) :]:
                if instant > t:
                    break
                found.append(motion.observe(float(instant), y if instant == t else curve(instant)))
            motion.apply(t)
            instance.at(t, y[: motion.states])
            had = instance.step_is_over() or had
            if had:
                break
            before = after
        if had:
            y, next_event = _after_event(instance, motion, t, y)
    return np.stack(found)


def _solver(motion: Motion, t: float, y: np.ndarray, bound: float, longest: float) -> Any:
    return scipy.integrate.LSODA(
        _finite(motion.rates), t, y, bound, rtol=motion.rtol, atol=motion.atol, max_step=min(longest, bound - t)
    )


def _finite(rates: Callable[[float, np.ndarray], np.ndarray]) -> Callable[[float, np.ndarray], np.ndarray]:
    """Rates that are refused where they are not finite, which LSODA would not notice."""

    def checked(t: float, y: np.ndarray) -> np.ndarray:
        found = rates(t, y)
        if not np.isfinite(found).all():
            raise SimulationError(f"the rate of a state is not finite at t = {t:.6g} s")
        return found

    return checked


def _one_step(solver: Any, motion: Motion) -> tuple[float, np.ndarray, Any]:
    """The time and state after a step, and the curve that leads there."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what it says of a failure
        solver.step()
    if solver.status == "failed":
        raise SimulationError(
            f"the integrator stops at t = {solver.t:.6g} s, where no step is short enough for rtol {motion.rtol:g}"
        )
    return float(solver.t), solver.y.copy(), solver.dense_output()


def _after_event(instance: Instance, motion: Motion, t: float, y: np.ndarray) -> tuple[np.ndarray, float]:
    if not motion.through_events:
        raise EventError
    update = instance.event()
    if update.next_event <= t:
        raise SimulationError(f"its next event would be at t = {update.next_event:.6g} s, which is over at {t:.6g} s")
    return (instance.state() if motion.states else y), update.next_event


def motion_of(
    instance: Instance, outputs: list[int], inputs: Inputs, tolerance: float
) -> tuple[Motion, Float[np.ndarray, " n"]]:
    """The motion of an instance through its events, and the state in which it begins."""
    first, n = instance.initial, len(instance.initial)

    def at(t: float, y: np.ndarray) -> None:
        inputs.apply(instance, t)
        instance.at(t, y[:n])

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        at(t, y)
        return instance.rates() if n else np.zeros(1)

    def observe(t: float, y: np.ndarray) -> np.ndarray:
        at(t, y)
        return instance.get(outputs)

    # Integrators need one number at least.
    start = first if n else np.zeros(1)
    atol = tolerance * instance.nominals() if n else np.ones(1)
    return Motion(
        n, rates, observe, lambda t: inputs.apply(instance, t), inputs.kink_after, tolerance, atol, True
    ), start


class _Signs:
    """The signs of event indicators along a motion."""

    def __init__(self, instance: Instance, motion: Motion):
        self._instance, self._motion = instance, motion

    def at(self, t: float, y: np.ndarray) -> np.ndarray:
        """The event indicators."""
        self._motion.apply(t)
        self._instance.at(t, y[: self._motion.states])
        return self._instance.indicators()

    def changed(self, before: np.ndarray, after: np.ndarray) -> bool:
        """Whether an indicator has passed zero."""
        return bool(np.any((before < 0) & (after >= 0) | (before > 0) & (after <= 0)))

    def change(self, low: float, high: float, curve: Any, before: np.ndarray) -> tuple[float, np.ndarray]:
        """The first time and state after a change of sign, by bisection."""
        width = _FINE * (high - low)
        while high - low > width and low < (middle := (low + high) / 2) < high:
            if self.changed(before, self.at(middle, curve(middle))):
                high = middle
            else:
                low = middle
        return high, curve(high)
