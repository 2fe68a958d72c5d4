"""The library of an FMU: loaded once, called by one thread at a time, heard when it says something."""

import copy
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes import byref
from pathlib import Path
from typing import Any

from aleator._core.errors import ProblemError, SimulationError
from aleator.foreign._fmu._files import MODEL_EXCHANGE, load_fmpy

# FMUs share what is static in their libraries, and FMPy's logger is one for the whole process.
LOCK = threading.RLock()
# What an FMU said last. Each message is a line at most.
_HEARD: deque[tuple[int, str]] = deque(maxlen=50)
_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
_WARNING, _FATAL = 1, 4
# Of its messages, so many characters are kept in an error.
_LONGEST = 300
_KEPT: list[Any] = []


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
