"""An instance of an FMU whose library FMPy has loaded, whatever its version of FMI, and what it says."""

import copy
import functools
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from ctypes import byref, c_double
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Float

from aleator._core.errors import SimulationError

if TYPE_CHECKING:
    from aleator.foreign._fmu._library import Library

# What an FMU said last: FMPy's logger is one for the whole process. Of it, so many characters are kept in an error.
_HEARD: deque[tuple[int, str]] = deque(maxlen=50)
LONGEST = 300
_WARNING, _DISCARD, _FATAL = 1, 2, 4
_TERMINATED = 3  # of FMI 2's kinds of status
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


@final
class Instance:
    """A new instance of an FMU, started at a time with values of variables by name.

    `next_event`: the time of the next event that it knows of, inf if there is none. Whatever is asked of it raises
    `SimulationError` if the FMU fails, with what it said. It is given back when it is closed, or not used any more.
    """

    def __init__(self, library: "Library", values: Mapping[str, Any], t: float, tolerance: float):
        self.library, self.name, self._fmu = library, library.name, copy.copy(library.prototype)
        self._time: float | None = None  # until it is initialised
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

    def set(self, references: Sequence[int], values: Float[np.ndarray, " n"]) -> None:
        """Set real variables."""
        if references:
            self._call("setFloat64", references, values.tolist())

    def get(self, references: Sequence[int]) -> Float[np.ndarray, " n"]:
        """Values of real variables."""
        return np.array(self._call("getFloat64", references) if references else [], dtype=float)

    def vector(self, of: str) -> Float[np.ndarray, " n"]:
        """All "ContinuousStates", the "NominalsOf..." or "ContinuousStateDerivatives", or all "EventIndicators"."""
        size = self.library.indicators if of == "EventIndicators" else self.library.states
        buffer = (c_double * size)()
        if size:
            self._call(f"get{of}", buffer, size)
        return np.array(buffer, dtype=float)

    def sizes(self) -> Float[np.ndarray, " n"]:
        """The usual sizes of the states; 1 where the FMU tells none."""
        sizes = np.abs(self.vector("NominalsOfContinuousStates"))
        return np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0)

    def at(self, t: float, x: Float[np.ndarray, " n"]) -> None:
        """Go to a time and a state of model exchange."""
        self._time = t
        self._call("setTime", t)
        if len(x):
            self._call("setContinuousStates", (c_double * len(x))(*x), len(x))

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
            if name == "doStep" and error.status == _DISCARD and self._fmu.getBooleanStatus(_TERMINATED):
                raise self._ended() from error
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
    return f": {' | '.join(list(texts)[-3:])[-LONGEST:]}" if texts else ""
