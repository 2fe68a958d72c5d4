"""Runs of an FMU over a grid as a function of its parameters: outputs at all instants, and their derivatives.

Model exchange is integrated from event to event, with its sensitivities; co-simulation steps by itself.
"""

import itertools
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import scipy.integrate
from jaxtyping import Float

from aleator._core.errors import SimulationError, SimulationWarning
from aleator.foreign._fmu._derivatives import STEP, Slope, difference_jacobian, scales
from aleator.foreign._fmu._description import Variable, nominals_of, with_numbers
from aleator.foreign._fmu._equations import Equations, Place
from aleator.foreign._fmu._library import Instance, Opened

# How finely the time of an event is determined, as a part of the step in which it happens.
_FINE = 1e-13
# At as many instants of a motion, derivatives that the FMU offers are compared with differences.
_JUDGED = 5
# Differences over one step and over two may disagree by this part of the largest derivative.
_NOISY = 1e-2


class Sampled(NamedTuple):
    """Names and values, shape (instants, inputs), of inputs at instants."""

    names: list[str]
    times: Float[np.ndarray, " instants"]
    values: Float[np.ndarray, "instants inputs"]


class Inputs(NamedTuple):
    """Values of inputs at instants, shape (instants, inputs), and straight in between."""

    variables: list[Variable]
    times: Float[np.ndarray, " instants"]
    values: Float[np.ndarray, "instants inputs"]

    @property
    def references(self) -> list[int]:
        """By which the FMU knows them."""
        return [variable.valueReference for variable in self.variables]

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


def sensitivities(
    equations: Equations, inputs: Inputs, p: Float[np.ndarray, " k"], tolerance: float
) -> Float[np.ndarray, "instants outputs k"]:
    """The derivatives of the outputs by the parameters at all instants, by forward sensitivities.

    The derivatives of the states by parameters are integrated with the states: `ds/dt = f_x s + f_p` for each
    parameter, a directional derivative of the rates (Hairer, Nørsett, Wanner 1993, I.14).

    Raises `EventError` if there is an event, and `SimulationError` if the FMU or the integrator fails.
    """
    n, k = equations.n, len(p)

    def initial(p: np.ndarray) -> np.ndarray:
        return equations.instance(p).initial

    def place(t: float, y: np.ndarray) -> Place:
        return Place(t, y[:n], inputs.at(t), p)

    def slopes(t: float, y: np.ndarray) -> np.ndarray:
        """The derivatives of rates and outputs by each parameter, shape (k, n + outputs)."""
        now, by, held = place(t, y), np.eye(k), np.zeros(len(inputs.references))
        return np.stack([equations.slope(now, s, held, e) for s, e in zip(y[n:].reshape(k, n), by, strict=True)])

    def motion(rates: Callable, observe: Callable, atol: np.ndarray) -> Motion:
        return Motion(n, rates, observe, lambda t: inputs.apply(instance, t), inputs.kink_after, tolerance, atol, False)

    def of_states(t: float, y: np.ndarray) -> np.ndarray:
        return equations.values(place(t, y))[:n]

    instance, x = equations.instance(p), initial(p)
    sizes, steps = equations.nominals(p), equations.scales(p, equations.parameters)
    if equations.trusted is None:
        path = integrated(instance, motion(of_states, lambda _, y: y, tolerance * sizes), x, inputs.times)
        chosen = np.unique(np.linspace(0, len(path) - 1, _JUDGED).astype(int))
        equations.judge([place(float(inputs.times[instant]), path[instant]) for instant in chosen])
    start = difference_jacobian(initial, p, STEP * steps).value
    atol = tolerance * np.concatenate([sizes, (sizes / steps[:, None]).ravel()])
    full = motion(
        lambda t, y: np.concatenate([of_states(t, y), slopes(t, y)[:, :n].ravel()]),
        lambda t, y: slopes(t, y)[:, n:].T,
        atol,
    )
    return integrated(instance, full, np.concatenate([x, start.T.ravel()]), inputs.times)


class Runs:
    """An FMU from the start to the end of a grid, by the values of `parameters`, with chosen `outputs`: all names."""

    def __init__(self, fmu: Opened, parameters: list[str], outputs: list[str], sampled: Sampled, tolerance: float):
        variables = fmu.variables
        self._fmu, self._tolerance = fmu, tolerance
        self._parameters, self._outputs = variables.settable(parameters), variables.readable(outputs)
        self._inputs = inputs = Inputs(variables.of_inputs(sampled.names), sampled.times, sampled.values)
        self._equations = None
        if fmu.is_exchange:
            chosen = self._parameters, inputs.variables, self._outputs
            self._equations = Equations(fmu, *chosen, float(inputs.times[0]), tolerance, inputs.first)

    def outputs(self, p: Float[np.ndarray, " k"]) -> Float[np.ndarray, "instants outputs"]:
        """The outputs at all instants. Raises `SimulationError` if a run fails or an output is not finite."""
        references = [variable.valueReference for variable in self._outputs]
        inputs = self._inputs
        start = {**inputs.first, **dict(zip(self._parameters, p.tolist(), strict=True))}
        with self._explained(p), self._fmu.started(start, float(inputs.times[0]), self._tolerance) as instance:
            if self._fmu.is_exchange:
                motion, first = motion_of(instance, references, inputs, self._tolerance)
                found = integrated(instance, motion, first, inputs.times)
            else:
                found = stepped(instance, references, inputs, inputs.times)
            self._refuse_missing(found)
        return found

    def jacobian(self, p: Float[np.ndarray, " k"]) -> Float[np.ndarray, "instants outputs k"]:
        """The derivatives of the outputs by the parameters.

        For model exchange by forward sensitivities, integrated with the states. These hold up to the first event: then,
        and for co-simulation, by differences of runs.

        Warns with `SimulationWarning` where differences over one step and over two do not agree.
        """
        if self._equations is not None:
            try:
                with self._explained(p):
                    return sensitivities(self._equations, self._inputs, p, self._tolerance)
            except EventError:
                pass
            finally:
                self._equations.forget()
        found = difference_jacobian(self.outputs, p, self._steps(p))
        self._warn_of_noise(found)
        return found.value

    def hessian(self, p: Float[np.ndarray, " k"]) -> Float[np.ndarray, "instants outputs k k"]:
        """The second derivatives, by differences of the first."""
        return difference_jacobian(self.jacobian, p, self._steps(p)).value

    def _steps(self, p: np.ndarray) -> np.ndarray:
        return STEP * scales(p, nominals_of(self._parameters))

    @contextmanager
    def _explained(self, p: np.ndarray) -> Iterator[None]:
        """Add the parameters to what is said of a failure."""
        try:
            yield
        except SimulationError as error:
            text = str(error) if str(error).startswith("FMU ") else f"FMU '{self._fmu.name}': {error}."
            values = with_numbers([variable.name for variable in self._parameters], p)
            raise SimulationError(f"{text.removesuffix('.')}{values}.") from error

    def _refuse_missing(self, found: np.ndarray) -> None:
        if np.isfinite(found).all():
            return
        instant, output = np.argwhere(~np.isfinite(found))[0]
        raise SimulationError(
            f"FMU '{self._fmu.name}': output '{self._outputs[output].name}' is {found[instant, output]:g} at "
            f"t = {self._inputs.times[instant]:.6g} s"
        )

    def _warn_of_noise(self, found: Slope) -> None:
        largest = np.max(np.abs(found.value), axis=0)
        doubt = np.max(found.disagreement, axis=0) / np.where(largest > 0, largest, 1.0)
        output, parameter = np.unravel_index(np.argmax(doubt), doubt.shape)
        if doubt[output, parameter] > _NOISY:
            warnings.warn(
                f"FMU '{self._fmu.name}': the derivative of '{self._outputs[output].name}' by "
                f"'{self._parameters[parameter].name}' is unreliable: differences over two steps disagree by "
                f"{doubt[output, parameter]:.1%}. Outputs jump at times that depend on it, or the FMU's own solver is "
                "too coarse; optimise an expansion or a search without derivatives instead.",
                SimulationWarning,
                stacklevel=2,
            )
