"""The lines of a journal: what was begun, by whom, and how it ended."""

import json
import os
import socket
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import final

from aleator._core.errors import ProblemError
from aleator._core.journalled import read_lines
from aleator.journalling._results import content_of
from aleator.reporting import has_writer

FILE = "journal.jsonl"
"""The journal in a run's folder, a line for each beginning and each end of a result."""

RUNNING, INTERRUPTED, DONE, INFEASIBLE, FAILED = "running", "interrupted", "done", "infeasible", "failed"
# Its code, or a library, is another now; its file is missing or damaged.
STALE, LOST = "stale", "lost"


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


def entries_in(folder: Path) -> dict[str, Entry]:
    """What the journal of a folder says, by key, in the order of beginnings.

    What was running has been interrupted if no process writes there any more. Raises `ProblemError` if there is no
    journal.
    """
    if not (folder / FILE).is_file():
        inside = ", ".join(f"'{one.parent}'" for one in sorted(folder.glob(f"*/{FILE}")))
        raise ProblemError(
            f"There is no journal in '{folder}': expected a folder in which `aleator run` or a script within "
            f"`al.journal(folder)` has kept results{inside and f', such as {inside}'}."
        )
    entries, _ = read(folder / FILE)
    return entries if has_writer(folder) else {**entries, **interrupted(entries)}


def interrupted(entries: Mapping[str, Entry]) -> dict[str, Entry]:
    """The entries that were running, whose process works no more."""
    running = {key: entry for key, entry in entries.items() if entry.state == RUNNING}
    return {key: replace(entry, state=INTERRUPTED) for key, entry in running.items()}


def examined(folder: Path) -> dict[str, Entry]:
    """What the journal of a folder says, and what is so: a result whose file is missing or damaged is lost.

    Raises `ProblemError` if there is no journal.
    """
    entries = entries_in(folder)
    for key, entry in entries.items():
        try:
            if entry.file:
                content_of(folder / entry.file, key)
        except ProblemError as error:
            entries[key] = replace(entry, state=LOST, why=f"{error} It is computed again when asked for.")
    return entries


def numbered(entries: Iterable[Entry]) -> dict[str, Entry]:
    """The available results by what was done, counted in the order of their beginnings: `solve Bar 1`."""
    counts: dict[str, int] = {}
    results: dict[str, Entry] = {}
    for entry in entries:
        if entry.file and entry.state != STALE:
            counts[entry.what] = counts.get(entry.what, 0) + 1
            results[f"{entry.what} {counts[entry.what]}"] = entry
    return results


def listing(folder: Path, entries: Mapping[str, Entry]) -> str:
    """How many results a folder has, and all entries, a line each, with the names by which `load` knows them."""
    results = numbered(entries.values())
    names = {entry.key: name for name, entry in results.items()}
    count = sum(entry.state != LOST for entry in results.values())
    lines = [f"{folder}: {'1 result' if count == 1 else f'{count} results'}"]
    for key, entry in entries.items():
        time = f"{entry.seconds:.2g} s" if entry.file else f"since {entry.since} on {entry.host}"
        said = [names.get(key, entry.what), entry.name, time, entry.why]
        lines.append(f"  {entry.state:<12} {'  '.join(filter(None, said))}")
    return "\n".join(lines)
