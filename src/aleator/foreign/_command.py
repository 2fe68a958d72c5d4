"""`Command`: a command line as a function of its inputs."""

import json
import re
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, final

import numpy as np

from aleator._core import border
from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError, SimulationError
from aleator._core.executors import ended_with, endings, exit_told, in_group
from aleator._core.files import json_of
from aleator.foreign._runs import refuse_traced

# A placeholder in an argument, such as {mass}.
_PLACEHOLDER = re.compile(r"\{([A-Za-z_]\w*)\}")

# As much of the end of stderr, or of an output that is no JSON, as a message repeats.
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
      object of these by name. A number in the last line is refused after a list or an object, and a list after an
      object, since either may be meant;
    - `time_limit`: seconds after which a run is ended, with all processes that it started.

    Each run has a temporary folder, which is deleted after it. Processes that a program leaves behind when it ends by
    itself, such as a licence server, live on.

    Raises `ProblemError` if the program is not found, or if an input reaches it nowhere; a call raises
    `SimulationError` if a run exceeds its time, ends with another exit code than 0, writes no JSON of numbers, or
    leaves open which of two lines is its output.
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
        own = {self.input_file, self.output_file}
        absolute = tuple(name if name in own else _absolute(name) for name in arguments)
        object.__setattr__(self, "arguments", absolute)
        if self.input_file is None and not self._placeholders:
            raise ProblemError(
                f"Command: no input reaches {self.__name__}. Write {{name}} in the place of an argument, or give an "
                "input_file."
            )

    @property
    def __name__(self) -> str:
        """The program, and the first file among its arguments, for messages."""
        files = [Path(argument).name for argument in self.arguments[1:] if Path(argument).is_file()]
        return " ".join([Path(self.arguments[0]).name, *files[:1]])

    @property
    def _placeholders(self) -> set[str]:
        return {name for argument in self.arguments for name in _PLACEHOLDER.findall(argument)}

    def __call__(self, inputs: Mapping[str, Any]) -> Pytree:
        """The outputs of one run."""
        self._refuse_unfit(inputs)
        # What a process that was ended still holds open must not hide why it was.
        own_folder = tempfile.TemporaryDirectory(prefix="aleator-", ignore_cleanup_errors=True)
        with own_folder as name, tempfile.TemporaryFile() as output:
            folder = Path(name)
            if self.input_file is not None:
                (folder / self.input_file).write_text(json.dumps(_as_json(inputs)), encoding="utf-8")
            self._run([_filled(argument, inputs) for argument in self.arguments], folder, output)
            return _numbers(self._text(folder, output), self.output_file or "its standard output")

    def _refuse_unfit(self, inputs: Any) -> None:
        refuse_traced(self, inputs)
        if not isinstance(inputs, Mapping):
            raise border.refusal("Command: its model", "a dict of inputs by name", inputs)
        names = {str(name) for name in inputs}
        if unknown := self._placeholders - names:
            raise ProblemError(f"Command: {self.__name__} asks for {sorted(unknown)}; expected some of {list(inputs)}.")
        if self.input_file is None and (unused := names - self._placeholders):
            raise ProblemError(
                f"Command: {sorted(unused)} reach {self.__name__} nowhere. Write them in braces in the place of an "
                "argument, give an input_file, or drop them."
            )

    def _run(self, arguments: list[str], folder: Path, output: IO[bytes]) -> None:
        before = endings()
        with tempfile.TemporaryFile() as errors:
            try:
                process = subprocess.Popen(
                    arguments, cwd=folder, stdin=subprocess.DEVNULL, stdout=output, stderr=errors, **in_group()
                )
            except (OSError, ValueError) as error:
                said = getattr(error, "strerror", None) or error
                raise ProblemError(f"Command: {arguments[0]} cannot be run ({said}).") from error
            with process, ended_with(process.pid, lambda: process.returncode is not None, before):
                try:
                    code = process.wait(self.time_limit)
                except subprocess.TimeoutExpired as error:
                    raise SimulationError(f"it was ended after its time limit of {self.time_limit:g} s") from error
            if code:
                raise SimulationError(f"it ended by {exit_told(code)}; {_end_of(errors)}")

    def _text(self, folder: Path, output: IO[bytes]) -> str:
        if self.output_file is None:
            output.seek(0)
            return output.read().decode(errors="replace")
        try:
            return (folder / self.output_file).read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            raise SimulationError(f"it ended without writing {self.output_file}") from error


def _absolute(argument: str) -> str:
    """The path of a file from the root; any other argument as it is."""
    return str(Path(argument).absolute()) if argument and Path(argument).is_file() else argument


def _filled(argument: str, inputs: Mapping[str, Any]) -> str:
    return _PLACEHOLDER.sub(lambda found: _as_text(found[1], inputs[found[1]]), argument)


def _as_text(name: str, value: Any) -> str:
    """A number with all its digits, or a text."""
    if isinstance(value, Mapping) or np.ndim(value):
        raise border.refusal(f"Command: {{{name}}}", "one number; arrays and dicts need an input_file", value)
    return str(_as_json(value))


def _as_json(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _as_json(part) for name, part in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, bool | int | float | str):
        return value
    raise border.refusal("Command: an input", "a number, an array or a text", value)


def _end_of(errors: IO[bytes]) -> str:
    """The end of what a program wrote to stderr."""
    errors.seek(max(0, errors.seek(0, 2) - 10 * _SHOWN))
    lines = [line.strip() for line in errors.read().decode(errors="replace").splitlines() if line.strip()]
    return f"its stderr ends with: {' / '.join(lines[-3:])[-_SHOWN:]}" if lines else "its stderr is empty"


def _numbers(text: str, source: str) -> Pytree:
    """JSON as arrays of numbers. Raises `SimulationError` for anything else, and where either of two may be meant."""
    *before, last = [line.strip() for line in text.splitlines() if line.strip()] or [""]
    for part in (text, last):
        try:
            parsed = json_of(part, object_pairs_hook=_once_each)
        except ValueError:
            continue
        if part is last and (other := _rival(before, parsed)) is not None:
            raise SimulationError(
                f"expected one output in {source}; received the last line {last[-_SHOWN:]!r} after "
                f'{other[:_SHOWN]!r}, and either may be meant. Write an object, such as {{"y": 1.5}}, in the last line'
            )
        return _arrays(parsed, "the output")
    said = f"received {last[-_SHOWN:]!r}" if last else "received nothing"
    raise SimulationError(f"expected JSON in {source}; {said}")


def _rival(before: list[str], parsed: Any) -> str | None:
    """The last line before the parsed one that rather looks like an output: an object, or a list before a number."""
    if isinstance(parsed, dict):
        return None
    return next((line for line in reversed(before) if _begins(line, lists=not isinstance(parsed, list))), None)


def _begins(line: str, *, lists: bool) -> bool:
    """Whether an object begins in a line, which may go on in others or be printed as Python does, or a list, which
    `[info] ...` is not.
    """
    if line.startswith("{") or not lists:
        return line.startswith("{")
    if line == "[":
        return True
    try:
        return isinstance(json_of(line), list)
    except ValueError:
        return False


def _once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON. Raises `SimulationError` for a name that it has twice."""
    names = [name for name, _ in pairs]
    for name in names:
        if names.count(name) > 1:
            raise SimulationError(f"expected each output once; received {name!r} twice")
    return dict(pairs)


def _arrays(parsed: Any, what: str) -> Pytree:
    if isinstance(parsed, dict):
        return {name: _arrays(value, f"the output {name!r}") for name, value in parsed.items()}
    try:
        array = np.array(parsed)
    except ValueError:
        array = None
    if array is None or array.dtype.kind not in "iuf":
        raise SimulationError(f"{what}: expected numbers; received {border.shown(parsed)}")
    return array.astype(float)
