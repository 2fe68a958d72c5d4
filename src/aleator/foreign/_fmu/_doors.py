"""What can be asked of an FMU, in this process or in one of its own, whose crashes end nothing here."""

import os
import pickle
import queue
import subprocess
import sys
import tempfile
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing.spawn import get_executable
from typing import IO, Any, NamedTuple, final

import numpy as np
from jaxtyping import Float

from aleator._core.errors import AleatorError, SimulationError
from aleator._core.executors import end_group, ended_with, endings, exit_told, in_group, last_lines
from aleator.foreign._fmu._instance import Instance, Loaded, Motion, stepped

# As many instances are kept for evaluations of the equations, each with its own parameters.
_KEPT = 256
# The initial state is determined within this tolerance, if the FMU has to iterate for it.
_TOLERANCE = 1e-10
# FMUs share what is static in their libraries, and FMPy's logger is one for the whole process.
_LOCK = threading.RLock()
# What the process runs: it finds modules where this one does, and reads nothing of the user's script, so that a script
# needs no `if __name__ == "__main__":`.
_CODE = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from aleator.foreign._fmu._doors import serve; serve()"
)


@final
class Library(Loaded):
    """The FMU `name` in an unpacked `folder`, loaded; variables are told by their names.

    `settings`: values of variables of any type, for all runs. Raises `ProblemError` if it cannot be loaded.
    """

    def __init__(self, name: str, folder: str, is_exchange: bool, settings: Mapping[str, Any]):
        super().__init__(name, folder, is_exchange)
        self._settings = settings
        self._instances = OrderedDict[tuple[Any, ...], Instance]()
        weakref.finalize(self, _free_all, self._instances)

    def run(
        self,
        start: Mapping[str, float],
        outputs: Sequence[str],
        times: Float[np.ndarray, " instants"],
        inputs: Mapping[str, Float[np.ndarray, " instants"]],
        tolerance: float,
    ) -> Float[np.ndarray, "instants outputs"]:
        """The outputs at all instants, from values at the start, with inputs that are straight between instants.

        Raises `SimulationError` if the run fails, or an output is not finite.
        """
        driven, values = self.references(list(inputs)), np.array([*inputs.values()]).reshape(-1, len(times)).T
        first = dict(zip(inputs, values[0].tolist(), strict=True))
        with self._started({**start, **first}, float(times[0]), tolerance) as instance:
            if self.is_exchange:
                rows = Motion(instance, times, driven, values, tolerance).outputs(self.references(outputs))
            else:
                rows = stepped(instance, times, driven, values, self.references(outputs))
        if not np.isfinite(rows).all():
            instant, output = np.argwhere(~np.isfinite(rows))[0]
            what = f"output '{outputs[output]}' is {rows[instant, output]:g} at t = {times[instant]:.6g} s"
            raise SimulationError(f"FMU '{self.name}': {what}.")
        return rows

    # --- Equations ---

    def first(self, parameters: Mapping[str, float | None], inputs: Sequence[str]) -> dict[str, Any]:
        """How the equations begin, for values of parameters, None for the FMU's own.

        Values of the `inputs` and `parameters`, the `states` and their usual sizes, and how many `indicators` of events
        there are, and whether some are known by their time.
        """
        with self._started({}, 0.0, _TOLERANCE) as instance:
            own, u = instance.get(self.references(list(parameters))), instance.get(self.references(inputs))
            is_timed = bool(np.isfinite(instance.next_event))
        p = np.array([its if value is None else value for value, its in zip(parameters.values(), own, strict=True)])
        with self._started(dict(zip(parameters, p.tolist(), strict=True)), 0.0, _TOLERANCE) as instance:
            start = {"inputs": u, "parameters": p, "states": instance.state(), "nominals": instance.nominals()}
        return start | {"indicators": self.indicators, "is_timed": is_timed}

    def rates(
        self,
        parameters: Sequence[str],
        inputs: Sequence[str],
        outputs: Sequence[str],
        points: Float[np.ndarray, "points m"],
    ) -> tuple[Float[np.ndarray, "points values"], str]:
        """Rates of the states, then outputs, at points (time, states, inputs, parameters); NaN where the FMU fails.

        Parameters are set before an FMU starts, so that there is one instance for each set of them. Also returns what
        the first failure was.
        """
        names, driven, read = tuple(parameters), self.references(inputs), self.references(outputs)
        n = 1 + self.states
        r = n + len(driven)

        def values(point: np.ndarray) -> np.ndarray:
            instance = self._instance(names, point[r:])
            instance.at(float(point[0]), point[1:n])
            instance.set(driven, point[n:r])
            return np.concatenate([instance.rates(), instance.get(read)])

        return _each(values, points, self.states + len(read))

    def initial(
        self, names: Sequence[str], points: Float[np.ndarray, "points m"]
    ) -> tuple[Float[np.ndarray, "points n"], str]:
        """The initial states at values of variables, after a time that is left aside; as `rates` returns them."""

        def state(point: np.ndarray) -> np.ndarray:
            with self._started(dict(zip(names, point[1:].tolist(), strict=True)), 0.0, _TOLERANCE) as instance:
                return instance.state()

        return _each(state, points, self.states)

    @contextmanager
    def _started(self, values: Mapping[str, Any], t: float, tolerance: float) -> Iterator[Instance]:
        """A fresh instance, so that no run depends on the runs before it; given back at the end."""
        if self.is_alone:
            _free_all(self._instances)
        instance = Instance(self, {**self._settings, **values}, t, tolerance)
        try:
            yield instance
        finally:
            instance.free()

    def _instance(self, names: tuple[str, ...], p: Float[np.ndarray, " k"]) -> Instance:
        """The instance of a set of parameters at the time 0, started if it is new."""
        key = (names, p.tobytes())
        if key not in self._instances:
            while len(self._instances) >= (1 if self.is_alone else _KEPT):
                self._instances.popitem(last=False)[1].free()
            values = dict(zip(names, p.tolist(), strict=True))
            self._instances[key] = Instance(self, {**self._settings, **values}, 0.0, _TOLERANCE)
        self._instances.move_to_end(key)
        return self._instances[key]


def _free_all(instances: OrderedDict[tuple[Any, ...], Instance]) -> None:
    while instances:
        instances.popitem()[1].free()


def _each(
    function: Callable[[np.ndarray], np.ndarray], points: Float[np.ndarray, "points m"], size: int
) -> tuple[Float[np.ndarray, "points values"], str]:
    """`size` values of a function at each point, NaN where it fails or the point is not finite; the first failure."""
    values, reason = np.full((len(points), size), np.nan), ""
    for index in np.flatnonzero(np.isfinite(points).all(axis=1)):
        try:
            values[index] = function(points[index])
        except SimulationError as error:
            reason = reason or str(error)
    return values, reason


@final
class SameProcess:
    """An FMU in this process; takes what `Library` does."""

    def __init__(self, *opening: Any):
        with _LOCK:
            self._library = Library(*opening)

    def ask(self, method: str, *arguments: Any, where: str) -> Any:
        """What a method of the library returns."""
        del where  # is told where a process ends
        with _LOCK:
            return getattr(self._library, method)(*arguments)


class _Running(NamedTuple):
    """A process, and a file with what it prints."""

    process: subprocess.Popen[Any]
    printed: IO[bytes]


@final
class OwnProcess:
    """An FMU in a process of its own, which lasts from one question to the next, and is started again after its death.

    - `opening`: what `Library` takes;
    - `time_limit`: seconds for one answer, after which the process is ended.

    Raises `ProblemError` if the library cannot be loaded, `SimulationError` if it ends the process or hangs.
    """

    def __init__(self, *opening: Any, time_limit: float | None):
        self._name, self._opening, self._limit = opening[0], opening, time_limit
        self._lock = threading.RLock()
        self._running: list[_Running] = []
        weakref.finalize(self, _end_all, self._running)
        with self._lock:
            self._started()

    def ask(self, method: str, *arguments: Any, where: str) -> Any:
        """What a method of the library returns; `where`: at which numbers it is asked, such as ', with x=1'."""
        with self._lock:
            if not self._running:
                self._started()
            return self._answered((method, *arguments), where, self._limit)

    def _started(self) -> None:
        printed = tempfile.TemporaryFile()  # noqa: SIM115 (open as long as the process)
        process = subprocess.Popen(
            [get_executable(), "-c", _CODE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=printed,
            **in_group(),
        )
        self._running.append(_Running(process, printed))
        try:
            # Before it is ready, it imports: that is no run.
            self._answered(sys.path, " before it began", None)
            self._answered(self._opening, " while its library was loaded", self._limit)
        except BaseException:
            self._end()
            raise

    def _answered(self, question: Any, where: str, limit: float | None) -> Any:
        """What the process answers. It is ended if that takes longer than a limit, or is interrupted."""
        process, printed = self._running[0]
        assert process.stdin is not None
        assert process.stdout is not None
        answer, is_late = None, threading.Event()

        def end() -> None:
            is_late.set()
            end_group(process.pid)

        timer = threading.Timer(limit or threading.TIMEOUT_MAX, end)
        timer.daemon = True
        try:
            with ended_with(process.pid, lambda: answer is not None, endings()):
                timer.start()
                printed.seek(0)  # with the place at which the process writes: only the last run is of interest
                printed.truncate()
                pickle.dump(question, process.stdin)
                process.stdin.flush()
                answer = pickle.load(process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            ending = exit_told(process.wait())
            lines = last_lines(printed)
            self._end()
            if is_late.is_set():
                raise SimulationError(
                    f"FMU '{self._name}' did not end a run within its time limit of {limit:g} s{where}: its "
                    "process was ended. If it needs longer, give Fmu a larger time_limit."
                ) from error
            words = f"; it printed: {lines}" if lines else ""
            raise SimulationError(f"FMU '{self._name}' ended its process by {ending}{where}{words}.") from error
        except BaseException:
            self._end()
            raise
        finally:
            timer.cancel()
        returned, raised, is_broken = answer
        if is_broken:
            self._end()
        if raised is not None:
            raise raised
        return returned

    def _end(self) -> None:
        _end_all(self._running)


def _end_all(running: list[_Running]) -> None:
    while running:
        process, printed = running.pop()
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
                method, *arguments = question
                returned = getattr(library, method)(*arguments)
        except AleatorError as error:
            raised = type(error)(str(error))
        except Exception as error:
            raised = SimulationError(f"An FMU raised {type(error).__name__}: {error}.")
