"""The lines of a journal: what waits, what was begun, by whom, and how it ended; `load`: the results as objects."""

import enum
import json
import os
import socket
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator._core.border import meant
from aleator._core.errors import ProblemError
from aleator._core.journalled import read_lines
from aleator.journalling import _results
from aleator.reporting import as_path, has_writer, words

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
        """The same, beginning while an earlier result is available, which stays until this one replaces it."""
        result = {"file": earlier.file, "digest": earlier.digest, "seconds": earlier.seconds}
        return replace(self, name=self.name or earlier.name, **result)

    @property
    def waits_as(self) -> str:
        """The key under which it waits before it begins."""
        return f"waiting {self.what} {self.parts.get('problem', '')}"

    @property
    def is_finished(self) -> bool:
        """Whether its result is available: that of an infeasible problem too, and one that is stale."""
        return bool(self.file)

    def unfinished(self, state: State = State.INTERRUPTED, why: str = "") -> "Entry":
        """The same, ended without a result; one that was to replace an earlier result still has that one."""
        if not self.is_finished:
            return replace(self, state=state, why=why)
        return replace(self, state=State.STALE, why=f"its replacement: {state.value}{f', {why}' if why else ''}")

    def is_abandoned(self, busy: bool = True) -> bool:
        """Whether a process of this machine had begun it and works no more; `busy`: whether one writes its folder."""
        is_ours = self.state is State.RUNNING and self.host == socket.gethostname()
        return is_ours and not (busy and _is_alive(self.process))

    def line(self) -> str:
        """The entry as one line of JSON."""
        return json.dumps({**vars(self), "state": self.state.value}, ensure_ascii=False) + "\n"

    def described(self, what: str) -> str:
        """The entry as a line for people, in which `what` stands for its work."""
        time = "" if self.state is State.WAITING else f"since {self.since} on {self.host} ({self.process})"
        if self.is_finished and self.state is not State.RUNNING:
            time = f"{self.seconds:.2g} s"
        return f"{self.state.value:<12} {'  '.join(filter(None, [what, self.name, time, self.why]))}"


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
            note(entries, Entry(**{**line.value, "state": State(line.value["state"])}))
        except (ValueError, TypeError, KeyError) as error:
            raise ProblemError(
                f"'{path}', line {line.number}: expected an entry of a journal; received {line.text[:60]!r}. Remove "
                "the line, or begin another folder; finished results in other lines stay valid."
            ) from error
    return entries, size


def note(entries: dict[str, Entry], entry: Entry) -> None:
    """Let a further line change what a journal says: what begins does not wait any more."""
    if entry.state is not State.WAITING:
        entries.pop(entry.waits_as, None)
    if entry.state is State.WITHDRAWN:
        entries.pop(entry.key, None)
    else:
        entries[entry.key] = entry


def numbered(entries: Iterable[Entry]) -> dict[str, Entry]:
    """The available results by what was done, counted in the order of their beginnings: `solve Bar 1`."""
    counts: dict[str, int] = {}
    results: dict[str, Entry] = {}
    for entry in entries:
        if entry.is_finished and entry.state is not State.STALE:
            counts[entry.what] = counts.get(entry.what, 0) + 1
            results[f"{entry.what} {counts[entry.what]}"] = entry
    return results


def _is_alive(process: int) -> bool:
    """Whether there is such a process, or that cannot be known."""
    if sys.platform != "win32":
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return False
        except PermissionError:  # somebody else's
            return True
    return True


# --- Results as objects ----------------------------------------------------------------------------------------------


@final
class Loaded(Mapping[str, Any]):
    """The results of a run by name, read from their files when they are asked for. `print(loaded)` shows all entries.

    - `entries`: every result that was begun, with its state, who began it and when, how long it took, and its file.

    Names are those of what was done, counted in the order of their beginnings: `"solve Cushion 1"`,
    `"validate Cushion 1"`; those that a study gives, such as `"designs/robust"`, are known as well.
    """

    def __init__(self, folder: Path, entries: tuple[Entry, ...]):
        self._folder, self.entries = folder, entries
        self._numbered = numbered(entries)

    @override
    def __getitem__(self, name: str) -> Any:
        entries = self._called(name)
        if not entries:
            known = [*self._numbered, *(entry.name for entry in self._numbered.values() if entry.name)]
            hint = meant(name, known) if isinstance(name, str) else ""
            raise ProblemError(f"load: there is no result '{name}' in '{self._folder}'.{hint}")
        if len(entries) > 1:
            each = words([f"'{number}'" for number in entries])
            raise ProblemError(f"load: several results in '{self._folder}' are called '{name}': ask for one of {each}.")
        (entry,) = entries.values()
        return _results.read(self._folder / entry.file, entry.digest, entry.key)

    @override
    def __iter__(self) -> Iterator[str]:
        return iter(self._numbered)

    @override
    def __len__(self) -> int:
        return len(self._numbered)

    @override
    def __contains__(self, name: object) -> bool:
        return len(self._called(name)) == 1

    def _called(self, name: object) -> dict[str, Entry]:
        """The results that a name may mean."""
        if name in self._numbered:
            return {str(name): self._numbered[str(name)]}
        return {number: entry for number, entry in self._numbered.items() if name and entry.name == name}

    def __str__(self) -> str:
        return listing(self._folder, self.entries)


def listing(folder: Path, entries: Iterable[Entry]) -> str:
    """How many results a folder has, and all entries, a line each, with the names by which `load` knows them."""
    entries = list(entries)
    names = names_of(entries)
    count = sum(entry.is_finished and entry.state not in (State.STALE, State.LOST) for entry in entries)
    head = f"{folder}: {'1 result' if count == 1 else f'{count} results'}"
    return "\n".join([head, *(f"  {entry.described(names.get(entry.key, entry.what))}" for entry in entries)])


def names_of(entries: Iterable[Entry]) -> dict[str, str]:
    """The names of results in `load`, by their keys in the journal."""
    return {entry.key: name for name, entry in numbered(entries).items()}


def load(folder: str | Path) -> Loaded:
    """The results that `al.journal` or `aleator run` has kept in a folder, as objects: solutions and evidence by name.

    Their model's module must be importable. Reading them runs code, as importing a module does: files are read only if
    they belong to you, nobody else can write to them, and their content is what was written. Labelled numbers for
    other programs are in the same files, and in `results.nc`.

    Raises `ProblemError` if there is no journal, and, when a result is asked for, if it cannot be read.
    """
    place = as_path(folder)
    return Loaded(place, entries_in(place))


def entries_in(place: Path, *, busy: bool = True) -> tuple[Entry, ...]:
    """What the journal of a folder says, in the order of beginnings; what waits comes last.

    What is running has been interrupted if its process is no more, or if no process writes there (`busy`). Raises
    `ProblemError` if there is no journal.
    """
    if not (place / FILE).is_file():
        raise ProblemError(
            f"load: there is no journal in '{place}': expected a folder in which `aleator run` or a script within "
            "`al.journal(folder)` has kept results."
        )
    entries = read(place / FILE)[0].values()
    settled = (entry.unfinished() if entry.is_abandoned(busy) else entry for entry in entries)
    return tuple(sorted(settled, key=lambda entry: entry.state is State.WAITING))


def examined(place: Path) -> tuple[Entry, ...]:
    """What the journal of a folder says, and what is so: a result whose file is missing or damaged is lost.

    Raises `ProblemError` if there is no journal.
    """
    return tuple(_examined(place, entry) for entry in entries_in(place, busy=has_writer(place)))


def _examined(place: Path, entry: Entry) -> Entry:
    if not entry.is_finished or not (why := _results.damage(place / entry.file, entry.digest)):
        return entry
    return replace(entry, state=State.LOST, why=f"{why}; it is computed again when it is asked for")
