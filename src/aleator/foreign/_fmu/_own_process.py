"""An FMU in a process of its own: what crashes or hangs there ends neither this process nor its work."""

import pickle
import secrets
import subprocess
import sys
import threading
import warnings
import weakref
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, wait
from multiprocessing.connection import Connection, Listener
from multiprocessing.spawn import get_executable
from typing import IO, Any, NamedTuple, final

from typing_extensions import override

from aleator._core.errors import ProblemError, SimulationError, SimulationWarning
from aleator._core.executors import end_group, ended_with, endings, exit_told, in_group
from aleator.foreign._fmu._doors import AbstractDoor
from aleator.foreign._fmu._served import Request

# What the process runs: it finds modules where this one does, and reads nothing of the user's script, so that a script
# needs no `if __name__ == "__main__":`.
_CODE = (
    "import pickle, sys; sys.path[:], *given = pickle.load(sys.stdin.buffer); "
    "from aleator.foreign._fmu._worker import serve; serve(*given)"
)
# Of what it prints, so many characters are kept, and so many shown.
_KEPT, _SHOWN = 4000, 200
# How often a process that has not connected yet is looked at, s.
_PAUSE = 0.05
_ERRORS = {kind.__name__: kind for kind in (ProblemError, SimulationError)}


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
            raise _ERRORS.get(kind, SimulationError)(text if kind in _ERRORS else self._odd(kind, text, where))
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

    def _odd(self, kind: str, text: str, where: Callable[[], str]) -> str:
        return f"FMU '{self._name}' raised {kind}: {text.rstrip('.')}{where()}."

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
