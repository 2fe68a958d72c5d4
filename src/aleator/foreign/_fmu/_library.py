"""The compiled code of an FMU, loaded by FMPy, whatever its version of FMI: runs, and values of its equations."""

import copy
import functools
import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import chdir, closing, suppress
from ctypes import byref, c_double
from itertools import pairwise
from typing import Any, TypeAlias, final

import numpy as np
from jaxtyping import Float
from scipy.integrate import LSODA

from aleator._core.errors import ProblemError, SimulationError

# FMUs share what is static in their libraries, and FMPy's logger is one for the whole process.
_LOCK = threading.RLock()
# What an FMU said last. Of it, so many characters are kept in an error.
_HEARD: deque[tuple[int, str]] = deque(maxlen=50)
_LONGEST = 300
_WARNING, _FATAL = 1, 4
# What FMI 3 renamed.
_IN_FMI_2 = {
    "getFloat64": "getReal",
    "setFloat64": "setReal",
    "setInt64": "setInteger",
    "getContinuousStateDerivatives": "getDerivatives",
    "updateDiscreteStates": "newDiscreteStates",
}
# Most updates of the discrete states at one event.
_MOST_UPDATES = 1000
# As many instances are kept for evaluations of the equations.
_KEPT = 256
# The initial state is determined within this tolerance, if the FMU has to iterate for it.
_TOLERANCE = 1e-10
# How finely the time of an event is determined, as a part of the step in which it happens.
_FINE = 1e-13

Found: TypeAlias = tuple[Float[np.ndarray, "points ..."], str]
"""Values at some points, NaN where the FMU fails, and what its first failure was."""


@final
class Library:
    """The FMU `name`, loaded from an unpacked `folder`, for model exchange or co-simulation.

    `settings`: values of variables of any type, for all runs. Variables are told by their names. Raises `ProblemError`
    if it cannot be loaded.
    """

    def __init__(self, name: str, folder: str, is_exchange: bool, settings: Mapping[str, Any]):
        import fmpy
        from fmpy import fmi2, fmi3

        description: Any = fmpy.read_model_description(folder, validate=False)
        interface = description.modelExchange if is_exchange else description.coSimulation
        self.name, self.is_exchange, self._settings = name, is_exchange, settings
        self.version = int(description.fmiVersion[0])
        self.steps_are_reported = bool(getattr(interface, "needsCompletedIntegratorStep", False))
        self.variables: dict[str, Any] = {variable.name: variable for variable in description.modelVariables}
        states = [rate.variable.derivative for rate in description.derivatives if is_exchange]
        self.states, self.sizes = len(states), usual_sizes(states)
        self.indicators = int(description.numberOfEventIndicators)
        self.is_broken = False  # for good, by what FMI calls a fatal error
        self._is_alone = interface.canBeInstantiatedOnlyOncePerProcess
        # Parameters are set before an FMU starts: an instance has its own.
        self._instance = functools.lru_cache(_KEPT)(self._started)
        model, slave = {2: (fmi2.FMU2Model, fmi2.FMU2Slave), 3: (fmi3.FMU3Model, fmi3.FMU3Slave)}[self.version]
        what = {"guid": description.guid, "modelIdentifier": interface.modelIdentifier, "unzipDirectory": folder}
        try:
            with _LOCK, chdir("."):  # FMPy changes the folder, and leaves it so if the library cannot be loaded
                self.prototype: Any = (model if is_exchange else slave)(instanceName=name, **what)
        except Exception as error:
            text = " ".join(str(error).split())[:_LONGEST].rstrip(".")
            raise ProblemError(f"FMU '{name}': its library cannot be loaded: {text}.") from error

    def ask(self, method: str, *arguments: Any, where: str = "") -> Any:
        """What a method returns. `where` it is asked is told by processes that end."""
        del where
        with _LOCK:
            return getattr(self, method)(*arguments)

    def run(
        self,
        start: Mapping[str, float],
        outputs: Sequence[str],
        times: Float[np.ndarray, " instants"],
        inputs: Mapping[str, Float[np.ndarray, " instants"]],
        tolerance: float,
    ) -> Float[np.ndarray, "instants outputs"]:
        """The outputs at all instants, from values at the start, with inputs that are straight between instants.

        Raises `SimulationError` if the run fails.
        """
        driven, read = self._references(inputs), self._references(outputs)
        first = [(name, float(values[0])) for name, values in inputs.items()]
        with closing(self._started([*start.items(), *first], float(times[0]), tolerance)) as instance:
            if inputs:
                instance.drive = lambda t: instance.set(driven, [np.interp(t, times, one) for one in inputs.values()])
            course = _integrated(instance, times, tolerance) if self.is_exchange else _stepped(instance, times)
            return np.stack([instance.get(read) for _ in course])

    def first(self, given: Mapping[str, float], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray, bool]:
        """How the equations begin, for given values of some variables.

        The states, the values of variables by their names, and whether an event is known by its time.
        """
        with closing(self._started(given.items())) as instance:
            values = instance.get(self._references(names))
            return instance.vector("ContinuousStates"), values, bool(np.isfinite(instance.next_event))

    def rates(self, parameters: list[str], inputs: list[str], outputs: list[str], points: np.ndarray) -> Found:
        """Rates of the states, then outputs, at points (time, states, inputs, parameters), shape (points, m)."""
        driven, read = self._references(inputs), self._references(outputs)
        n = 1 + self.states
        r = n + len(driven)

        def values(point: np.ndarray) -> np.ndarray:
            instance = self._instance(tuple(zip(parameters, point[r:].tolist(), strict=True)))
            instance.at(point[0], point[1:])
            instance.set(driven, point[n:r].tolist())
            return np.concatenate([instance.vector("ContinuousStateDerivatives"), instance.get(read)])

        return each(values, points, (self.states + len(read),))

    def _references(self, names: Iterable[str]) -> list[int]:
        return [self.variables[name].valueReference for name in names]

    def _started(self, values: Iterable[tuple[str, Any]], t: float = 0.0, tolerance: float = _TOLERANCE) -> "Instance":
        """A fresh instance, so that no run depends on the runs before it."""
        if self._is_alone:
            self._instance.cache_clear()
        return Instance(self, {**self._settings, **dict(values)}, t, tolerance)


def usual_sizes(variables: Iterable[Any]) -> Float[np.ndarray, " n"]:
    """The usual sizes that real variables declare; 1 for others."""
    return np.array([abs(float(variable.nominal or 1.0)) or 1.0 for variable in variables])


def each(
    function: Callable[[np.ndarray], np.ndarray], points: Float[np.ndarray, "points m"], shape: tuple[int, ...]
) -> Found:
    """Values of a function at each point that is finite."""
    values, reason = np.full((len(points), *shape), np.nan), ""
    for index in np.flatnonzero(np.isfinite(points).all(axis=1)):
        try:
            values[index] = function(points[index])
        except SimulationError as error:
            reason = reason or str(error)
    return values, reason


# --- Instances --------------------------------------------------------------------------------------------------------


@final
class Instance:
    """A new instance of an FMU, started at a time with values of variables by name.

    `drive`: sets the inputs to their values at a time, if they have any. `next_event`: the time of the next event that
    it knows of, inf if there is none. Whatever is asked of it raises `SimulationError` if the FMU fails, with what it
    said. It is given back when it is closed, or not used any more.
    """

    def __init__(self, library: Library, values: Mapping[str, Any], t: float, tolerance: float):
        self.library, self.name, self._fmu = library, library.name, copy.copy(library.prototype)
        self._time: float | None = None  # until it is initialised
        self.drive: Callable[[float], None] | None = None
        self.next_event = np.inf
        if library.is_broken:
            raise SimulationError(f"FMU '{self.name}' failed fatally before: it cannot be used in this process again.")
        _HEARD.clear()
        callbacks = {"callbacks": _callbacks()} if library.version == 2 else {"logMessage": _hear}
        try:
            self._fmu.instantiate(loggingOn=True, **callbacks)
        except Exception as error:
            raise SimulationError(f"FMU '{self.name}' cannot be instantiated{_said()}.") from error
        try:
            self._start(values, {"tolerance": tolerance, "startTime": t})
        except BaseException:
            self.close()
            raise
        self._time = t

    def _start(self, values: Mapping[str, Any], experiment: Mapping[str, Any]) -> None:
        if self.library.version == 2:
            self._call("setupExperiment", **experiment)
        for name, value in values.items():
            variable = self.library.variables[name]
            kind = "Int64" if variable.type == "Enumeration" else variable.type
            self._call(f"set{kind}", [variable.valueReference], [value])
        self._call("enterInitializationMode", **(experiment if self.library.version == 3 else {}))
        self._call("exitInitializationMode")
        if self.library.is_exchange:
            self._update()
            self._call("enterContinuousTimeMode")

    def close(self) -> None:
        """Give it back. Its library stays loaded for others."""
        if self._fmu.component and not self.library.is_broken:
            getattr(self._fmu, f"fmi{self.library.version}FreeInstance")(self._fmu.component)
        self._fmu.component = None

    __del__ = close

    def set(self, references: Sequence[int], values: Sequence[float]) -> None:
        """Set real variables."""
        if references:
            self._call("setFloat64", references, values)

    def get(self, references: Sequence[int]) -> Float[np.ndarray, " n"]:
        """Values of real variables."""
        return np.array(self._call("getFloat64", references) if references else [], dtype=float)

    def vector(self, of: str) -> Float[np.ndarray, " n"]:
        """All "ContinuousStates" or "ContinuousStateDerivatives", or all "EventIndicators"."""
        size = self.library.indicators if of == "EventIndicators" else self.library.states
        buffer = (c_double * size)()
        if size:
            self._call(f"get{of}", buffer, size)
        return np.array(buffer, dtype=float)

    def at(self, t: float, x: Float[np.ndarray, " n"]) -> None:
        """Go to a time, with its inputs, and a state of model exchange, which further numbers may follow."""
        self._time = float(t)
        self._call("setTime", self._time)
        if n := self.library.states:
            self._call("setContinuousStates", (c_double * n)(*x[:n]), n)
        if self.drive is not None:
            self.drive(t)

    def asks_for_event(self) -> bool:
        """Tell the FMU that a step of the integrator is over, if it wants to know; whether it asks for an event."""
        asks, ends = self._call("completedIntegratorStep") if self.library.steps_are_reported else (False, False)
        if ends:
            raise self._ended()
        return bool(asks)

    def handle_event(self) -> None:
        """Let the FMU handle an event, at which its states may jump."""
        self._call("enterEventMode")
        self._update()
        self._call("enterContinuousTimeMode")
        if self.next_event <= (self._time or 0.0):
            raise SimulationError(f"FMU '{self.name}' asks for one more event {self._when()}, without end.")

    def _update(self) -> None:
        """Update the discrete states until they stay as they are."""
        for _ in range(_MOST_UPDATES):
            again, ends, _, _, is_timed, next_event = self._call("updateDiscreteStates")
            if ends:
                raise self._ended()
            if not again:
                self.next_event = float(next_event) if is_timed else np.inf
                return
        raise SimulationError(f"FMU '{self.name}' does not find its state after an event {self._when()}{_said()}.")

    def step(self, t: float, length: float) -> None:
        """Let an FMU of co-simulation step by itself."""
        self._time = t + length
        done = self._call("doStep", t, length)
        if self.library.version == 3:
            _, ends, early, reached = done
            if ends or early:
                self._time = reached
                raise self._ended()

    def _call(self, name: str, *arguments: Any, **named: Any) -> Any:
        """Call a function of the FMU, by its name in FMI 3."""
        from fmpy.fmi1 import FMICallException

        name = _IN_FMI_2.get(name, name) if self.library.version == 2 else name
        try:
            return getattr(self._fmu, name)(*arguments, **named)
        except FMICallException as error:
            self.library.is_broken = self.library.is_broken or error.status == _FATAL
            label = str(error).rpartition("(")[2].rstrip(").")
            raise SimulationError(
                f"FMU '{self.name}' failed {self._when()}{_said()} ({error.function}: {label})."
            ) from error
        except OSError as error:
            raise SimulationError(f"FMU '{self.name}' broke down {self._when()}: {error}.") from error

    def _when(self) -> str:
        return "to initialise" if self._time is None else f"at t = {self._time:.6g} s"

    def _ended(self) -> SimulationError:
        return SimulationError(f"FMU '{self.name}' ended the simulation {self._when()}{_said()}.")


def _hear(*arguments: Any) -> None:
    """The logger of FMI 2 and 3, whose last three arguments are the status, the category and the message."""
    status, _, message = arguments[-3:]
    if text := " ".join((message or b"").decode("utf-8", "replace").split()).rstrip("."):
        _HEARD.append((status, text))


@functools.cache
def _callbacks() -> Any:
    """What FMUs of version 2 call back: made once and never collected, because FMPy's proxy keeps its address."""
    from fmpy import calloc, fmi2, free

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(_hear)
    callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
    callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
    with suppress(ImportError, OSError, AttributeError):  # not built for every machine: messages lack their values
        from fmpy.logging import addLoggerProxy

        addLoggerProxy(byref(callbacks))
    return callbacks


def _said() -> str:
    """What the FMU said last, its warnings and errors before all else, after a colon; empty if nothing."""
    serious = [text for status, text in _HEARD if status >= _WARNING]
    texts = dict.fromkeys(serious or [text for _, text in _HEARD])
    return f": {' | '.join(list(texts)[-3:])[-_LONGEST:]}" if texts else ""


# --- Runs -------------------------------------------------------------------------------------------------------------


def _stepped(instance: Instance, times: Float[np.ndarray, " instants"]) -> Iterator[None]:
    """Take a co-simulation to each instant. During a step, each input has its value in the middle of it."""
    yield
    for t, after in pairwise(times.tolist()):
        if instance.drive is not None:
            instance.drive((t + after) / 2)
        instance.step(t, after - t)
        yield


def _integrated(instance: Instance, times: Float[np.ndarray, " instants"], tolerance: float) -> Iterator[None]:
    """Take a model exchange to each instant, before an event that falls on it. Inputs are straight between instants.

    By LSODA (Petzold 1983), which chooses between methods for stiff equations and others. FMPy's own loop is not used:
    its BDF is ten times less accurate at a tolerance, it loses what an FMU says of its failure, and where an FMU ends
    the simulation it returns what there is.
    """
    n, t, waiting = instance.library.states, float(times[0]), deque(times[1:].tolist())

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        instance.at(t, y)
        found = instance.vector("ContinuousStateDerivatives") if n else np.zeros(1)
        if not np.isfinite(found).all():  # LSODA would not notice
            raise SimulationError(f"FMU '{instance.name}': the rate of a state is not finite at t = {t:.6g} s.")
        return found

    def signs(t: float, y: np.ndarray) -> np.ndarray:
        instance.at(t, y)
        return instance.vector("EventIndicators")

    instance.at(t, instance.vector("ContinuousStates"))
    yield
    # Events are looked for between the integrator's steps.
    longest = float(np.min(np.diff(times))) if instance.library.indicators else np.inf
    is_event = False
    while waiting:
        if is_event or t >= instance.next_event:
            instance.handle_event()
        y = instance.vector("ContinuousStates") if n else np.zeros(1)  # integrators need one number at least
        before, is_event = signs(t, y), False
        # The rates have kinks where the slopes of inputs change.
        bound = min(waiting[-1 if instance.drive is None else 0], instance.next_event)
        atol: Any = tolerance * instance.library.sizes if n else 1.0
        solver: Any = LSODA(rates, t, y, bound, rtol=tolerance, atol=atol, max_step=min(longest, bound - t))
        while solver.status == "running" and not is_event:
            began = t
            with warnings.catch_warnings(action="ignore"):  # what it says of a failure
                solver.step()
            if solver.status == "failed":
                raise SimulationError(
                    f"FMU '{instance.name}': the integrator stops at t = {solver.t:.6g} s, where no step is short "
                    f"enough for a tolerance of {tolerance:g}."
                )
            t, y, curve = float(solver.t), solver.y.copy(), solver.dense_output()
            after = signs(t, y)
            if is_event := _has_changed(before, after):
                low, width = began, _FINE * (t - began)
                while t - low > width and low < (middle := (low + t) / 2) < t:
                    is_late = _has_changed(before, signs(middle, curve(middle)))
                    low, t = (low, middle) if is_late else (middle, t)
                y = curve(t)
            while waiting and waiting[0] <= t:
                instant = waiting.popleft()
                instance.at(instant, y if instant == t else curve(instant))
                yield
            instance.at(t, y)
            is_event, before = instance.asks_for_event() or is_event, after


def _has_changed(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether an event indicator has passed zero."""
    return bool(np.any((before < 0) & (after >= 0) | (before > 0) & (after <= 0)))
