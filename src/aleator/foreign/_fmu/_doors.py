"""Where the library of an FMU is loaded: in this process, or in one of its own, whose crashes end nothing here."""

import itertools
import os
import pickle
import secrets
import subprocess
import sys
import threading
import warnings
import weakref
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, wait
from multiprocessing.connection import Client, Connection, Listener
from multiprocessing.spawn import get_executable
from pathlib import Path
from typing import IO, Any, NamedTuple, final

from typing_extensions import override

from aleator._core.errors import AleatorError, ProblemError, SimulationError, SimulationWarning
from aleator._core.executors import end_group, ended_with, endings, exit_told, in_group
from aleator.foreign._fmu._equations import Field
from aleator.foreign._fmu._library import LOCK, Opened
from aleator.foreign._fmu._runs import Runs

_NUMBERS = itertools.count()
# What the process runs: it finds modules where this one does, and reads nothing of the user's script, so that a script
# needs no `if __name__ == "__main__":`.
_CODE = (
    "import pickle, sys; sys.path[:], *given = pickle.load(sys.stdin.buffer); "
    "from aleator.foreign._fmu._doors import serve; serve(*given)"
)
# Of what it prints, so many characters are kept, and so many shown.
_KEPT, _SHOWN = 4000, 200
# How often a process that has not connected yet is looked at, s.
_PAUSE = 0.05
_ERRORS = {kind.__name__: kind for kind in (ProblemError, SimulationError)}


class Request(NamedTuple):
    """A call of a method of an object, which has a number, and is made of names, numbers and arrays at its first call.

    So it is made again where a process has ended.
    """

    number: int
    kind: type[Runs | Field]
    parts: tuple[Any, ...]
    method: str
    arguments: tuple[Any, ...]


@final
class Objects:
    """The objects of an FMU by their numbers."""

    def __init__(self, fmu: Opened):
        self._fmu = fmu
        self._made: dict[int, Any] = {}

    def answer(self, request: Request) -> Any:
        """What a method of an object returns."""
        if request.number not in self._made:
            self._made[request.number] = request.kind(self._fmu, *request.parts)
        return getattr(self._made[request.number], request.method)(*request.arguments)

    def forget(self, numbers: list[int]) -> None:
        """Give up objects that nobody will ask again."""
        for number in numbers:
            self._made.pop(number, None)


class AbstractDoor:
    """The way to the objects of an FMU (`Objects`). One request at a time is answered."""

    def __init__(self) -> None:
        # Whatever runs when an object is collected must not send anything: it may be in the middle of a request.
        self._forgotten: deque[int] = deque()

    @abstractmethod
    def ask(self, request: Request, where: Callable[[], str]) -> Any:
        """The answer to a request; `where` says at which numbers it is asked, as ', with x=1'."""

    def forget(self, number: int) -> None:
        """Give up the object of a number, some time."""
        self._forgotten.append(number)

    def _taken(self) -> list[int]:
        """The numbers of objects that have not been given up yet."""
        return [self._forgotten.popleft() for _ in range(len(self._forgotten))]


@final
class Here(AbstractDoor):
    """An FMU in this process."""

    def __init__(self, name: str, folder: Path, kind: str, settings: Mapping[str, Any]):
        super().__init__()
        with LOCK:
            self._objects = Objects(Opened(name, folder, kind, settings))

    @override
    def ask(self, request: Request, where: Callable[[], str]) -> Any:
        with LOCK:
            self._objects.forget(self._taken())
            return self._objects.answer(request)


@final
class Served:
    """An object of a kind behind a door, made there from `parts`; given up there when it is collected here."""

    def __init__(self, door: AbstractDoor, kind: type[Runs | Field], *parts: Any):
        self._door, self._kind, self._parts = door, kind, parts
        self._number = next(_NUMBERS)
        weakref.finalize(self, door.forget, self._number).atexit = False

    def ask(self, method: str, *arguments: Any, where: Callable[[], str]) -> Any:
        """What a method of it returns."""
        return self._door.ask(Request(self._number, self._kind, self._parts, method, arguments), where)


class _Process(NamedTuple):
    """A process, the connection to it, the end of what it printed, and the numbers of the objects that it knows."""

    process: subprocess.Popen[Any]
    connection: Connection
    printed: "_Printed"
    known: set[int]


@final
class OwnProcess(AbstractDoor):
    """An FMU in a process of its own, which lasts from one request to the next, and is started again after its death.

    - `opening`: the name, the folder, the kind and the settings of the FMU;
    - `time_limit`: seconds for one run (or one evaluation of equations), after which the process is ended.

    Raises `ProblemError` if the library cannot be loaded, `SimulationError` if it ends the process or hangs.
    """

    def __init__(self, opening: tuple[Any, ...], time_limit: float | None):
        super().__init__()
        self._name, self._opening, self._limit = opening[0], opening, time_limit
        self._lock = threading.RLock()
        self._running: list[_Process] = []
        weakref.finalize(self, _end_all, self._running)
        with self._lock:
            self._started()

    @override
    def ask(self, request: Request, where: Callable[[], str]) -> Any:
        with self._lock:
            running = self._running[0] if self._running else self._started()
            # Objects are described once.
            sent = request._replace(parts=()) if request.number in running.known else request
            answer = self._answered(running, (self._taken(), sent), where)
            running.known.add(request.number)
            return answer

    def _started(self) -> _Process:
        running = _begun(self._name)
        self._running.append(running)
        try:
            self._answered(running, self._opening, lambda: " while its library was loaded")
        except BaseException:
            self._end()
            raise
        return running

    def _answered(self, running: _Process, sent: tuple[Any, ...], where: Callable[[], str]) -> Any:
        """What the process answers. It is ended if that takes too long, or is interrupted."""
        answer = None
        try:
            with ended_with(running.process.pid, lambda: answer is not None, endings()):
                answer = self._received(running, sent, where)
        except BaseException:
            self._end()
            raise
        returned, raised, warned = answer
        for text in warned:
            warnings.warn(text, SimulationWarning, stacklevel=2)
        if raised is not None:
            kind, text = raised
            if kind in _ERRORS:
                raise _ERRORS[kind](text)
            raise SimulationError(f"FMU '{self._name}' raised {kind}: {text.rstrip('.')}{where()}.")
        return returned

    def _received(
        self, running: _Process, sent: tuple[Any, ...], where: Callable[[], str]
    ) -> tuple[Any, tuple[str, str] | None, list[str]]:
        try:
            running.connection.send(sent)
            while running.connection.poll(self._limit):
                # Each run that begins is a sign of life.
                if (received := running.connection.recv()) is not None:
                    return received
        except (EOFError, OSError) as error:
            code = running.process.wait()
            raise SimulationError(
                f"FMU '{self._name}' ended its process by {exit_told(code)}{where()}{running.printed.shown()}."
            ) from error
        raise SimulationError(
            f"FMU '{self._name}' did not end a run within its time limit of {self._limit:g} s{where()}: its process "
            "was ended. If it needs longer, give Fmu a larger time_limit."
        )

    def _end(self) -> None:
        _end_all(self._running)


@final
class _Printed:
    """The end of what a process prints, read by a thread so that it never waits for a reader."""

    def __init__(self, stream: IO[bytes]):
        self._stream = stream
        self._bytes: deque[int] = deque(maxlen=_KEPT)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while chunk := self._stream.read1(_KEPT):  # type: ignore[attr-defined]
            self._bytes.extend(chunk)

    def shown(self) -> str:
        """The last lines as a part of a sentence, once the process has ended."""
        self._thread.join(timeout=1.0)
        text = bytes(self._bytes).decode(errors="replace")
        lines = [" ".join(line.split()) for line in text.splitlines() if line.strip()]
        return f"; it printed: {' / '.join(lines[-3:])[-_SHOWN:]}".rstrip(".") if lines else ""


def _begun(name: str) -> _Process:
    """A new process that has connected to this one."""
    key = secrets.token_bytes(32)
    with Listener(authkey=key) as listener:
        process = subprocess.Popen(
            [get_executable(), "-c", _CODE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            **in_group(),
        )
        assert process.stdin is not None
        assert process.stdout is not None
        printed = _Printed(process.stdout)
        # What it reads stays open: when this process ends, so does that one.
        process.stdin.write(pickle.dumps((sys.path, listener.address, key)))
        process.stdin.flush()
        accepted: Future[Connection] = Future()
        threading.Thread(target=lambda: accepted.set_result(listener.accept()), daemon=True).start()
        while not wait([accepted], timeout=_PAUSE).done:
            if process.poll() is not None:
                raise SimulationError(
                    f"FMU '{name}': its process ended by {exit_told(process.returncode)} before it began"
                    f"{printed.shown()}. Does this Python import aleator and fmpy?"
                )
    return _Process(process, accepted.result(), printed, set())


def _end_all(running: list[_Process]) -> None:
    while running:
        process, connection, *_ = running.pop()
        connection.close()
        if process.poll() is None:
            end_group(process.pid)
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()


def serve(address: str | tuple[str, int], key: bytes) -> None:
    """Connect to the process that started this one, and serve it.

    Its first message is what `Opened` takes, others are the numbers of objects to forget and a request. Answers are
    what is returned, what is raised (the name of its type and its text), and the texts of warnings; None is a sign of
    life.
    """
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with Client(address, authkey=key) as connection:
        objects: list[Objects] = []

        def opened(opening: tuple[Any, ...]) -> None:
            fmu = Opened(*opening)
            fmu.library.on_start = lambda: connection.send(None)
            objects.append(Objects(fmu))

        def answered(message: tuple[Any, ...]) -> Any:
            forgotten, request = message
            objects[0].forget(forgotten)
            return objects[0].answer(request)

        try:
            connection.send(_tried(opened, connection.recv()))
            while True:
                connection.send(_tried(answered, connection.recv()))
        except (EOFError, OSError):  # nobody asks any more
            pass
    # Without the clean-up of a library that may have been left in any state.
    os._exit(0)


def _tried(function: Callable[[tuple[Any, ...]], Any], message: tuple[Any, ...]) -> tuple[Any, Any, list[str]]:
    """What a function returns, what it raises, and of what it warns."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        returned, raised = None, None
        try:
            returned = function(message)
        except (EOFError, BrokenPipeError):
            raise
        except AleatorError as error:
            raised = (type(error).__name__, str(error))
        except Exception as error:
            raised = (type(error).__name__, " ".join(str(error).split()))
    return returned, raised, [str(warning.message) for warning in heard]


def _end_with_parent() -> None:
    """End when the process that started this one does, in the middle of a call of the library too."""
    sys.stdin.buffer.read()
    os._exit(1)
