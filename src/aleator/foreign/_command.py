"""Functions each of whose calls has a process of its own: `Command`, a command line, and `Isolated`, one of Python."""

import hashlib
import json
import multiprocessing
import re
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, final

import jax
import numpy as np

from aleator._core import border
from aleator._core.arrays import Pytree
from aleator._core.border import json_of
from aleator._core.errors import ProblemError, SimulationError
from aleator._core.executors import ended_with, endings, exit_told, in_group, last_lines, report

# A placeholder in an argument, such as {mass}.
_PLACEHOLDER = re.compile(r"\{([A-Za-z_]\w*)\}")
# As much of an output that is no JSON as a message repeats.
_SHOWN = 160


@final
@dataclass(frozen=True)
class Command:
    """A command line as a function of a dict of inputs: `Command(["python", "rod.py", "{mass}", "{length}"])`.

    - `arguments`: the program and its arguments, without a shell. `{name}` is replaced by the input of that name, with
      all its digits. Arguments that name a file are made absolute at once, because each run has a folder of its own;
    - `input_file`: the name of a file in that folder, into which all inputs are written as a JSON object;
    - `output_file`: the name of the JSON file that the program writes there; without one, its standard output is read.
      Where all of it is no JSON, its last line is. Outputs are a number, a list of numbers (of lists, ...), or an
      object of these by name;
    - `time_limit`: seconds after which a run is ended, with all processes that it started.

    Each run has a temporary folder, which is deleted after it. Processes that a program leaves behind when it ends by
    itself, such as a licence server, live on.

    Raises `ProblemError` if the program is not found, or if an input reaches it nowhere; a call raises
    `SimulationError` if a run exceeds its time, ends with another exit code than 0, or writes no JSON of numbers.
    """

    arguments: Sequence[str]
    input_file: str | None = None
    output_file: str | None = None
    time_limit: float | None = None

    def __post_init__(self) -> None:
        arguments = border.members("Command: arguments", self.arguments, str)
        if not arguments or not arguments[0]:
            raise border.refusal("Command: arguments", "a program and its arguments", self.arguments)
        for what, name in (("input_file", self.input_file), ("output_file", self.output_file)):
            if name is not None and (not isinstance(name, str) or not name or Path(name).name != name):
                raise border.refusal(f"Command: {what}", "the name of a file, without a folder", name)
        if self.time_limit is not None:
            object.__setattr__(self, "time_limit", border.positive("Command: time_limit", self.time_limit))
        own = {"", self.input_file, self.output_file}
        absolute = [str(Path(one).absolute()) if one not in own and Path(one).is_file() else one for one in arguments]
        object.__setattr__(self, "arguments", tuple(absolute))

    @property
    def __name__(self) -> str:
        """The program, and the first file among its arguments, for messages."""
        files = [Path(argument).name for argument in self.arguments[1:] if Path(argument).is_file()]
        return " ".join([Path(self.arguments[0]).name, *files[:1]])

    def digest(self, version: str) -> str:
        """A digest of the command, of the contents of the files that it names, and of a version."""
        paths = [Path(argument) for argument in self.arguments]
        files = [hashlib.sha256(path.read_bytes()).hexdigest() for path in paths if path.is_file()]
        parts = [list(self.arguments), self.input_file, self.output_file, files, version]
        return hashlib.sha256(repr(parts).encode()).hexdigest()

    def __call__(self, inputs: Mapping[str, Any]) -> Pytree:
        """The outputs of one run."""
        border.one_of("Command: its model", inputs, Mapping, "{'mass': 1.0}")
        inputs = jax.tree.map(lambda leaf: leaf if isinstance(leaf, str) else np.asarray(leaf).tolist(), dict(inputs))
        asked = {name for argument in self.arguments for name in _PLACEHOLDER.findall(argument)}
        if self.input_file is None and (unused := set(inputs) - asked):
            raise ProblemError(
                f"Command: {sorted(unused)} reach {self.__name__} nowhere. Write them in braces in the place of an "
                "argument, give an input_file, or drop them."
            )
        # What a process that was ended still holds open must not hide why it was.
        own_folder = tempfile.TemporaryDirectory(prefix="aleator-", ignore_cleanup_errors=True)
        with own_folder as name, tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
            folder = Path(name)
            if self.input_file is not None:
                (folder / self.input_file).write_text(json.dumps(inputs), encoding="utf-8")
            arguments = [_PLACEHOLDER.sub(lambda name: str(inputs[name[1]]), one) for one in self.arguments]
            self._run(arguments, folder, output, errors)
            if self.output_file is None:
                output.seek(0)
                return _numbers(output.read().decode(errors="replace"), "its standard output")
            try:
                written = (folder / self.output_file).read_text(encoding="utf-8", errors="replace")
            except OSError as error:
                raise SimulationError(f"it ended without writing {self.output_file}") from error
            return _numbers(written, self.output_file)

    def _run(self, arguments: list[str], folder: Path, output: IO[bytes], errors: IO[bytes]) -> None:
        before = endings()
        try:
            process = subprocess.Popen(
                arguments, cwd=folder, stdin=subprocess.DEVNULL, stdout=output, stderr=errors, **in_group()
            )
        except (OSError, ValueError) as error:
            words = getattr(error, "strerror", None) or error
            raise ProblemError(f"Command: {arguments[0]} cannot be run ({words}).") from error
        with process, ended_with(process.pid, lambda: process.returncode is not None, before):
            try:
                code = process.wait(self.time_limit)
            except subprocess.TimeoutExpired as error:
                raise SimulationError(f"it was ended after its time limit of {self.time_limit:g} s") from error
        if code:
            lines = last_lines(errors)
            words = f"ends with: {lines}" if lines else "is empty"
            raise SimulationError(f"it ended by {exit_told(code)}; its stderr {words}")


def _numbers(text: str, source: str) -> Pytree:
    """All of a text, or its last line, as arrays of numbers. Raises `SimulationError` if neither is JSON of these."""
    lines = [line for line in text.splitlines() if line.strip()]
    for one in (text, *lines[-1:]):
        with suppress(ValueError):
            return arrays_of(json_of(one))
    received = f"received {lines[-1][-_SHOWN:]!r}" if lines else "received nothing"
    raise SimulationError(f"expected JSON in {source}; {received}")


def arrays_of(parsed: Any, what: str = "the output") -> Pytree:
    """What JSON says as an array of numbers, or a dict of these. Raises `SimulationError` for anything else."""
    if isinstance(parsed, dict):
        return {name: arrays_of(value, f"the output {name!r}") for name, value in parsed.items()}
    try:
        return border.real_array(what, parsed, "numbers")
    except ProblemError as error:
        raise SimulationError(str(error).rstrip(".")) from error


@final
@dataclass(frozen=True)
class Isolated:
    """A function each of whose calls has a Python process of its own: for functions that may hang or crash.

    A function that hangs in a thread or in the process of an executor cannot be ended without ending the others there.
    Here it can: `BlackBox(al.foreign.Isolated(simulate, time_limit=60.0), executor=ThreadPoolExecutor(4))`. The price
    is the start of a process for each call, which takes a second or more: Python, JAX and the function's own imports.

    - `function`: stands at the top level of a module, so that the process finds it. In a script, whatever is not a
      definition belongs under `if __name__ == "__main__":`;
    - `time_limit`: seconds from the start of the process, after which it is ended, with all processes that it started.

    A call raises `SimulationError` if the process exceeds its time or ends by itself, or if the function raises.
    """

    function: Callable[[Any], Pytree]
    time_limit: float | None = None

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise border.refusal("Isolated", "a function", self.function)
        if self.time_limit is not None:
            object.__setattr__(self, "time_limit", border.positive("Isolated: time_limit", self.time_limit))

    @property
    def __name__(self) -> str:
        """The name of the function, for messages."""
        return getattr(self.function, "__name__", type(self.function).__name__)

    def __call__(self, realised: Pytree) -> Pytree:
        """The outputs of the function at one realisation."""
        before, context = endings(), multiprocessing.get_context("spawn")
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=report, args=(sender, self.function, realised))
        process.start()
        sender.close()
        try:
            with receiver, ended_with(process.pid or 0, lambda: not process.is_alive(), before):
                if not receiver.poll(self.time_limit):
                    raise SimulationError(f"it was ended after its time limit of {self.time_limit:g} s")
                returned, raised = receiver.recv()
        except EOFError as error:
            process.join()
            raise SimulationError(f"its process ended by itself, by {exit_told(process.exitcode)}") from error
        finally:
            process.kill()  # It may not have begun to lead a group.
            process.join()
        if raised is not None:
            raise SimulationError(f"it raised {raised}")
        return returned
