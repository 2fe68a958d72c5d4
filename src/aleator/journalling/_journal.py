"""`journal`: a folder in which every finished result is kept at once."""

import os
import threading
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator._core.errors import JournalWarning, ProblemError
from aleator._core.identity import DoubtError
from aleator._core.journalled import AbstractEntry, AbstractJournal, AbstractParts, called, journalling
from aleator.journalling import _results
from aleator.journalling._entry import FILE, Entry, State, note, read, unfinished
from aleator.journalling._keys import Keys, done_with
from aleator.journalling._load import finished
from aleator.journalling._parts import Parts
from aleator.nlp import Status
from aleator.reporting import check_writable, only_writer

_RESULTS = "finished"
_CODE = "the model's code"
_UNNOTICED = {"equations": _CODE, "function": _CODE, "versions": "aleator or a library"}
_NAMED = 24  # characters of a key in the name of its file


@contextmanager
def journal(folder: str | Path, *, afresh: bool = False) -> "Iterator[Journal]":
    """Keep every design and all evidence found within a block in `folder`, each as soon as it is there.

        with al.journal("results/bracket"):
            front = al.pareto(problem, "mass", [1.0, 1.2, 1.4])
            evidence = al.validate_all(front)

    The same script, started again after a crash or a Ctrl-C, takes from there what has the same code, numbers and
    versions, down to the last bit, and computes the rest: single solves, fronts, calibrations, starts, evidence, and
    work of your own (`aleator.extending.kept`). `al.load(folder)` gives the results back. Nothing in it is overwritten
    by other numbers.

    With `afresh`, what is asked for is computed again all the same. What an earlier run found stays until its
    replacement is there; results that are not asked for stay as they are.

    Raises `ProblemError` if the folder cannot be written to, if another process is writing into it, or if what is there
    is no journal. Warns with `JournalWarning` of results that cannot be kept (a model whose code draws random numbers,
    say), of what an earlier run kept that fits no more and which part of it has changed, and once if the disk is full.
    """
    place = check_writable(folder)
    with only_writer(place):
        kept = Journal(place, afresh=afresh)
        with journalling(kept):
            yield kept


@final
class Journal(AbstractJournal):
    """The journal of one folder, of which this process is the only writer.

    - `recalled`: how often work was answered by a result of an earlier process so far, `begun`: how often it was not;
    - `taken`: the keys of these results, of which each may answer several times.
    """

    def __init__(self, folder: Path, *, afresh: bool = False):
        self.folder, self.recalled, self.begun, self.taken = folder, 0, 0, set[str]()
        entries, size = read(folder / FILE)
        self._known = dict(entries)
        self._earlier = {key for key, one in entries.items() if one.is_finished}
        self._outdated = set(self._earlier) if afresh else set[str]()
        self._afresh = afresh
        self._keys = Keys()
        self._lock, self._told = threading.Lock(), set[str]()
        _prepare(folder, size)
        # Nobody else writes there any more.
        self.append(*(unfinished(one) for one in entries.values() if one.state is State.RUNNING))
        # What an earlier run was waiting for need not be wanted now.
        self.withdraw([key for key, one in self._known.items() if one.state is State.WAITING])

    @override
    def entry(self, what: str, given: Mapping[str, Any]) -> AbstractEntry:
        try:
            key, said, parts = self._keys.identity(what, given)
        except DoubtError as doubt:
            said = done_with(what, given)
            self.warn(f"{said} is not kept: another run could not tell whether it is the same ({doubt}).")
            return _Entry(self, None)
        begun = Entry.begun(key, said, parts, called())
        waiting = self._known.get(begun.waits_as)
        begun = begun if waiting is None else replace(begun, name=waiting.name)
        found = None if key in self._outdated else self._recalled(key)
        if found is None:
            self._tell_changed(said, parts)
            self.begun += 1
            begun = begun.instead_of(self._known[key]) if key in self._outdated else begun
        else:
            if key in self._earlier:
                self.recalled += 1
                self.taken.add(key)
            self._keys.remember(found, key)
            if self._known[key].state is State.STALE:
                self.append(replace(self._known[key], state=_state_of(found), why=""))
            elif waiting is not None:
                self.withdraw([waiting.key])
        return _Entry(self, begun, found)

    @override
    def expect(self, what: str, problems: Mapping[str, Any]) -> list[str]:
        try:
            waiting = [
                Entry.awaited(done_with(what, {"problem": one}), self._keys.problem_digest(one), name)
                for name, one in problems.items()
            ]
        except DoubtError:  # told where it is computed
            return []
        self.append(*waiting)
        return [one.key for one in waiting]

    @override
    def withdraw(self, keys: Sequence[str]) -> None:
        left = [self._known[key] for key in keys if key in self._known]
        self.append(*(replace(one, state=State.WITHDRAWN) for one in left))

    def call(self, named: Mapping[str, Any]) -> None:
        """Note what a study calls the results of this journal, by name; a name is that of one result.

        The last of several names is that of the result.
        """
        names = {key: name for name, result in named.items() if (key := self._keys.of(result))}
        for key, name in names.items():
            before = [one for one in self._known.values() if one.name == name and one.key != key]
            if before or self._known[key].name != name:
                self.append(*(replace(one, name="") for one in before), replace(self._known[key], name=name))

    @property
    def entries(self) -> tuple[Entry, ...]:
        """What the journal says, in the order of beginnings."""
        return tuple(self._known.values())

    def finished(self) -> dict[str, Any]:
        """All results that can be read: see `finished` in `_load`."""
        found, refused = finished(self.folder, self._known.values(), self._keys)
        for one in refused:
            self.warn(one)
        return found

    def _recalled(self, key: str) -> Any:
        known = self._known.get(key)
        if known is None or not known.is_finished:
            return None
        try:
            return _results.read(self.folder / known.file, known.digest, key)
        except ProblemError as error:
            self.warn(f"{error} It is computed again.")
            return None

    def append(self, *entries: Entry) -> bool:
        """Write lines, whole, at the end of the journal; returns whether they are there."""
        if not entries:
            return True
        with self._lock:
            for one in entries:
                note(self._known, one)
            try:
                with (self.folder / FILE).open("ab") as file:
                    file.write("".join(one.line() for one in entries).encode())
                    file.flush()
                    os.fsync(file.fileno())
            except OSError as error:
                self.warn(f"The journal in '{self.folder}' cannot be written ({error.strerror}): work goes on unkept.")
                return False
            return True

    def keep(self, entry: Entry, result: Any, seconds: float) -> None:
        """Write a result, then the line that says so."""
        if _state_of(result) is State.INTERRUPTED:
            self.append(unfinished(entry))
            return
        name = _place(entry)
        try:
            digest = _results.write(self.folder / name, result, entry.key)
        except ProblemError as error:
            self.warn(f"{entry.what} is not kept: {error}")
            return
        self._keys.remember(result, entry.key)
        self._outdated.discard(entry.key)
        self._earlier.discard(entry.key)
        told = self.append(replace(entry, state=_state_of(result), seconds=seconds, file=name, digest=digest))
        if told and entry.file:
            (self.folder / entry.file).unlink(missing_ok=True)
        self.parts_of(entry).drop()

    def parts_of(self, entry: Entry) -> Parts:
        """The parts of a result that is not finished."""
        return Parts(self.folder / _RESULTS, entry.key[:_NAMED], self.warn, recalls=not self._afresh)

    def warn(self, said: str) -> None:
        """Warn of something, once."""
        if said not in self._told:
            self._told.add(said)
            warnings.warn(f"journal: {said}", JournalWarning, stacklevel=2)

    def _tell_changed(self, said: str, parts: Mapping[str, str]) -> None:
        """Mark as stale, with a warning, what differs from a result only by things that may have changed unnoticed."""
        for one in list(self._known.values()):
            changed = [name for name, digest in parts.items() if one.parts.get(name) != digest]
            if one.is_finished and one.what == said and changed and set(changed) <= set(_UNNOTICED):
                told = " and ".join(dict.fromkeys(_UNNOTICED[name] for name in changed))
                if one.state is not State.STALE:
                    self.append(replace(one, state=State.STALE, why=f"{told} changed"))
                self.warn(f"what an earlier run found is not used, because {told} has changed since.")


@final
class _Entry(AbstractEntry):
    """One result in the making; without an `Entry` it is not kept."""

    def __init__(self, journal: Journal, begun: Entry | None, recalled: Any = None):
        self._journal, self._begun, self.recalled = journal, begun, recalled
        self._started = time.perf_counter()
        if begun is not None and recalled is None:
            journal.append(begun)

    @property
    @override
    def parts(self) -> AbstractParts:
        return super().parts if self._begun is None else self._journal.parts_of(self._begun)

    @override
    def keep(self, result: Any) -> None:
        if self._begun is not None:
            self._journal.keep(self._begun, result, time.perf_counter() - self._started)

    @override
    def failed(self, error: BaseException) -> None:
        if self._begun is not None:
            state = State.INTERRUPTED if isinstance(error, KeyboardInterrupt) else State.FAILED
            self._journal.append(unfinished(self._begun, state, f"{type(error).__name__}: {error}"))


def _prepare(folder: Path, size: int) -> None:
    """A place for results, and a journal without a line that a crash cut off, so that the next one begins a line."""
    place = folder / _RESULTS
    try:
        place.mkdir(exist_ok=True)
        with suppress(FileNotFoundError):
            os.truncate(folder / FILE, size)
    except FileExistsError:
        raise ProblemError(
            f"'{place}' is a file; expected a folder for finished results. Move it away, or name another folder."
        ) from None
    except OSError as error:
        raise ProblemError(f"The folder '{folder}' cannot take a journal ({error.strerror}): name another.") from error


def _place(entry: Entry) -> str:
    """Where the result of an entry goes: not where an earlier one is, which stays until the journal names the new."""
    first = f"{_RESULTS}/{entry.what.split()[0]}-{entry.key[:_NAMED]}"
    return f"{first}.nc" if entry.file != f"{first}.nc" else f"{first}-again.nc"


def _state_of(result: Any) -> State:
    """How far a result is, of whatever kind: also of arrays, whose attributes of these names are no truth values."""
    status = getattr(result, "status", Status.SOLVED)
    if status is Status.INTERRUPTED or getattr(result, "interrupted", False) is True:
        return State.INTERRUPTED
    if status is Status.INFEASIBLE:
        return State.INFEASIBLE
    return State.FAILED if getattr(result, "ok", True) is False else State.DONE
