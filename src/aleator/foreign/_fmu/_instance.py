"""The compiled code of an FMU, loaded by FMPy, and its instances, whatever their version of FMI."""

import copy
import functools
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import chdir, suppress
from ctypes import byref, c_double
from typing import Any

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError, SimulationError

# What an FMU said last: FMPy's logger is one for the whole process. Each message is a line at most.
_HEARD: deque[tuple[int, str]] = deque(maxlen=50)
_WARNING, _DISCARD, _FATAL = 1, 2, 4
_TERMINATED = 3  # of FMI 2's kinds of status
# Of its messages, so many characters are kept in an error.
_LONGEST = 300
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


class Loaded:
    """The FMU `name` with its library loaded, from its unpacked `folder`, for model exchange or co-simulation.

    Raises `ProblemError` if it cannot be loaded.
    """

    def __init__(self, name: str, folder: str, is_exchange: bool):
        import fmpy
        from fmpy import fmi1, fmi2, fmi3

        description: Any = fmpy.read_model_description(folder, validate=False)
        self.name, self.version, self.is_exchange = name, int(description.fmiVersion[0]), is_exchange
        interface = description.modelExchange if self.is_exchange else description.coSimulation
        self.steps_are_reported = bool(getattr(interface, "needsCompletedIntegratorStep", False))
        self.is_alone = bool(interface.canBeInstantiatedOnlyOncePerProcess)
        self.variables: dict[str, Any] = {variable.name: variable for variable in description.modelVariables}
        self.states = len(description.derivatives) if self.is_exchange else 0
        self.indicators = int(description.numberOfEventIndicators)
        self.failure: Any = fmi1.FMICallException
        self.is_broken = False  # for good, by what FMI calls a fatal error
        model, slave = {2: (fmi2.FMU2Model, fmi2.FMU2Slave), 3: (fmi3.FMU3Model, fmi3.FMU3Slave)}[self.version]
        what = {"guid": description.guid, "modelIdentifier": interface.modelIdentifier, "unzipDirectory": folder}
        try:
            with chdir("."):  # FMPy changes the folder, and leaves it so if the library cannot be loaded
                self.prototype: Any = (model if is_exchange else slave)(instanceName=name, **what)
        except Exception as error:
            text = " ".join(str(error).split())[:_LONGEST].rstrip(".")
            raise ProblemError(f"FMU '{name}': its library cannot be loaded: {text}.") from error

    def references(self, names: Sequence[str]) -> list[int]:
        """By which the FMU knows variables."""
        return [self.variables[name].valueReference for name in names]


class Instance:
    """A new instance of an FMU, started at a time with values of variables by name.

    `next_event`: the time of the next event that it knows of, inf if there is none. Whatever is asked of it raises
    `SimulationError` if the FMU fails, with what it said.
    """

    def __init__(self, loaded: Loaded, values: Mapping[str, Any], t: float, tolerance: float):
        self.name, self.loaded, self._fmu = loaded.name, loaded, copy.copy(loaded.prototype)
        self._time: float | None = None  # until it is initialised
        self.next_event = np.inf
        if loaded.is_broken:
            raise SimulationError(
                f"FMU '{loaded.name}' failed fatally before: it cannot be used in this process again."
            )
        _HEARD.clear()
        callbacks = {"callbacks": _callbacks()} if loaded.version == 2 else {"logMessage": _hear}
        try:
            self._fmu.instantiate(loggingOn=True, **callbacks)
        except Exception as error:
            raise SimulationError(f"FMU '{loaded.name}' cannot be instantiated{_said()}.") from error
        try:
            self._start(values, {"tolerance": tolerance, "startTime": t})
        except BaseException:
            self.free()
            raise
        self._time = t

    def free(self) -> None:
        """Give it back. Its library stays loaded for others."""
        if not self.loaded.is_broken:
            getattr(self._fmu, f"fmi{self.loaded.version}FreeInstance")(self._fmu.component)

    def set(self, references: Sequence[int], values: Float[np.ndarray, " n"]) -> None:
        """Set real variables."""
        if references:
            self._call("setFloat64", references, values.tolist())

    def get(self, references: Sequence[int]) -> Float[np.ndarray, " n"]:
        """Values of real variables."""
        return np.array(self._call("getFloat64", references) if references else [], dtype=float)

    # --- Model exchange ---

    def at(self, t: float, x: Float[np.ndarray, " n"]) -> None:
        """Go to a time and a state."""
        self._time = t
        self._call("setTime", t)
        if len(x):
            self._call("setContinuousStates", (c_double * len(x))(*x), len(x))

    def state(self) -> Float[np.ndarray, " n"]:
        """The continuous states."""
        return self._vector("getContinuousStates", self.loaded.states)

    def rates(self) -> Float[np.ndarray, " n"]:
        """The time derivatives of the states."""
        return self._vector("getContinuousStateDerivatives", self.loaded.states)

    def nominals(self) -> Float[np.ndarray, " n"]:
        """The usual sizes of the states; 1 where the FMU tells none."""
        sizes = np.abs(self._vector("getNominalsOfContinuousStates", self.loaded.states))
        return np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0)

    def indicators(self) -> Float[np.ndarray, " m"]:
        """The event indicators, which change their signs at events."""
        return self._vector("getEventIndicators", self.loaded.indicators)

    def asks_for_event(self) -> bool:
        """Tell the FMU that a step of the integrator is over, if it wants to know; whether it asks for an event."""
        asks, ends = self._call("completedIntegratorStep") if self.loaded.steps_are_reported else (False, False)
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

    # --- Co-simulation ---

    def step(self, t: float, length: float) -> None:
        """Let the FMU step by itself, to the end of the step."""
        self._time = t + length
        done = self._call("doStep", t, length)
        if self.loaded.version == 3:
            _, ends, early, reached = done
            if ends or early:
                self._time = reached
                raise self._ended()

    # --- Inside ---

    def _start(self, values: Mapping[str, Any], experiment: Mapping[str, Any]) -> None:
        if self.loaded.version == 2:
            self._call("setupExperiment", **experiment)
        for name, value in values.items():
            variable = self.loaded.variables[name]
            kind = "Int64" if variable.type == "Enumeration" else variable.type
            self._call(f"set{kind}", [variable.valueReference], [value])
        self._call("enterInitializationMode", **(experiment if self.loaded.version == 3 else {}))
        self._call("exitInitializationMode")
        if self.loaded.is_exchange:
            self._update()
            self._call("enterContinuousTimeMode")

    def _call(self, name: str, *arguments: Any, **named: Any) -> Any:
        """Call a function of the FMU, by its name in FMI 3."""
        name = _IN_FMI_2.get(name, name) if self.loaded.version == 2 else name
        try:
            return getattr(self._fmu, name)(*arguments, **named)
        except self.loaded.failure as error:
            if name == "doStep" and error.status == _DISCARD and self._fmu.getBooleanStatus(_TERMINATED):
                raise self._ended() from error
            self.loaded.is_broken = self.loaded.is_broken or error.status == _FATAL
            label = str(error).rpartition("(")[2].rstrip(").")
            raise SimulationError(
                f"FMU '{self.name}' failed {self._when()}{_said()} ({error.function}: {label})."
            ) from error
        except OSError as error:
            raise SimulationError(f"FMU '{self.name}' broke down {self._when()}: {error}.") from error

    def _vector(self, name: str, size: int) -> Float[np.ndarray, " n"]:
        buffer = (c_double * size)()
        if size:
            self._call(name, buffer, size)
        return np.array(buffer, dtype=float)

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
