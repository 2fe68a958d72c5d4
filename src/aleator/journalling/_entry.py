"""The lines of a journal: what was begun, by whom, and how it ended."""

import enum
import json
import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, final

from aleator._core.errors import ProblemError


class State(enum.Enum):
    """How far a result is."""

    RUNNING = "running"
    INTERRUPTED = "interrupted"
    DONE = "done"
    INFEASIBLE = "infeasible"
    FAILED = "failed"
    STALE = "stale"


@final
@dataclass(frozen=True)
class Entry:
    """One result of a journal.

    - `key`: a digest of all that it follows from; `parts`: digests of these by name, such as `code` and `versions`;
    - `what`: `solve` or `validate`, with the model's name; `state`; `why`: the reason of a failure;
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

    @classmethod
    def begun(cls, key: str, what: str, parts: Mapping[str, str]) -> "Entry":
        """An entry of this process that begins now."""
        since = datetime.now(UTC).isoformat(timespec="seconds")
        return cls(key, what, State.RUNNING, dict(parts), socket.gethostname(), os.getpid(), since)

    @property
    def is_finished(self) -> bool:
        """Whether its result is there: that of an infeasible problem too, and one that nobody asks for any more."""
        return bool(self.file)

    def line(self) -> str:
        """The entry as one line of JSON."""
        return json.dumps({**vars(self), "state": self.state.value}, ensure_ascii=False) + "\n"

    def __str__(self) -> str:
        took = f"{self.seconds:.2g} s" if self.is_finished else f"since {self.since} on {self.host} ({self.process})"
        return f"{self.state.value:<12} {self.what}  {took}{f'  {self.why}' if self.why else ''}"


def read(path: Path) -> dict[str, Entry]:
    """The last entry of each key, in order of their beginnings; empty if there is no file.

    A last line that was cut off is ignored: its result is computed again. Raises `ProblemError` for anything else that
    is no entry, with its line.
    """
    try:
        lines = path.read_bytes().split(b"\n")
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise ProblemError(f"The journal '{path}' cannot be read ({error.strerror}).") from error
    entries: dict[str, Entry] = {}
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            one = _entry(json.loads(line))
        except (ValueError, TypeError, KeyError) as error:
            if number == len(lines):
                continue
            raise ProblemError(
                f"'{path}', line {number}: expected an entry of a journal; received {line[:60]!r}. Remove the line, or "
                "begin another folder; finished results in other lines stay valid."
            ) from error
        entries[one.key] = one
    return entries


def _entry(data: dict[str, Any]) -> Entry:
    return Entry(**{**data, "state": State(data["state"])})


def interrupted(one: Entry) -> Entry:
    """An entry as it is seen by the only process that may write now: what another had begun was interrupted."""
    return replace(one, state=State.INTERRUPTED) if one.state is State.RUNNING else one
