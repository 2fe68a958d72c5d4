"""`journal`: a folder in which every finished result is kept at once; `recalling`: what it has, for reading alone."""

import os
import threading
import time
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, final

from typing_extensions import override

from aleator._core.errors import JournalWarning, ProblemError
from aleator._core.identity import DoubtError, joined, lasting_digest, versions
from aleator._core.journalled import AbstractJournal, NotKeptError, Place, called, journalling
from aleator.design import Problem
from aleator.journalling import _results
from aleator.journalling._entries import FILE, Entry, State, entries_in, note, numbered, read
from aleator.journalling._results import Parts
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
        record = Journal(place, afresh=afresh)
        with journalling(record):
            yield record


@contextmanager
def recalling(folder: Path) -> "Iterator[Recalled]":
    """Take all results within a block from a folder; one that is not there ends its work by `NotKeptError`.

    Nothing is written, so that another process may be writing there. Raises `ProblemError` if there is no journal.
    """
    record = Recalled(folder)
    with journalling(record):
        yield record


# --- Keys ------------------------------------------------------------------------------------------------------------


class _Identity(NamedTuple):
    """What a result is: its key, what is done with which model, and digests of all that it follows from, by name."""

    key: str
    what: str
    parts: Mapping[str, str]


@final
class Keys:
    """The keys of the results that this process knows. What follows from a result is identified by its key."""

    def __init__(self) -> None:
        self._keys = dict[int, tuple[weakref.ref[Any], str]]()

    def remember(self, result: Any, key: str) -> None:
        """Note the key of a result. A plain value, such as a list, is told by its content instead."""
        with suppress(TypeError):
            self._keys[id(result)] = weakref.ref(result), key

    def of(self, result: Any) -> str:
        """The key of a known result; empty for anything else."""
        reference, key = self._keys.get(id(result), (None, ""))
        return key if reference is not None and reference() is result else ""

    def identity(self, what: str, given: Mapping[str, Any]) -> _Identity:
        """What a result is that follows from what is given. Raises `DoubtError` if another process could not tell."""
        parts = {"versions": versions()}
        for name, one in given.items():
            if isinstance(one, Problem):
                parts |= {name: self.problem_digest(one), "equations": _equations(one)}
            else:
                parts[name] = lasting_digest(self.of(one) or one)
        key = joined([what, *(f"{name} {digest}" for name, digest in sorted(parts.items()))])
        return _Identity(key, done_with(what, given), parts)

    def problem_digest(self, problem: Problem) -> str:
        """The part of a key that tells the problem, whatever else a result follows from. Raises `DoubtError`."""
        return lasting_digest(_parts_of(problem), declared=True)


def done_with(what: str, given: Mapping[str, Any]) -> str:
    """What is done, with the name of the model."""
    problem = given.get("problem") or getattr(given.get("solution"), "problem", None)
    return f"{what} {type(problem.system).__name__}" if problem is not None else what


def _parts_of(problem: Problem) -> tuple[Any, ...]:
    """A problem without the digests of its code."""
    return replace(problem.simulation, equations=None), problem.objective, problem.constraints, problem.expansion


def _equations(problem: Problem) -> str:
    """The digest of a problem's code: of its equations, and all of it where they do not show it."""
    return joined([problem.physics.text, "" if problem.is_declared else lasting_digest(_parts_of(problem))])


# --- Records ---------------------------------------------------------------------------------------------------------


class AbstractRecord(AbstractJournal):
    """The results of a folder, each read from its file when it is asked for; `tell` is told of those that cannot be."""

    def __init__(self, folder: Path, entries: Iterable[Entry], tell: Callable[[str], None]):
        self.folder, self._keys, self._tell = folder, Keys(), tell
        self._known = {entry.key: entry for entry in entries}

    @property
    def entries(self) -> tuple[Entry, ...]:
        """What the journal says, in the order of beginnings."""
        return tuple(self._known.values())

    def finished(self) -> dict[str, Any]:
        """All results that can be read, by the names that a study gives them, or else those of `load`.

        Where several have one name, it is that of the last.
        """
        results = dict[str, Any]()
        available = numbered(self.entries)
        last = {entry.name: entry.key for entry in available.values()}
        for number, entry in available.items():
            with self._telling():
                name = entry.name if entry.name and last[entry.name] == entry.key else number
                results[name] = self._read(entry)
        return results

    def _read(self, entry: Entry) -> Any:
        """A finished result. What follows from it is recognised from now on."""
        result = _results.read(self.folder / entry.file, entry.digest, entry.key)
        self._keys.remember(result, entry.key)
        return result

    @contextmanager
    def _telling(self) -> Iterator[None]:
        try:
            yield
        except ProblemError as error:
            self._tell(f"{error}")


@final
class Recalled(AbstractRecord):
    """The results of a folder, for reading alone.

    - `missing`: what was asked for and is not there, or cannot be read, a sentence each.
    """

    def __init__(self, folder: Path):
        self.missing = list[str]()
        super().__init__(folder, entries_in(folder), self.missing.append)

    @override
    def place(self, what: str, given: Mapping[str, Any]) -> Place:
        try:
            identity = self._keys.identity(what, given)
        except DoubtError as doubt:
            raise self._absent(f"{what}: no run can tell whether it is the same ({doubt}).") from None
        entry = self._known.get(identity.key)
        if entry is None or not entry.is_finished:
            raise self._absent(f"{identity.what} is missing.")
        try:
            return Place(self._read(entry))
        except ProblemError as error:
            raise self._absent(f"{error}") from error

    def _absent(self, why: str) -> NotKeptError:
        self.missing.append(why)
        return NotKeptError(why)


@final
class Journal(AbstractRecord):
    """The journal of one folder, of which this process is the only writer.

    - `recalled`: how often work was answered by a result of an earlier process so far, `begun`: how often it was not;
    - `taken`: the keys of these results, of which each may answer several times.
    """

    def __init__(self, folder: Path, *, afresh: bool = False):
        entries, size = read(folder / FILE)
        super().__init__(folder, entries.values(), lambda said: self.warn(f"{said} It is computed again."))
        self.recalled, self.begun, self.taken, self._asked = 0, 0, set[str](), set[str]()
        self._earlier = {key for key, entry in entries.items() if entry.is_finished}
        self._outdated = set(self._earlier) if afresh else set[str]()
        self._afresh = afresh
        self._lock, self._warned = threading.Lock(), set[str]()
        _prepare(folder, size)
        # Nobody else writes there any more.
        self.append(*(entry.unfinished() for entry in entries.values() if entry.state is State.RUNNING))
        # What an earlier run was waiting for need not be wanted now.
        self.withdraw([key for key, entry in entries.items() if entry.state is State.WAITING])

    @override
    def place(self, what: str, given: Mapping[str, Any]) -> Place:
        try:
            key, title, parts = self._keys.identity(what, given)
        except DoubtError as doubt:
            title = done_with(what, given)
            self._asked.add(title)
            self.warn(f"{title} is not kept: another run could not tell whether it is the same ({doubt}).")
            return Place()
        self._asked.add(key)
        begun = Entry.begun(key, title, parts, called())
        waiting = self._known.get(begun.waits_as)
        begun = begun if waiting is None else replace(begun, name=waiting.name)
        known, result = self._known.get(key), None
        if known is not None and known.is_finished and key not in self._outdated:
            with self._telling():
                result = self._read(known)
        if known is None or result is None:
            self._tell_changed(title, parts)
            self.begun += 1
            return self._opened(begun if known is None or key not in self._outdated else begun.instead_of(known))
        if key in self._earlier:
            self.recalled += 1
            self.taken.add(key)
        if known.state is State.STALE:
            self.append(replace(known, state=_state_of(result), why=""))
        elif waiting is not None:
            self.withdraw([waiting.key])
        return Place(result)

    def _opened(self, begun: Entry) -> Place:
        """The place of a result in the making."""
        started = time.perf_counter()
        self.append(begun)

        def failed(error: BaseException) -> None:
            state = State.INTERRUPTED if isinstance(error, KeyboardInterrupt) else State.FAILED
            self.append(begun.unfinished(state, f"{type(error).__name__}: {error}"))

        def keep(result: Any) -> None:
            self._keep(begun, result, time.perf_counter() - started)

        return Place(parts=self._parts_of(begun), keep=keep, failed=failed)

    @override
    def expect(self, what: str, problems: Mapping[str, Any]) -> list[str]:
        try:
            waiting = [
                Entry.awaited(done_with(what, {"problem": problem}), self._keys.problem_digest(problem), name)
                for name, problem in problems.items()
            ]
        except DoubtError:  # told where it is computed
            return []
        self.append(*waiting)
        return [entry.key for entry in waiting]

    @override
    def withdraw(self, keys: Sequence[str]) -> None:
        self.append(*(replace(self._known[key], state=State.WITHDRAWN) for key in keys if key in self._known))

    def call(self, named: Mapping[str, Any]) -> None:
        """Note what a study calls the results of this journal, by name; a name is that of one result.

        The last of several names is that of the result.
        """
        names = {key: name for name, result in named.items() if (key := self._keys.of(result))}
        for key, name in names.items():
            before = [entry for entry in self.entries if entry.name == name and entry.key != key]
            if before or self._known[key].name != name:
                self.append(*(replace(entry, name="") for entry in before), replace(self._known[key], name=name))

    def contents(self) -> str:
        """A digest of all results that were asked for so far; empty if there are none, or if one is not kept."""
        kept = [f"{entry.key} {entry.digest}" for entry in self.entries if entry.key in self._asked and entry.file]
        return joined(kept) if len(kept) == len(self._asked) > 0 else ""

    def append(self, *entries: Entry) -> bool:
        """Write lines, whole, at the end of the journal; returns whether they are there."""
        if not entries:
            return True
        with self._lock:
            for entry in entries:
                note(self._known, entry)
            try:
                with (self.folder / FILE).open("ab") as file:
                    file.write("".join(entry.line() for entry in entries).encode())
                    file.flush()
                    os.fsync(file.fileno())
            except OSError as error:
                self.warn(f"The journal in '{self.folder}' cannot be written ({error.strerror}): work goes on unkept.")
                return False
            return True

    def _keep(self, entry: Entry, result: Any, seconds: float) -> None:
        """Write a result, then the line that says so."""
        if _state_of(result) is State.INTERRUPTED:
            self.append(entry.unfinished())
            return
        # Not where an earlier result is, which stays until the journal names the new one.
        name = f"{_RESULTS}/{entry.what.split()[0]}-{entry.key[:_NAMED]}"
        name += "-again.nc" if entry.file == f"{name}.nc" else ".nc"
        try:
            digest = _results.write(self.folder / name, result, entry.key)
        except ProblemError as error:
            self.warn(f"{entry.what} is not kept: {error}")
            return
        self._keys.remember(result, entry.key)
        self._outdated.discard(entry.key)
        self._earlier.discard(entry.key)
        noted = self.append(replace(entry, state=_state_of(result), seconds=seconds, file=name, digest=digest))
        if noted and entry.file:
            (self.folder / entry.file).unlink(missing_ok=True)
        self._parts_of(entry).drop()

    def _parts_of(self, entry: Entry) -> Parts:
        """The parts of a result that is not finished."""
        return Parts(self.folder / _RESULTS, entry.key[:_NAMED], self.warn, recalls=not self._afresh)

    def warn(self, said: str) -> None:
        """Warn of something, once."""
        if said not in self._warned:
            self._warned.add(said)
            warnings.warn(f"journal: {said}", JournalWarning, stacklevel=2)

    def _tell_changed(self, title: str, parts: Mapping[str, str]) -> None:
        """Mark as stale, with a warning, what differs from a result only by things that may have changed unnoticed."""
        for entry in self.entries:
            changed = [name for name, digest in parts.items() if entry.parts.get(name) != digest]
            if entry.is_finished and entry.what == title and changed and set(changed) <= set(_UNNOTICED):
                causes = " and ".join(dict.fromkeys(_UNNOTICED[name] for name in changed))
                if entry.state is not State.STALE:
                    self.append(replace(entry, state=State.STALE, why=f"{causes} changed"))
                self.warn(f"what an earlier run found is not used, because {causes} has changed since.")


def _prepare(folder: Path, size: int) -> None:
    """A place for results, and a journal without a line that a crash cut off, so that the next one begins a line."""
    place = folder / _RESULTS
    try:
        place.mkdir(exist_ok=True)
        with suppress(FileNotFoundError):
            os.truncate(folder / FILE, size)
    except OSError as error:
        raise ProblemError(f"'{place}' cannot take results ({error.strerror}): name another folder.") from error


def _state_of(result: Any) -> State:
    """How far a result is, of whatever kind: also of arrays, whose attributes of these names are no truth values."""
    status = getattr(result, "status", Status.SOLVED)
    if status is Status.INTERRUPTED or getattr(result, "interrupted", False) is True:
        return State.INTERRUPTED
    if status is Status.INFEASIBLE:
        return State.INFEASIBLE
    return State.FAILED if getattr(result, "ok", True) is False else State.DONE
