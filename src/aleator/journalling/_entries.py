"""The lines of a journal: what was begun, by whom, and how it ended; `load`: the results as objects."""

import enum
import json
import os
import socket
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
    - `name`: what the study calls it, such as `designs/robust`, or else where it was asked for, such as `pareto, at
      stress = 0.4`;
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
        return cls(key, what, State.RUNNING, parts, socket.gethostname(), os.getpid(), since, name=name)

    @property
    def is_finished(self) -> bool:
        """Whether its result is available: that of an infeasible problem too, and one that is stale."""
        return bool(self.file)

    def line(self) -> str:
        """The entry as one line of JSON."""
        return json.dumps({**vars(self), "state": self.state.value}, ensure_ascii=False) + "\n"


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
            entry = Entry(**{**line.value, "state": State(line.value["state"])})
        except (ValueError, TypeError, KeyError) as error:
            raise ProblemError(
                f"'{path}', line {line.number}: expected an entry of a journal; received {line.text[:60]!r}. Remove "
                "the line, or begin another folder; finished results in other lines stay valid."
            ) from error
        entries[entry.key] = entry
    return entries, size


def numbered(entries: Iterable[Entry]) -> dict[str, Entry]:
    """The available results by what was done, counted in the order of their beginnings: `solve Bar 1`."""
    counts: dict[str, int] = {}
    results: dict[str, Entry] = {}
    for entry in entries:
        if entry.is_finished and entry.state is not State.STALE:
            counts[entry.what] = counts.get(entry.what, 0) + 1
            results[f"{entry.what} {counts[entry.what]}"] = entry
    return results


def entries_in(folder: Path) -> tuple[Entry, ...]:
    """What the journal of a folder says, in the order of beginnings.

    What was running has been interrupted if no process writes there any more. Raises `ProblemError` if there is no
    journal.
    """
    if not (folder / FILE).is_file():
        raise ProblemError(
            f"load: there is no journal in '{folder}': expected a folder in which `aleator run` or a script within "
            "`al.journal(folder)` has kept results."
        )
    entries = read(folder / FILE)[0].values()
    return tuple(entries) if has_writer(folder) else tuple(map(interrupted, entries))


def interrupted(entry: Entry) -> Entry:
    """An entry whose process works no more."""
    return replace(entry, state=State.INTERRUPTED) if entry.state is State.RUNNING else entry


def examined(folder: Path) -> tuple[Entry, ...]:
    """What the journal of a folder says, and what is so: a result whose file is missing or damaged is lost.

    Raises `ProblemError` if there is no journal.
    """

    def looked_at(entry: Entry) -> Entry:
        why = _results.damage(folder / entry.file, entry.digest) if entry.is_finished else ""
        return replace(entry, state=State.LOST, why=f"{why}; it is computed again when asked for") if why else entry

    return tuple(map(looked_at, entries_in(folder)))


def listing(folder: Path, entries: Iterable[Entry]) -> str:
    """How many results a folder has, and all entries, a line each, with the names by which `load` knows them."""
    entries = list(entries)
    names = {entry.key: name for name, entry in numbered(entries).items()}
    count = sum(entry.state is not State.LOST for entry in numbered(entries).values())
    lines = [f"{folder}: {'1 result' if count == 1 else f'{count} results'}"]
    for entry in entries:
        time = f"{entry.seconds:.2g} s" if entry.is_finished else f"since {entry.since} on {entry.host}"
        said = [names.get(entry.key, entry.what), entry.name, time, entry.why]
        lines.append(f"  {entry.state.value:<12} {'  '.join(filter(None, said))}")
    return "\n".join(lines)


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
        numbers = self._numbers_of(name)
        if not numbers:
            known = [*self._numbered, *(entry.name for entry in self._numbered.values() if entry.name)]
            raise ProblemError(f"load: there is no result '{name}' in '{self._folder}'.{meant(str(name), known)}")
        if len(numbers) > 1:
            each = words([f"'{number}'" for number in numbers])
            raise ProblemError(f"load: several results in '{self._folder}' are called '{name}': ask for one of {each}.")
        entry = self._numbered[numbers[0]]
        return _results.read(self._folder / entry.file, entry.digest, entry.key)

    @override
    def __iter__(self) -> Iterator[str]:
        return iter(self._numbered)

    @override
    def __len__(self) -> int:
        return len(self._numbered)

    @override
    def __contains__(self, name: object) -> bool:
        return len(self._numbers_of(name)) == 1

    def _numbers_of(self, name: object) -> list[str]:
        """The numbers of the results that a name may mean."""
        return [number for number, entry in self._numbered.items() if name and name in (number, entry.name)]

    def __str__(self) -> str:
        return listing(self._folder, self.entries)


def load(folder: str | Path) -> Loaded:
    """The results that `al.journal` or `aleator run` has kept in a folder, as objects: solutions and evidence by name.

    Their model's module must be importable. Reading them runs code, as importing a module does: files are read only if
    they belong to you, nobody else can write to them, and their content is what was written. Labelled numbers for
    other programs are in the same files, and in `results.nc`.

    Raises `ProblemError` if there is no journal, and, when a result is asked for, if it cannot be read.
    """
    place = as_path(folder)
    return Loaded(place, entries_in(place))
