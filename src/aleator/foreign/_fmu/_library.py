"""The library of an FMU: loaded once, called by one thread at a time; its instances, whatever their version of FMI."""

import copy
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from ctypes import byref, c_double
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError, SimulationError
from aleator.foreign._fmu._description import MODEL_EXCHANGE, REAL, Described, Variable, described, load_fmpy

# FMUs share what is static in their libraries, and FMPy's logger is one for the whole process.
LOCK = threading.RLock()
# What an FMU said last. Each message is a line at most.
_HEARD: deque[tuple[int, str]] = deque(maxlen=50)
_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
_WARNING, _FATAL = 1, 4
# Of its messages, so many characters are kept in an error.
_LONGEST = 300
_KEPT: list[Any] = []
# Most iterations of the equations at one event.
_MOST_UPDATES = 1000


class Library:
    """The loaded library of an FMU, of which instances are made; `on_start` is called before each is.

    Raises `ProblemError` if it cannot be loaded.
    """

    def __init__(self, name: str, description: Any, kind: str, folder: Path):
        fmpy = load_fmpy("Fmu")
        self.name = name
        self.version = 2 if description.fmiVersion == "2.0" else 3
        self.is_exchange = kind == MODEL_EXCHANGE
        interface = description.modelExchange if self.is_exchange else description.coSimulation
        self.is_alone = interface.canBeInstantiatedOnlyOncePerProcess
        self.failure: Any = fmpy.fmi1.FMICallException
        self.is_broken = False
        self.on_start: Callable[[], None] = lambda: None
        self.steps_are_reported = bool(getattr(interface, "needsCompletedIntegratorStep", False))
        of_2, of_3 = (fmpy.fmi2.FMU2Model, fmpy.fmi2.FMU2Slave), (fmpy.fmi3.FMU3Model, fmpy.fmi3.FMU3Slave)
        model, slave = of_2 if self.version == 2 else of_3
        made = model if self.is_exchange else slave
        here = Path.cwd()  # FMPy goes to the folder of the library, and stays there if it cannot be loaded
        try:
            self._loaded = made(
                guid=description.guid,
                modelIdentifier=interface.modelIdentifier,
                unzipDirectory=str(folder),
                instanceName=name,
            )
        except Exception as error:
            said = " ".join(str(error).split())[:_LONGEST]
            raise ProblemError(f"FMU '{name}': its library cannot be loaded: {said}.") from error
        finally:
            os.chdir(here)

    def instantiated(self) -> Any:
        """A new instance, as an object of FMPy. Raises `SimulationError` if there is none."""
        if self.is_broken:
            raise SimulationError(
                f"FMU '{self.name}' failed fatally before, and must not be used again in this process: start another."
            )
        self.on_start()
        _HEARD.clear()
        found = copy.copy(self._loaded)
        try:
            if self.version == 2:
                found.instantiate(callbacks=_callbacks(), loggingOn=True)
            else:
                found.instantiate(logMessage=_hear, loggingOn=True)
        except Exception as error:
            raise SimulationError(f"FMU '{self.name}' cannot be instantiated{said()}.") from error
        return found

    def freed(self, instance: Any) -> None:
        """Give an instance back. Its library stays loaded for others."""
        if self.is_broken:
            return
        free = instance.fmi2FreeInstance if self.version == 2 else instance.fmi3FreeInstance
        free(instance.component)

    @contextmanager
    def explained(self, when: str) -> Iterator[None]:
        """Raise `SimulationError` for calls of the FMU that fail: `when`, such as 'at t = 1 s', and what it says."""
        try:
            yield
        except self.failure as error:
            self.is_broken = self.is_broken or error.status == _FATAL
            status = _STATUS[error.status] if error.status in range(len(_STATUS)) else f"status {error.status}"
            raise SimulationError(f"FMU '{self.name}' failed {when}{said()} ({error.function}: {status}).") from error
        except OSError as error:
            raise SimulationError(f"FMU '{self.name}' broke down {when}: {error}.") from error


def said() -> str:
    """What the FMU said last, its warnings and errors before all else, after a colon; empty if nothing."""
    serious = [text for status, text in _HEARD if status >= _WARNING]
    texts = dict.fromkeys(serious or [text for _, text in _HEARD])
    joined = " | ".join(list(texts)[-3:])
    return f": {joined[-_LONGEST:]}" if joined else ""


def _hear(*arguments: Any) -> None:
    """The logger of FMI 2 and 3, whose last three arguments are the status, the category and the message."""
    status, _, message = arguments[-3:]
    text = " ".join((message or b"").decode("utf-8", "replace").split()).rstrip(".")
    if text:
        _HEARD.append((status, text))


def _callbacks() -> Any:
    """What FMUs of version 2 call back: made once, and never collected, since a library may keep its address."""
    if not _KEPT:
        from fmpy import calloc, fmi2, free

        made = fmi2.fmi2CallbackFunctions()
        made.logger = fmi2.fmi2CallbackLoggerTYPE(_hear)
        made.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
        made.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        try:
            # It fills in the values of a message, which ctypes cannot pass on.
            from fmpy.logging import addLoggerProxy

            addLoggerProxy(byref(made))
        except (ImportError, OSError, AttributeError):
            pass  # not built for this machine: messages are heard without their values
        _KEPT.append(made)
    return _KEPT[0]


class Update(NamedTuple):
    """What an FMU says after an event: whether its states jumped, and when the next event is due (inf if unknown)."""

    has_jumped: bool
    next_event: float


class Instance:
    """An instance of a library, with so many states and event indicators.

    Once started, `initial` is its initial state, and `first` what it said when it was initialised.
    """

    def __init__(self, library: Library, states: int, indicators: int):
        self._library, self._fmu = library, library.instantiated()
        self._states, self._indicators = states, indicators
        self._time = 0.0
        self.first, self.initial = Update(False, np.inf), np.zeros(0)

    def start(self, values: Mapping[Variable, Any], t: float, tolerance: float | None) -> None:
        """Set variables, initialise at the time `t`, and get ready for steps or for continuous time."""
        fmu, self._time = self._fmu, t
        with self._library.explained("to initialise"):
            if self._library.version == 2:
                fmu.setupExperiment(tolerance=tolerance, startTime=t)
                self._set_all(values)
                fmu.enterInitializationMode()
            else:
                self._set_all(values)
                fmu.enterInitializationMode(tolerance=tolerance, startTime=t)
            fmu.exitInitializationMode()
            if self._library.is_exchange:
                self.first = self._updated()
                fmu.enterContinuousTimeMode()
                self.initial = self.state()

    def free(self) -> None:
        """Give the instance back."""
        self._library.freed(self._fmu)

    def set(self, references: Sequence[int], values: Sequence[float] | np.ndarray) -> None:
        """Set real variables."""
        if len(references):
            with self._explained():
                setter = self._fmu.setReal if self._library.version == 2 else self._fmu.setFloat64
                setter(references, [float(value) for value in values])

    def get(self, references: Sequence[int]) -> Float[np.ndarray, " n"]:
        """Values of real variables."""
        with self._explained():
            getter = self._fmu.getReal if self._library.version == 2 else self._fmu.getFloat64
            return np.array(getter(references), dtype=float)

    # --- Model exchange ---

    def at(self, t: float, x: Float[np.ndarray, " n"] | None = None) -> None:
        """Go to a time and, if it is given, a state."""
        self._time = t
        with self._explained():
            self._fmu.setTime(t)
            if x is not None and self._states:
                self._fmu.setContinuousStates((c_double * self._states)(*x), self._states)

    def state(self) -> Float[np.ndarray, " n"]:
        """The continuous states."""
        return self._filled(self._fmu.getContinuousStates, self._states)

    def nominals(self) -> Float[np.ndarray, " n"]:
        """The usual sizes of the states; 1 where the FMU tells none."""
        found = np.abs(self._filled(self._fmu.getNominalsOfContinuousStates, self._states))
        return np.where(np.isfinite(found) & (found > 0), found, 1.0)

    def rates(self) -> Float[np.ndarray, " n"]:
        """The time derivatives of the states."""
        version = self._library.version
        asked = self._fmu.getDerivatives if version == 2 else self._fmu.getContinuousStateDerivatives
        return self._filled(asked, self._states)

    def indicators(self) -> Float[np.ndarray, " m"]:
        """The event indicators, which change their signs at events."""
        return self._filled(self._fmu.getEventIndicators, self._indicators)

    def slopes(self, of: Sequence[int], by: Sequence[int], seed: Sequence[float]) -> Float[np.ndarray, " m"]:
        """The derivative of variables along a direction of others."""
        with self._explained():
            return np.array(self._fmu.getDirectionalDerivative(of, by, [float(part) for part in seed]), dtype=float)

    def step_is_over(self) -> bool:
        """Tell the FMU that a step is accepted, if it wants to know. Returns whether it asks for an event."""
        if not self._library.steps_are_reported:
            return False
        with self._explained():
            asks, ends = self._fmu.completedIntegratorStep()
        if ends:
            raise self._ended()
        return asks

    def event(self) -> Update:
        """Let the FMU handle an event."""
        with self._explained():
            self._fmu.enterEventMode()
            found = self._updated()
            self._fmu.enterContinuousTimeMode()
        return found

    # --- Co-simulation ---

    def step(self, t: float, length: float) -> None:
        """Let the FMU step by itself. Raises `SimulationError` if it does not reach the end of the step."""
        self._time = t + length
        fmu = self._fmu
        with self._explained():
            if self._library.version == 2:
                from fmpy.fmi2 import fmi2Discard, fmi2Terminated

                try:
                    fmu.doStep(t, length)
                except self._library.failure as error:
                    if getattr(error, "status", None) == fmi2Discard and fmu.getBooleanStatus(fmi2Terminated):
                        raise self._ended() from error
                    raise
                return
            _, ends, early, reached = fmu.doStep(t, length)
        if ends or early:
            self._time = reached
            raise self._ended()

    # --- Inside ---

    def _filled(self, asked: Any, size: int) -> np.ndarray:
        buffer = (c_double * size)()
        if size:
            with self._explained():
                asked(buffer, size)
        return np.array(buffer, dtype=float)

    def _set_all(self, values: Mapping[Variable, Any]) -> None:
        for variable, value in values.items():
            name = "Integer" if variable.type == "Enumeration" and self._library.version == 2 else variable.type
            name = "Int64" if name == "Enumeration" else name
            kind = float if variable.type in (*REAL, "Float32") else lambda given: given
            getattr(self._fmu, f"set{name}")([variable.valueReference], [kind(value)])

    def _updated(self) -> Update:
        jumped = False
        for _ in range(_MOST_UPDATES):
            asked = self._fmu.newDiscreteStates if self._library.version == 2 else self._fmu.updateDiscreteStates
            again, ends, _, changed, is_timed, next_event = asked()
            if ends:
                raise self._ended()
            jumped = jumped or bool(changed)
            if not again:
                return Update(jumped, float(next_event) if is_timed else np.inf)
        raise SimulationError(
            f"FMU '{self._library.name}' does not find its state after an event at t = {self._time:.6g} s{said()}: "
            f"{_MOST_UPDATES} updates were not enough."
        )

    def _explained(self) -> Any:
        return self._library.explained(f"at t = {self._time:.6g} s")

    def _ended(self) -> SimulationError:
        return SimulationError(f"FMU '{self._library.name}' ended the simulation at t = {self._time:.6g} s{said()}.")


@final
class Opened(Described):
    """An FMU whose library is loaded. Raises `ProblemError` if it cannot be."""

    def __init__(self, name: str, folder: Path, kind: str | None, settings: Mapping[str, Any] | None):
        super().__init__(name, folder, kind, settings, description=described(name, folder, validate=False))
        self.library = Library(name, self.description, self.kind, folder)

    @contextmanager
    def started(self, values: Mapping[Variable, float], t: float, tolerance: float | None) -> Iterator[Instance]:
        """A fresh instance at the time `t`, with values of variables besides the settings; given back at the end.

        So no run depends on the runs before it.
        """
        instance = Instance(self.library, len(self.states), self.indicators)
        try:
            instance.start({**self.settings, **values}, t, tolerance)
            yield instance
        finally:
            instance.free()
