"""`Fmu`: a model in a file, what it offers, and the process in which it runs, whose crashes end nothing here."""

import functools
import hashlib
import os
import pickle
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import weakref
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from multiprocessing.spawn import get_executable
from pathlib import Path
from typing import IO, Any, cast, final

import numpy as np
from jaxtyping import Float

from aleator._core.border import content_of, meant, one_of, positive, refusal, shown
from aleator._core.errors import AleatorError, ProblemError, SimulationError, optional
from aleator._core.executors import end_group, ended_with, endings, exit_told, in_group, last_lines
from aleator.foreign._fmu._library import Library, usual_sizes

# What users call the interfaces, and FMPy does. The first one offered is the default.
_KINDS = {"model exchange": "modelExchange", "co-simulation": "coSimulation"}
_REAL = ("Real", "Float64")  # in FMI 2 and 3
# Types of FMI that NumPy calls otherwise. A number of 32 bits need not be exact.
_IN_NUMPY = {"Real": "float64", "Float32": "float64", "Integer": "int32", "Enumeration": "int32", "Boolean": "bool"}
# As many characters of another library's message are repeated.
_LONGEST = 160
# What the process runs: it finds modules where this one does, and reads nothing of the user's script, so that a script
# needs no `if __name__ == "__main__":`.
_CODE = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from aleator.foreign._fmu._fmu import serve; serve()"
)


@final
class Fmu:
    """A functional mock-up unit (FMI 2 or 3), as simulation tools export it: `al.foreign.Fmu("pendulum.fmu")`.

    - `path`: the file;
    - `kind`: "model exchange" (the FMU gives the rates of its states, which are integrated here) or "co-simulation" (it
      steps by itself); by default the first of the two that it offers;
    - `settings`: values of parameters of any type (numbers, whole numbers, truth values, texts), for all runs;
    - `own_process`: whether the compiled code of the FMU runs in a process of its own, which starts once, and again
      after a crash. Without one, an FMU that crashes or hangs does so with this process;
    - `time_limit`: seconds for one run, or for those evaluations of an `FmuSystem` that are made at once, after which
      that process is ended and the run has failed; None for no limit.

    `parameters`, `inputs`, `outputs` and `states` list its real variables by name. It is run by `FmuSimulation`, a
    function of its parameters, and by `FmuSystem`, a system. Calls of one FMU are made one at a time.

    Raises `ProblemError` for a file that is no FMU, of FMI 1, or without a binary for this machine, and for unknown
    settings; `SimulationError` if its library ends its process while it is loaded; `MissingExtraError` without FMPy.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        kind: str | None = None,
        settings: Mapping[str, Any] | None = None,
        own_process: bool = True,
        time_limit: float | None = 600.0,
    ):
        path = Path(one_of("Fmu: path", path, (str, Path), "'pendulum.fmu'"))
        limit = None if time_limit is None else positive("Fmu: time_limit", time_limit)
        settings = dict(one_of("Fmu: settings", settings or {}, Mapping, "{'stages': 3}"))
        folder = Path(tempfile.mkdtemp(prefix="aleator-fmu-"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        # Two files are two models, whatever they are called.
        self.name, (description, self._digest) = path.stem, _unpacked(path, folder)
        offered = [one for one, theirs in _KINDS.items() if getattr(description, theirs) is not None]
        if kind is not None and kind not in offered:
            raise refusal(f"FMU '{self.name}': kind", f"one of {offered}", kind)
        self.kind = kind or offered[0]
        self.is_exchange = self.kind == "model exchange"
        self._version, self.indicators = description.fmiVersion, int(description.numberOfEventIndicators)
        self.variables: dict[str, Any] = {variable.name: variable for variable in description.modelVariables}
        self.parameters, self.inputs, self.outputs = map(self._of, ("parameter", "input", "output"))
        rates = [derivative.variable for derivative in description.derivatives if self.is_exchange]
        for rate in rates:
            if rate.derivative is None or not _is_number(rate.derivative):
                raise refusal(f"FMU '{self.name}'", "states of one real number each, with a rate", rate.name)
        self.states: list[str] = [rate.derivative.name for rate in rates]
        for name in self.checked(settings, of_any_type=True):
            settings[name] = _of_type(f"FMU '{self.name}': '{name}'", self.variables[name].type, settings[name])
        self._given = path.absolute(), tuple(settings.items()), self.kind, own_process, limit
        opening = self.name, str(folder), self.is_exchange, settings
        self.door = OwnProcess(*opening, time_limit=limit) if own_process else Library(*opening)

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent to other processes as its file, which must be the same there."""
        return _opened_again, (self._digest, *self._given)

    def __str__(self) -> str:
        listed = {name: getattr(self, name) for name in ("parameters", "inputs", "states", "outputs")}
        events = f"; {self.indicators} event indicators" if self.is_exchange and self.indicators else ""
        lines = [f"  {name}: {', '.join(variables) or 'none'}" for name, variables in listed.items()]
        return "\n".join([f"FMU '{self.name}': FMI {self._version}, {self.kind}{events}", *lines])

    def _of(self, causality: str) -> list[str]:
        """The real variables of a causality."""
        return [name for name, one in self.variables.items() if one.causality == causality and _is_number(one)]

    def sizes(self, names: Iterable[str]) -> Float[np.ndarray, " n"]:
        """The usual sizes that variables declare; 1 for others."""
        return usual_sizes(self.variables[name] for name in names)

    def units(self, names: Iterable[str]) -> Mapping[str, str]:
        """The units that variables declare, by name."""
        variables = {name: self.variables[name] for name in names}
        declared = {name: one.unit or getattr(one.declaredType, "unit", None) for name, one in variables.items()}
        return {name: unit.replace(".", " ") for name, unit in declared.items() if unit}

    def refuse_other_inputs(self, names: Iterable[Any], known: Sequence[str]) -> None:
        """Raise `ProblemError` for the first of some inputs that is not known."""
        for name in names:
            if name not in known:
                hint = meant(f"{name}", known)
                raise ProblemError(f"FMU '{self.name}': expected inputs among {known}; received {shown(name)}.{hint}")

    def checked(self, names: Iterable[Any], *, is_set: bool = True, of_any_type: bool = False) -> list[str]:
        """Names, each checked to be of a real variable, and of one that may be set before the start if it `is_set`."""
        names = list(names)
        for name in names:
            if name not in self.variables:
                hint = meant(f"{name}", self.variables) or " Print it to see its names."
                raise ProblemError(f"FMU '{self.name}' has no variable {shown(name)}.{hint}")
            one = self.variables[name]
            if not (of_any_type or _is_number(one)):
                raise ProblemError(
                    f"FMU '{self.name}': expected a real variable of one number; received '{name}' of type {one.type}. "
                    "Other types are set for all runs by Fmu(settings={...})."
                )
            is_first = one.variability != "constant" and one.initial == "exact"
            if is_set and not (is_first or one.causality in ("input", "structuralParameter")):
                raise ProblemError(
                    f"FMU '{self.name}': expected a parameter, an input or an initial value; received '{name}', which "
                    f"the FMU computes (causality '{one.causality}', variability '{one.variability}')."
                )
        return names


# Each task that a worker is sent has the model anew: the FMU stays open for the next one.
@functools.lru_cache(maxsize=4)
def _opened_again(digest: str, path: Path, settings: tuple[tuple[str, Any], ...], *given: Any) -> Fmu:
    kind, own_process, time_limit = given
    fmu = Fmu(path, settings=dict(settings), kind=kind, own_process=own_process, time_limit=time_limit)
    if fmu._digest != digest:
        raise ProblemError(f"FMU '{fmu.name}': '{path}' has changed since the model was made: make the model again.")
    return fmu


def _unpacked(path: Path, folder: Path) -> tuple[Any, str]:
    """The model description of an FMU, which is unpacked into a folder, and the digest of its file.

    Raises `ProblemError` for a file that is no FMU of FMI 2 or 3; `MissingExtraError` without FMPy.
    """
    fmpy = optional("fmpy", "Fmu", "'aleator[fmu]'")
    try:
        digest = hashlib.sha256(content_of(path)).hexdigest()
        description = fmpy.read_model_description(str(path))
        fmpy.extract(str(path), str(folder))
        platforms = fmpy.supported_platforms(str(folder))
    except Exception as error:
        words = " ".join(str(getattr(error, "problems", [error])[0]).split())[:_LONGEST].rstrip(".")
        raise ProblemError(f"Fmu: '{path}' cannot be read as an FMU ({words}).") from error
    if description.fmiVersion.startswith("1"):
        raise ProblemError(f"FMU '{path.stem}': expected FMI 2 or 3; received FMI {description.fmiVersion}.")
    if fmpy.platform not in platforms:
        raise ProblemError(
            f"FMU '{path.stem}': expected a binary for this machine, {fmpy.platform}; it has "
            f"{', '.join(platforms) or 'none'}: export it for this one, or compile sources by `fmpy compile`."
        )
    return description, digest


def _is_number(variable: Any) -> bool:
    return variable.type in _REAL and not variable.shape


def _of_type(what: str, kind: str, value: Any) -> Any:
    """A value of a type of FMI, to its last digit. Raises `ProblemError` for any other, which an FMU would misread."""
    if kind in ("String", "Binary"):
        return one_of(what, value, str if kind == "String" else bytes)
    with suppress(TypeError, ValueError, OverflowError):
        number = np.dtype(_IN_NUMPY.get(kind, kind.lower())).type(value)
        if np.ndim(value) == 0 and number == value:
            return number.item()
    raise refusal(what, f"a value of FMI's type {kind}", value)


# --- Processes --------------------------------------------------------------------------------------------------------


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
        self.process: Any = subprocess.Popen([get_executable(), "-c", _CODE], **pipes, **in_group())
        self.end = weakref.finalize(self, _end, self.process, self._printed)
        # Before it is ready, it imports: that is no run.
        self._answered(sys.path, " before it began", None)
        self._answered(self._opening, " while its library was loaded", self._limit)

    def _answered(self, question: Any, where: str, limit: float | None) -> Any:
        """What the process answers. It is ended if that takes longer than a limit, or is interrupted."""
        process, answer, is_late = self.process, None, threading.Event()

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


def _end(process: Any, printed: IO[bytes]) -> None:
    """End a process, if it has not ended, and close its files."""
    if process.poll() is None:
        end_group(process.pid)
    process.wait()
    for stream in (process.stdin, process.stdout, printed):
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
