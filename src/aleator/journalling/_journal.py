"""`journal`: a folder in which every finished result is kept at once; `load`, `recalling`: what it has, to be read;
`kept`: work of one's own that takes long, done once for the same code and numbers.
"""

import inspect
import os
import threading
import time
import warnings
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar, final

from typing_extensions import override

from aleator._core.border import Progress, meant
from aleator._core.errors import JournalWarning, ProblemError
from aleator._core.identity import DoubtError, lasting_digest
from aleator._core.journalled import AbstractJournal, NotKeptError, Place, called, journalled, journalling
from aleator._core.parallel import heeding
from aleator.journalling._results import (
    FAILED,
    FILE,
    FINISHED,
    INTERRUPTED,
    LOST,
    RUNNING,
    STALE,
    Entry,
    Parts,
    content_of,
    identity,
    read,
    read_result,
    state_of,
    write_result,
)
from aleator.reporting import as_path, check_writable, has_writer, only_writer, words

Result = TypeVar("Result")

_CODE = "the model's code"
_UNNOTICED = {"equations": _CODE, "function": _CODE, "versions": "aleator or a library"}


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
        entries, size = read(place / FILE)
        (place / FINISHED).mkdir(exist_ok=True)
        with suppress(FileNotFoundError):  # A line that a crash cut off goes, so that the next one begins a line.
            os.truncate(place / FILE, size)
        record = Journal(place, entries, writes=True, afresh=afresh)
        # Nobody else writes there any more.
        record.append(*_interrupted(entries).values())
        with journalling(record):
            yield record


@contextmanager
def recalling(folder: Path) -> "Iterator[Journal]":
    """Take all results within a block from a folder; one that is not there ends its work by `NotKeptError`.

    Nothing is written, so that another process may be writing there. Raises `ProblemError` if there is no journal.
    """
    with journalling(record := load(folder)):
        yield record


def load(folder: str | Path) -> "Journal":
    """The results that `al.journal` or `aleator run` has kept in a folder, as objects: solutions and evidence by name.

    Each is read from its file when it is asked for. Names are those of what was done, counted in the order of their
    beginnings: `"solve Cushion 1"`, `"validate Cushion 1"`; those that a study gives, such as `"designs/robust"`, are
    known as well. `print(results)` shows all that was begun, with its state, who began it and when, and how long it
    took; `results.entries` has this for programs.

    Their model's module must be importable. Reading them runs code, as importing a module does: files are read only if
    they belong to you, nobody else can write to them, and their content is what was written. Labelled numbers for
    other programs are in netCDF files beside them, and in `results.nc`.

    Raises `ProblemError` if there is no journal, and, when a result is asked for, if it cannot be read.
    """
    place = as_path(folder)
    if not (place / FILE).is_file():
        inside = ", ".join(f"'{one.parent}'" for one in sorted(place.glob(f"*/{FILE}")))
        raise ProblemError(
            f"There is no journal in '{place}': expected a folder in which `aleator run` or a script within "
            f"`al.journal(folder)` has kept results{inside and f', such as {inside}'}."
        )
    entries, _ = read(place / FILE)
    return Journal(place, entries if has_writer(place) else entries | _interrupted(entries))


def _interrupted(entries: Mapping[str, Entry]) -> dict[str, Entry]:
    """The entries that were running, whose process works no more."""
    running = {key: entry for key, entry in entries.items() if entry.state == RUNNING}
    return {key: replace(entry, state=INTERRUPTED) for key, entry in running.items()}


@final
class Journal(AbstractJournal, Mapping[str, Any]):
    """The results of one folder by name, each read from its file when it is asked for.

    - `entries`: what is known of them; `writes`: whether this process is the only writer, else it reads alone;
    - `afresh`: whether results of earlier processes are computed again;
    - `taken`: the keys of those that have answered, each perhaps several times; `begun`: how often work was computed;
    - `missing`: what a reader has asked for that is not there, or cannot be read, a sentence each.
    """

    def __init__(self, folder: Path, entries: Mapping[str, Entry], *, writes: bool = False, afresh: bool = False):
        self.folder, self._known, self._writes, self._afresh = folder, dict(entries), writes, afresh
        self._earlier = {key for key, entry in entries.items() if entry.file}
        self._keys = dict[int, tuple[weakref.ref[Any], str]]()  # of results that this process knows, by identity
        self._lock, self._warned = threading.Lock(), set[str]()
        self.taken, self.begun, self.missing = set[str](), 0, list[str]()

    @property
    def entries(self) -> tuple[Entry, ...]:
        """What the journal says, in the order of beginnings."""
        return tuple(self._known.values())

    @property
    def results(self) -> dict[str, Entry]:
        """Those that are available by what was done, counted in the order of their beginnings: `solve Bar 1`."""
        counts, results = dict[str, int](), dict[str, Entry]()
        for entry in self.entries:
            if entry.file and entry.state != STALE:
                counts[entry.what] = counts.get(entry.what, 0) + 1
                results[f"{entry.what} {counts[entry.what]}"] = entry
        return results

    @override
    def __getitem__(self, name: str) -> Any:
        results = self.results
        own = [number for number, entry in results.items() if name in (number, entry.name)]
        if len(own) == 1:
            return self._read(results[own[0]])
        if own:
            each = words([f"'{number}'" for number in own])
            raise ProblemError(f"load: several results in '{self.folder}' are called '{name}': ask for one of {each}.")
        known = [*results, *(entry.name for entry in results.values() if entry.name)]
        raise ProblemError(f"load: there is no result '{name}' in '{self.folder}'.{meant(name, known)}")

    @override
    def __iter__(self) -> Iterator[str]:
        return iter(self.results)

    @override
    def __len__(self) -> int:
        return len(self.results)

    @override
    def __contains__(self, name: object) -> bool:
        return any(name in (number, entry.name) for number, entry in self.results.items())

    def __str__(self) -> str:
        names = {entry.key: name for name, entry in self.results.items()}
        count = sum(entry.state != LOST for entry in self.results.values())
        lines = [f"{self.folder}: {'1 result' if count == 1 else f'{count} results'}"]
        for entry in self.entries:
            time = f"{entry.seconds:.2g} s" if entry.file else f"since {entry.since} on {entry.host}"
            said = [names.get(entry.key, entry.what), entry.name, time, entry.why]
            lines.append(f"  {entry.state:<12} {'  '.join(filter(None, said))}")
        return "\n".join(lines)

    def examined(self) -> "Journal":
        """The same, and what is so: a result whose file is missing or damaged is lost."""
        entries = dict(self._known)
        for key, entry in entries.items():
            try:
                if entry.file:
                    content_of(self.folder / entry.file, key)
            except ProblemError as error:
                entries[key] = replace(entry, state=LOST, why=f"{error} It is computed again when asked for.")
        return Journal(self.folder, entries)

    def finished(self) -> dict[str, Any]:
        """All results that can be read, by the names that a study gives them, or else those of `load`."""
        results = dict[str, Any]()
        for number, entry in self.results.items():
            with suppress(ProblemError):
                results[number if entry.name in ("", *results) else entry.name] = self._read(entry)
        return results

    def _remember(self, result: Any, key: str) -> None:
        """Note the key of a result. A plain value, such as a list, is told by its content instead."""
        with suppress(TypeError):
            self._keys[id(result)] = weakref.ref(result), key

    def _key_of(self, result: Any) -> str:
        """The key of a known result; empty for anything else."""
        reference, key = self._keys.get(id(result), (None, ""))
        return key if reference is not None and reference() is result else ""

    def _read(self, entry: Entry) -> Any:
        """A finished result; what follows from it is recognised from now on. Raises `ProblemError`."""
        result = read_result(self.folder / entry.file, entry.key)
        self._remember(result, entry.key)
        return result

    @override
    def place(self, what: str, given: Mapping[str, Any]) -> Place:
        problem = given.get("problem") or getattr(given.get("solution"), "problem", None)
        title = what if problem is None else f"{what} {type(problem.system).__name__}"
        try:
            key, parts = identity(what, given, self._key_of)
        except DoubtError as doubt:
            self._miss(f"{title} is not kept: another run could not tell whether it is the same ({doubt}).")
            return Place()
        known, is_earlier = self._known.get(key), key in self._earlier
        stays = is_earlier and self._afresh
        if known is not None and known.file and not stays:
            try:
                result = self._read(known)
            except ProblemError as error:
                self._miss(f"{error}{' It is computed again.' if self._writes else ''}")
            else:
                self.taken |= {key} if is_earlier else set()
                # What a run of another form of the study took its name from has it again.
                again = replace(known, name=known.name or called())
                again = replace(again, state=state_of(result), why="") if known.state == STALE else again
                if again != known and self._writes:
                    self.append(again)
                return Place(result)
        if not self._writes:
            self._miss(f"{title} is missing.")
        self._tell_changed(title, parts)
        self.begun += 1
        name = known.name if known is not None and known.name else called()
        return self._opened(Entry.begun(key, title, parts, name), stays=stays)

    def _miss(self, why: str) -> None:
        """Say why a result is not taken: a writer computes it, the work of a reader ends by `NotKeptError`."""
        if self._writes:
            self.warn(why)
        else:
            self.missing.append(why)
            raise NotKeptError(why)

    def _opened(self, begun: Entry, *, stays: bool) -> Place:
        """The place of a result in the making; where an earlier one `stays` until it is there, it has no line."""
        started = time.perf_counter()
        parts = Parts(self.folder, begun.key, self.warn)
        if self._afresh:
            parts.drop()

        def end(state: str, why: str = "") -> None:
            if not stays:
                self.append(replace(begun, state=state, why=why))

        def failed(error: BaseException) -> None:
            state = INTERRUPTED if isinstance(error, KeyboardInterrupt) else FAILED
            end(state, f"{type(error).__name__}: {error}")

        def keep(result: Any) -> None:
            """Write a result, then the line that says so."""
            seconds, state = time.perf_counter() - started, state_of(result)
            if state == INTERRUPTED:
                end(state)
                return
            try:
                file = write_result(self.folder, begun.what, begun.key, result)
            except ProblemError as error:
                self.warn(f"{begun.what} is not kept: {error}")
                end(FAILED, f"done, but not kept: {error}")
                return
            self._remember(result, begun.key)
            self._earlier.discard(begun.key)
            self.append(replace(begun, state=state, seconds=seconds, file=file))
            parts.drop()

        end(RUNNING)
        return Place(parts=parts, keep=keep, failed=failed)

    def call(self, named: Mapping[str, Any]) -> None:
        """Note what a study calls the results of this journal, by name; a name is that of one result.

        The last of several names is that of the result.
        """
        names = {key: name for name, result in named.items() if (key := self._key_of(result))}
        for key, name in names.items():
            before = [entry for entry in self.entries if entry.name == name and entry.key != key]
            if before or self._known[key].name != name:
                self.append(*(replace(entry, name="") for entry in before), replace(self._known[key], name=name))

    def append(self, *entries: Entry) -> None:
        """Write lines, whole, at the end of the journal."""
        with self._lock:
            self._known |= {entry.key: entry for entry in entries}
            try:
                with (self.folder / FILE).open("ab") as file:
                    file.write("".join(entry.line() for entry in entries).encode())
                    file.flush()
                    os.fsync(file.fileno())
            except OSError as error:
                self.warn(f"The journal in '{self.folder}' cannot be written ({error.strerror}): work goes on unkept.")

    def warn(self, said: str) -> None:
        """Warn of something, once."""
        if said not in self._warned:
            self._warned.add(said)
            warnings.warn(f"journal: {said}", JournalWarning, stacklevel=2)

    def _tell_changed(self, title: str, parts: Mapping[str, str]) -> None:
        """Mark as stale, with a warning, what differs from a result only by things that may have changed unnoticed."""
        for entry in self.entries:
            changed = [name for name, digest in parts.items() if entry.parts.get(name) != digest]
            if entry.file and entry.what == title and changed and set(changed) <= set(_UNNOTICED):
                causes = " and ".join(dict.fromkeys(_UNNOTICED[name] for name in changed))
                self._outdate(entry, f"{causes} changed")
                self.warn(f"what an earlier run found is not used, because {causes} has changed since.")

    def outdate(self) -> None:
        """Mark all results as stale, without their names: a study that changed takes up those that it still has."""
        self.append(*(replace(one, name="", state=STALE, why="the study changed") for one in self.entries if one.file))

    def _outdate(self, entry: Entry, why: str) -> None:
        """Mark a result as stale, and what follows from it."""
        if entry.state != STALE:
            self.append(replace(entry, state=STALE, why=why))
            digest = lasting_digest(entry.key)
            for other in self.entries:
                if other.file and digest in other.parts.values():
                    self._outdate(other, "it follows from a stale result")


# --- Work of one's own ------------------------------------------------------------------------------------------------


def kept(
    name: str,
    function: Callable[..., Result],
    *arguments: Any,
    version: str | int = "",
    progress: Progress | None = None,
    **named: Any,
) -> Result:
    """What a function returns for some arguments; in a run's folder, what an earlier run has found by the same work.

        count = ext.kept("rejects of the given tolerances", count_rejects, tolerances, samples=1_000_000)

    A journal keeps designs, evidence and fronts by itself (see `al.journal`); with this it keeps any other work too:
    a count, an enumeration, an `al.expand`. The work is the same if the name, the arguments and the version are the
    same, and the function's code with the globals and closures that it names. What it asks of `al.solve` and the like
    is a part of this one result.

    - `name`: by which the journal lists the result, as `work` of this name;
    - `function`: gets all that it works with as arguments, and returns what Python can pickle;
    - `version`: say another one where the work is another although its own code is the same, because a file that it
      reads or a function that it calls by another name has changed;
    - `progress`: given to the function as its own `progress`, if any; the result does not follow from it.

    Work that another run could not recognise is done each time, with a `JournalWarning`: by a function that names what
    cannot be written out, such as a lock. So is work whose result no other process could read. Ctrl-C ends the work,
    whatever the function makes of it.

    Raises `TypeError` for arguments that the function does not take, and `ProblemError` if it returns None.
    """
    reported = {} if progress is None else {"progress": progress}
    bound = inspect.signature(function).bind(*arguments, **named, **reported).arguments
    given = {f"argument {one}": value for one, value in bound.items() if one not in reported}

    def computed() -> Result:
        with heeding() as heed:  # what it asks for may have ended early without saying so
            result = function(*arguments, **named, **reported)
            heed()
        if result is None:
            raise ProblemError(f"kept: '{name}': expected a function that returns what is kept; it returned None.")
        return result

    called = getattr(function, "__qualname__", type(function).__qualname__)
    identity = {"function": function, "called": called, "version": str(version)}
    return journalled(f"work {name}", identity | given, computed)
