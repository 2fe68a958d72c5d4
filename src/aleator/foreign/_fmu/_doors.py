"""An FMU in a process of its own, whose crashes end nothing here."""

import os
import pickle
import queue
import subprocess
import sys
import tempfile
import threading
import weakref
from multiprocessing.spawn import get_executable
from typing import IO, Any, cast, final

from aleator._core.errors import AleatorError, SimulationError
from aleator._core.executors import end_group, ended_with, endings, exit_told, in_group, last_lines
from aleator.foreign._fmu._library import Library

# What the process runs: it finds modules where this one does, and reads nothing of the user's script, so that a script
# needs no `if __name__ == "__main__":`.
_CODE = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from aleator.foreign._fmu._doors import serve; serve()"
)


@final
class OwnProcess:
    """An FMU in a process of its own, which lasts from one question to the next, and is started again after its death.

    - `opening`: what `Library` takes; `time_limit`: seconds for one answer, after which the process is ended.

    Raises `ProblemError` if the library cannot be loaded, `SimulationError` if it ends the process or hangs.
    """

    def __init__(self, *opening: Any, time_limit: float | None):
        self._name, self._opening, self._limit = opening[0], opening, time_limit
        self._lock = threading.RLock()
        with self._lock:
            self._start()

    def ask(self, method: str, *arguments: Any, where: str) -> Any:
        """What a method of the library returns; `where`: at which numbers it is asked, such as ', with x=1'."""
        with self._lock:
            if not self.end.alive:
                self._start()
            return self._answered((method, *arguments), where, self._limit)

    def _start(self) -> None:
        self._printed = tempfile.TemporaryFile()  # noqa: SIM115 (open as long as the process)
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": self._printed}
        self.process: subprocess.Popen[Any] = subprocess.Popen([get_executable(), "-c", _CODE], **pipes, **in_group())
        self.end = weakref.finalize(self, _end, self.process, self._printed)
        # Before it is ready, it imports: that is no run.
        self._answered(sys.path, " before it began", None)
        self._answered(self._opening, " while its library was loaded", self._limit)

    def _answered(self, question: Any, where: str, limit: float | None) -> Any:
        """What the process answers. It is ended if that takes longer than a limit, or is interrupted."""
        process, answer, is_late = self.process, None, threading.Event()
        assert process.stdin is not None
        assert process.stdout is not None

        def end() -> None:
            is_late.set()
            end_group(process.pid)

        timer = threading.Timer(limit or threading.TIMEOUT_MAX, end)
        timer.daemon = True
        try:
            with ended_with(process.pid, lambda: answer is not None, endings()):
                timer.start()
                self._printed.seek(0)  # with the place at which the process writes: only the last run is of interest
                self._printed.truncate()
                pickle.dump(question, process.stdin)
                process.stdin.flush()
                answer = pickle.load(process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            how = f"ended its process by {exit_told(process.wait())}{where}"
            if is_late.is_set():
                how = (
                    f"did not end a run within its time limit of {limit:g} s{where}: its process was ended. If it "
                    "needs longer, give Fmu a larger time_limit"
                )
            elif lines := last_lines(self._printed):
                how += f"; it printed: {lines}"
            raise SimulationError(f"FMU '{self._name}' {how}.") from error
        finally:
            timer.cancel()
            if answer is None:
                self.end()
        returned, raised, is_broken = cast("tuple[Any, Any, bool]", answer)
        if is_broken or (raised is not None and question is self._opening):
            self.end()
        if raised is not None:
            raise raised
        return returned


def _end(process: subprocess.Popen[Any], printed: IO[bytes]) -> None:
    """End a process, if it has not ended, and close its files."""
    if process.poll() is None:
        end_group(process.pid)
    process.wait()
    for stream in (process.stdin, process.stdout, printed):
        if stream is not None:
            stream.close()


def serve() -> None:
    """Answer the process that started this one, until that ends.

    Reads pickles: first what `Library` takes, then names of methods with their arguments. Writes pickles: what is
    returned, what is raised, and whether the library must not be used again; one of nothing when it begins.
    """
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the FMU prints goes to the file of errors
    questions = queue.SimpleQueue[tuple[Any, ...]]()

    def read() -> None:
        try:
            while True:
                questions.put(pickle.load(sys.stdin.buffer))
        finally:
            os._exit(1)  # in the middle of a call of the library too, and without its clean-up

    threading.Thread(target=read, daemon=True).start()
    library, returned, raised = None, None, None
    while True:
        pickle.dump((returned, raised, library is not None and library.is_broken), answers)
        answers.flush()
        question, returned, raised = questions.get(), None, None
        try:
            if library is None:
                library = Library(*question)
            else:
                returned = library.ask(*question)
        except AleatorError as error:
            raised = type(error)(str(error))
        except Exception as error:
            raised = SimulationError(f"An FMU raised {type(error).__name__}: {error}.")
