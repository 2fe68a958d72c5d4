"""Results in a run's folder: for each a line of its journal, which says what was begun, by whom, and how it ended; and
files: objects by Python's pickle, and beside them labelled arrays for any program that reads netCDF.

What takes long is kept part by part until its whole result is.

Reading an object runs code, as importing a module does: a model's own classes are in it. So objects are read only from
files that belong to this user, that nobody else can write to, and whose content is what was written for their key.
"""

import hashlib
import json
import os
import pickle
import socket
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.identity import joined, lasting_digest, versions
from aleator._core.journalled import AbstractParts, read_lines
from aleator._core.programs import is_private
from aleator.design import Problem
from aleator.nlp import Status
from aleator.reporting import KINDS, tree, write_whole

# --- Lines ------------------------------------------------------------------------------------------------------------

FILE = "journal.jsonl"
"""The journal in a run's folder, a line for each beginning and each end of a result."""

RUNNING, INTERRUPTED, DONE, INFEASIBLE, FAILED = "running", "interrupted", "done", "infeasible", "failed"
# Its code, or a library, is another now; its file is missing or damaged.
STALE, LOST = "stale", "lost"


def state_of(result: Any) -> str:
    """How far a result is, of whatever kind: also of arrays, whose attributes of these names are no truth values."""
    status = getattr(result, "status", Status.SOLVED)
    if status is Status.INTERRUPTED or getattr(result, "interrupted", False) is True:
        return INTERRUPTED
    if status is Status.INFEASIBLE:
        return INFEASIBLE
    return FAILED if getattr(result, "ok", True) is False else DONE


@final
@dataclass(frozen=True)
class Entry:
    """One result of a journal.

    - `key`: a digest of all that it follows from; `parts`: digests of these by name, such as `equations`;
    - `what`: `solve` or `validate` with the model's name, or `work` with its own;
    - `state`: how far it is, such as `done`; `why`: the reason of a failure;
    - `name`: what the study calls it, such as `designs/robust`, or else where it was asked for, such as `pareto, at
      stress = 0.4`;
    - `host`, `process`, `since`: who began it, and when (UTC); `seconds`: how long it took;
    - `file`: where its result is, relative to the folder: that of an infeasible problem too, and one that is stale.
    """

    key: str
    what: str
    state: str
    parts: Mapping[str, str] = field(default_factory=dict)
    host: str = ""
    process: int = 0
    since: str = ""
    seconds: float = 0.0
    file: str = ""
    why: str = ""
    name: str = ""

    @classmethod
    def begun(cls, key: str, what: str, parts: Mapping[str, str], name: str = "") -> "Entry":
        """An entry of this process that begins now."""
        since = datetime.now(UTC).isoformat(timespec="seconds")
        return cls(key, what, RUNNING, parts, socket.gethostname(), os.getpid(), since, name=name)

    def line(self) -> str:
        """The entry as one line of JSON."""
        return json.dumps(asdict(self), ensure_ascii=False) + "\n"


def read(path: Path) -> tuple[dict[str, Entry], int]:
    """The last entry of each key, in the order of beginnings, and the size of a journal's lines in bytes.

    A last line that was cut off is ignored: its result is computed again. A missing file is an empty journal. Raises
    `ProblemError` for a line that is no entry.
    """
    try:
        lines, size, _ = read_lines(path)
    except OSError as error:
        raise ProblemError(f"The journal '{path}' cannot be read ({error.strerror}).") from error
    entries: dict[str, Entry] = {}
    for line in lines:
        try:
            entry = Entry(**line.value)
        except TypeError as error:
            raise ProblemError(
                f"'{path}', line {line.number}: expected an entry of a journal; received {line.text[:60]!r}. Remove "
                "the line, or begin another folder; finished results in other lines stay valid."
            ) from error
        entries[entry.key] = entry
    return entries, size


# --- Keys -------------------------------------------------------------------------------------------------------------


def identity(
    what: str, given: Mapping[str, Any], key_of: Callable[[Any], str] = lambda _: ""
) -> tuple[str, dict[str, str]]:
    """The key of a result that follows from what is given, and digests of all this by name.

    - `key_of`: the key of what is itself a result, by which it is identified; empty for anything else.

    Raises `DoubtError` if another process could not tell whether it is the same.
    """
    parts = {"versions": versions()}
    for name, one in given.items():
        if isinstance(one, Problem):
            parts |= {name: lasting_digest(_parts_of(one), declared=True), "equations": _equations(one)}
        else:
            parts[name] = lasting_digest(key_of(one) or one)
    return joined([what, *(f"{name} {digest}" for name, digest in sorted(parts.items()))]), parts


def _parts_of(problem: Problem) -> tuple[Any, ...]:
    """A problem without the digests of its code."""
    return replace(problem.simulation, equations=None), problem.objective, problem.constraints, problem.expansion


def _equations(problem: Problem) -> str:
    """The digest of a problem's code: of its equations, and all of it where they do not show it."""
    return joined([problem.physics.text, "" if problem.is_declared else lasting_digest(_parts_of(problem))])


# --- Files ------------------------------------------------------------------------------------------------------------

FINISHED = "finished"
"""The folder of results in a run's folder."""

_OTHERS = 0o022  # may write
_DIGEST = hashlib.sha256().digest_size
_NAMED = 24  # characters of a key in the name of a file


def write_result(folder: Path, what: str, key: str, result: Any) -> str:
    """Write a result into a run's folder and return its file, which takes the place of an earlier one of its key.

    Raises `ProblemError` if it cannot be written, or holds what no other process could read.
    """
    path = folder / FINISHED / f"{what.split()[0]}-{key[:_NAMED]}.pickle"
    try:
        content = pickle.dumps(result)
    except Exception as error:  # of whatever kind a user's object raises
        raise ProblemError(f"it holds an object that no other process could read ({error}).") from error
    if isinstance(result, KINDS):
        arrays = bytes(tree({"result": result}).to_netcdf(engine="h5netcdf"))
        write_whole(path.with_suffix(".nc"), lambda file: file.write_bytes(arrays))
    _write(path, key, content)
    return str(path.relative_to(folder))


def read_result(path: Path, key: str) -> Any:
    """The result of a key in a file. Raises `ProblemError` if it is not there, or cannot be read here."""
    content = content_of(path, key)
    try:
        return pickle.loads(content)
    except ModuleNotFoundError as error:
        raise ProblemError(
            f"'{path}' needs the module '{error.name}', in which its model is written: import it first."
        ) from error
    except Exception as error:  # pickle has no common one
        raise ProblemError(f"'{path}' cannot be read ({type(error).__name__}: {error}).") from error


def content_of(path: Path, key: str) -> bytes:
    """The content of a file, unless it is another than was written for its key, or others could have written it.

    Raises `ProblemError` then.
    """
    try:
        with path.open("rb") as file:
            private, digest, content = is_private(os.fstat(file.fileno())), file.read(_DIGEST), file.read()
    except OSError as error:
        raise ProblemError(f"'{path}' cannot be read ({error.strerror}).") from error
    if not private:
        raise ProblemError(
            f"'{path}' could have been changed by others: expected a file that only its owner can write."
        )
    if digest != _digest(key, content):
        raise ProblemError(f"'{path}' is not what was written there.")
    return content


def _write(path: Path, key: str, content: bytes) -> None:
    """Write a file atomically that its owner alone may change. Raises `ProblemError` if it cannot be written."""
    written = write_whole(path, lambda file: file.write_bytes(_digest(key, content) + content))
    written.chmod(written.stat().st_mode & ~_OTHERS)


def _digest(key: str, content: bytes) -> bytes:
    return hashlib.sha256(f"{key}\0".encode() + content).digest()


@final
class Parts(AbstractParts):
    """One file a part, beside the results.

    - `key`: that of the result; `warn`: is told why a part could not be kept.
    """

    def __init__(self, folder: Path, key: str, warn: Callable[[str], None]):
        self._folder, self._key, self._warn = folder / FINISHED, key, warn

    @override
    def recall(self, number: int) -> Any:
        try:
            return read_result(self._place(number), f"{self._key} {number}")
        except ProblemError:  # what is missing, or was cut off by a crash, is computed again
            return None

    @override
    def keep(self, number: int, part: Any) -> None:
        try:
            _write(self._place(number), f"{self._key} {number}", pickle.dumps(part))
        except (ProblemError, OSError) as error:
            self._warn(f"a part of a result is not kept: {error}")

    def drop(self) -> None:
        """Delete all parts: the whole result is kept, or is to be computed afresh."""
        for path in self._folder.glob(f"{self._key[:_NAMED]}-*.part"):
            path.unlink(missing_ok=True)

    def _place(self, number: int) -> Path:
        return self._folder / f"{self._key[:_NAMED]}-{number}.part"
