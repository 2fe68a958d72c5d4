"""`journal`: a folder in which every finished result is kept at once."""

import os
import shutil
import threading
import time
import warnings
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator._core.errors import JournalWarning, ProblemError
from aleator._core.journalled import AbstractEntry, AbstractJournal, AbstractParts, journalling
from aleator._core.lasting import DoubtError, joined, lasting_parts
from aleator.design import Problem
from aleator.journalling import _results
from aleator.journalling._entry import Entry, State, interrupted, read
from aleator.journalling._parts import Parts
from aleator.nlp import Status
from aleator.reporting import check_writable, only_writer

FILE = "journal.jsonl"
"""The journal in a run's folder, a line for each beginning and each end of a result."""

_RESULTS = "finished"
_CODE = "the model's code"
_UNNOTICED = {"equations": _CODE, "code": _CODE, "versions": "aleator or a library"}
_NAMED = 24  # characters of a key in the name of its file


@contextmanager
def journal(folder: str | Path) -> "Iterator[Journal]":
    """Keep every design and all evidence found within a block in `folder`, each as soon as it is there.

        with al.journal("results/bracket"):
            front = al.pareto(problem, "mass", [1.0, 1.2, 1.4])
            evidence = al.validate_all(front)

    The same script, started again after a crash or a Ctrl-C, takes from there what has the same code, numbers and
    versions, down to the last bit, and computes the rest: single solves, fronts, calibrations, starts, and evidence.
    `al.load(folder)` gives the results back. Nothing in it is overwritten by other numbers.

    Raises `ProblemError` if the folder cannot be written to, if another process is writing into it, or if what is there
    is no journal. Warns with `JournalWarning` of results that cannot be kept (a model whose code draws random numbers,
    say), of what an earlier run kept that fits no more and which part of it has changed, and once if the disk is full.
    """
    place = check_writable(folder)
    with only_writer(place):
        kept = Journal(place)
        with journalling(kept):
            yield kept


def forget(folder: Path) -> None:
    """Delete a journal with its results, so that everything is computed again."""
    with only_writer(folder):
        shutil.rmtree(folder / _RESULTS, ignore_errors=True)
        (folder / FILE).unlink(missing_ok=True)


@final
class Journal(AbstractJournal):
    """The journal of one folder, of which this process is the only writer.

    - `recalled`: how many results were taken from there so far.
    """

    def __init__(self, folder: Path):
        self.folder, self.recalled = folder, 0
        self._known = {key: interrupted(one) for key, one in read(folder / FILE).items()}
        self._keys = dict[int, tuple[weakref.ref[Any], str]]()
        self._lock, self._told = threading.Lock(), set[str]()
        (folder / _RESULTS).mkdir(exist_ok=True)
        self._drop_cut_line()

    @override
    def entry(self, what: str, given: Mapping[str, Any]) -> AbstractEntry:
        said = f"{what} {_of_model(given)}".strip()
        try:
            parts = lasting_parts({name: self._identified(one) for name, one in given.items()} | _equations(given))
        except DoubtError as doubt:
            self.warn(f"{said} is not kept: another run could not tell whether it is the same ({doubt}).")
            return _Entry(self, None)
        key = joined([what, *(f"{name} {digest}" for name, digest in sorted(parts.items()))])
        found = self._recalled(key)
        if found is None:
            self._tell_changed(said, parts)
        else:
            self.recalled += 1
            self._remember(found, key)
            if self._known[key].state is State.STALE:
                self.append(replace(self._known[key], state=_state_of(found)))
        return _Entry(self, Entry.begun(key, said, parts), found)

    def _recalled(self, key: str) -> Any:
        known = self._known.get(key)
        if known is None or not known.is_finished:
            return None
        try:
            return _results.read(self.folder / known.file, known.digest)
        except ProblemError as error:
            self.warn(f"{error} It is computed again.")
            return None

    def _identified(self, it: Any) -> Any:
        """A result of this journal by its key, a problem without its equations."""
        reference, key = self._keys.get(id(it), (None, ""))
        if reference is not None and reference() is it:
            return key
        if isinstance(it, Problem):
            return it.simulation, it.objective, it.constraints, it.expansion
        return it

    def _remember(self, result: Any, key: str) -> None:
        self._keys[id(result)] = weakref.ref(result), key

    def append(self, entry: Entry) -> None:
        """Write a line, whole, at the end of the journal."""
        with self._lock:
            self._known[entry.key] = entry
            try:
                with (self.folder / FILE).open("ab") as file:
                    file.write(entry.line().encode())
                    file.flush()
                    os.fsync(file.fileno())
            except OSError as error:
                self.warn(f"The journal in '{self.folder}' cannot be written ({error.strerror}): work goes on unkept.")

    def keep(self, entry: Entry, result: Any, seconds: float) -> None:
        """Write a result, then the line that says so."""
        if _state_of(result) is State.INTERRUPTED:
            self.append(replace(entry, state=State.INTERRUPTED))
            return
        name = f"{_RESULTS}/{entry.what.split()[0]}-{entry.key[:_NAMED]}.nc"
        try:
            digest = _results.write(self.folder / name, result)
        except ProblemError as error:
            self.warn(f"{entry.what} is not kept: {error}")
            return
        self._remember(result, entry.key)
        self.parts_of(entry).drop()
        self.append(replace(entry, state=_state_of(result), seconds=seconds, file=name, digest=digest))

    def parts_of(self, entry: Entry) -> Parts:
        """The parts of a result that is not finished."""
        return Parts(self.folder / _RESULTS, entry.key[:_NAMED], self.warn)

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

    def _drop_cut_line(self) -> None:
        """Remove a last line that a crash cut off, so that the next one begins a line."""
        path = self.folder / FILE
        content = path.read_bytes() if path.exists() else b""
        if content and not content.endswith(b"\n"):
            os.truncate(path, content.rfind(b"\n") + 1)


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
            self._journal.append(replace(self._begun, state=state, why=f"{type(error).__name__}: {error}"))


def _state_of(result: Any) -> State:
    status = getattr(result, "status", Status.SOLVED)
    if status in (Status.INFEASIBLE, Status.INTERRUPTED):
        return State.INFEASIBLE if status is Status.INFEASIBLE else State.INTERRUPTED
    return State.DONE if getattr(result, "ok", True) else State.FAILED


def _equations(given: Mapping[str, Any]) -> dict[str, str]:
    """The digest of a problem's equations, without what is random in it where equations do not show all.

    What the code reads is told apart in any case.
    """
    problem = given.get("problem")
    return {"equations": problem.physics.partition(" ")[0]} if isinstance(problem, Problem) else {}


def _of_model(given: Mapping[str, Any]) -> str:
    """The name of the model that a result is about."""
    problem = given.get("problem") or getattr(given.get("solution"), "problem", None)
    return type(problem.system).__name__ if problem is not None else ""
