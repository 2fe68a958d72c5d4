"""The lines of a journal: what waits, what was begun, by whom, and how it ended."""

import enum
import json
import os
import socket
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple, final

from aleator._core.errors import ProblemError
from aleator._core.journalled import read_lines

FILE = "journal.jsonl"
"""The journal in a run's folder, a line for each beginning and each end of a result."""


class State(enum.Enum):
    """How far a result is."""

    WAITING = "waiting"
    WITHDRAWN = "withdrawn"
    RUNNING = "running"
    INTERRUPTED = "interrupted"
    DONE = "done"
    INFEASIBLE = "infeasible"
    FAILED = "failed"
    STALE = "stale"
    LOST = "lost"


@final
@dataclass(frozen=True)
class Entry:
    """One result of a journal.

    - `key`: a digest of all that it follows from; `parts`: digests of these by name, such as `equations`;
    - `what`: `solve` or `validate` with the model's name, or `work` with its own; `state`;
    - `why`: the reason of a failure;
    - `name`: what the study calls it, such as `designs/robust` or `stress = 0.4`, if it has a name for it;
    - `host`, `process`, `since`: who began it, and when (UTC); `seconds`: how long it took;
    - `file`: where its result is, relative to the folder; `digest`: of that file.
    """

    key: str
    what: str
    state: State
    parts: Mapping[str, str] = field(default_factory=dict)
    host: str = ""
    process: int = 0
    since: str = ""
    seconds: float = 0.0
    file: str = ""
    digest: str = ""
    why: str = ""
    name: str = ""

    @classmethod
    def begun(cls, key: str, what: str, parts: Mapping[str, str], name: str = "") -> "Entry":
        """An entry of this process that begins now."""
        since = datetime.now(UTC).isoformat(timespec="seconds")
        return cls(key, what, State.RUNNING, dict(parts), socket.gethostname(), os.getpid(), since, name=name)

    @classmethod
    def awaited(cls, what: str, problem: str, name: str) -> "Entry":
        """An entry that waits for its turn. What it will start from is not known yet: only its problem, by a digest."""
        begun = cls.begun("", what, {"problem": problem}, name)
        return replace(begun, key=begun.waits_as, state=State.WAITING)

    def instead_of(self, earlier: "Entry") -> "Entry":
        """The same, beginning while an earlier result is there, which stays until this one replaces it."""
        kept = {"file": earlier.file, "digest": earlier.digest, "seconds": earlier.seconds}
        return replace(self, name=self.name or earlier.name, **kept)

    @property
    def waits_as(self) -> str:
        """The key under which it waits before it begins."""
        return f"waiting {self.what} {self.parts.get('problem', '')}"

    @property
    def is_finished(self) -> bool:
        """Whether its result is there: that of an infeasible problem too, and one that nobody asks for any more."""
        return bool(self.file)

    def line(self) -> str:
        """The entry as one line of JSON."""
        return json.dumps({**vars(self), "state": self.state.value}, ensure_ascii=False) + "\n"

    def __str__(self) -> str:
        return self.told(self.what)

    def told(self, what: str) -> str:
        """The entry as a line for people, in which what it is is called `what`."""
        told = [what, self.name, self._when(), self.why]
        return f"{self.state.value:<12} {'  '.join(one for one in told if one)}"

    def _when(self) -> str:
        if self.is_finished and self.state is not State.RUNNING:
            return f"{self.seconds:.2g} s"
        return "" if self.state is State.WAITING else f"since {self.since} on {self.host} ({self.process})"


class Entries(NamedTuple):
    """The last entry of each key, in order of their beginnings, and the size of their lines in bytes."""

    by_key: dict[str, Entry]
    size: int


def read(path: Path) -> Entries:
    """What a journal says; nothing if there is no file.

    A last line that was cut off is ignored: its result is computed again. Raises `ProblemError` for anything else that
    is no entry, with its line.
    """
    try:
        lines, size, _ = read_lines(path)
    except OSError as error:
        raise ProblemError(f"The journal '{path}' cannot be read ({error.strerror}).") from error
    entries: dict[str, Entry] = {}
    for line in lines:
        try:
            one = Entry(**{**line.value, "state": State(line.value["state"])})
        except (ValueError, TypeError, KeyError) as error:
            raise ProblemError(
                f"'{path}', line {line.number}: expected an entry of a journal; received {line.text[:60]!r}. Remove "
                "the line, or begin another folder; finished results in other lines stay valid."
            ) from error
        note(entries, one)
    return Entries(entries, size)


def note(entries: dict[str, Entry], one: Entry) -> None:
    """Let a further line change what a journal says: what begins does not wait any more."""
    if one.state is not State.WAITING:
        entries.pop(one.waits_as, None)
    if one.state is State.WITHDRAWN:
        entries.pop(one.key, None)
    else:
        entries[one.key] = one


def named(entries: Iterable[Entry]) -> dict[str, Entry]:
    """The results that are there, by what was done, counted in the order of their beginnings: `solve Bar 1`."""
    counted: dict[str, int] = {}
    found: dict[str, Entry] = {}
    for one in entries:
        if one.is_finished and one.state is not State.STALE:
            counted[one.what] = counted.get(one.what, 0) + 1
            found[f"{one.what} {counted[one.what]}"] = one
    return found


def unfinished(one: Entry, state: State = State.INTERRUPTED, why: str = "") -> Entry:
    """An entry that ended without a result; one that was to replace an earlier result has this still."""
    if not one.is_finished:
        return replace(one, state=state, why=why)
    return replace(one, state=State.STALE, why=f"its replacement: {state.value}{f', {why}' if why else ''}")


def seen(one: Entry) -> Entry:
    """An entry as a reader sees it: what a process of this machine had begun that is no more was interrupted."""
    is_over = one.state is State.RUNNING and one.host == socket.gethostname() and _has_ended(one.process)
    return unfinished(one) if is_over else one


def _has_ended(process: int) -> bool:
    """Whether there is no such process; no where that cannot be told."""
    if sys.platform == "win32" or process <= 0:
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False
