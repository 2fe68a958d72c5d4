"""`load`: the results in a folder, as objects again."""

import socket
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator._core.border import meant
from aleator._core.errors import ProblemError
from aleator.journalling import _results
from aleator.journalling._entry import FILE, Entry, State, named, read, seen, unfinished
from aleator.journalling._keys import Keys
from aleator.reporting import as_path, has_writer, words


@final
class Loaded(Mapping[str, Any]):
    """The results of a run by name, read from their files when they are asked for. `print(loaded)` shows all entries.

    - `entries`: every result that was begun, with its state, who began it and when, how long it took, and its file.

    Names are those of what was done, counted in the order of their beginnings: `"solve Cushion 1"`,
    `"validate Cushion 1"`; those that a study gives, such as `"designs/robust"`, are known as well.
    """

    def __init__(self, folder: Path, entries: tuple[Entry, ...]):
        self._folder, self.entries = folder, entries
        self._named = named(entries)

    @override
    def __getitem__(self, name: str) -> Any:
        found = self._of(name)
        if not found:
            hint = meant(name, self._known()) if isinstance(name, str) else ""
            raise ProblemError(f"load: there is no result '{name}' in '{self._folder}'.{hint}")
        if len(found) > 1:
            each = words([f"'{one}'" for one in found])
            raise ProblemError(f"load: several results in '{self._folder}' are called '{name}': ask for one of {each}.")
        (entry,) = found.values()
        return _results.read(self._folder / entry.file, entry.digest, entry.key)

    @override
    def __iter__(self) -> Iterator[str]:
        return iter(self._named)

    @override
    def __len__(self) -> int:
        return len(self._named)

    @override
    def __contains__(self, name: object) -> bool:
        return len(self._of(name)) == 1

    def _of(self, name: object) -> dict[str, Entry]:
        """The results that a name may mean."""
        if name in self._named:
            return {str(name): self._named[str(name)]}
        return {own: one for own, one in self._named.items() if name and one.name == name}

    def _known(self) -> list[str]:
        """All names."""
        return [*self._named, *(one.name for one in self._named.values() if one.name)]

    def __str__(self) -> str:
        return listing(self._folder, self.entries)


def listing(folder: Path, entries: Iterable[Entry]) -> str:
    """How many results a folder has, and all entries, a line each, with the names by which `load` knows them."""
    entries = list(entries)
    keys = names_of(entries)
    there = sum(one.is_finished and one.state not in (State.STALE, State.LOST) for one in entries)
    return "\n".join(
        [
            f"{folder}: {'1 result' if there == 1 else f'{there} results'}",
            *(f"  {one.told(keys.get(one.key, one.what))}" for one in entries),
        ]
    )


def names_of(entries: Iterable[Entry]) -> dict[str, str]:
    """The names of results in `load`, by their keys in the journal."""
    return {one.key: name for name, one in named(entries).items()}


def load(folder: str | Path) -> Loaded:
    """The results that `al.journal` or `aleator run` has kept in a folder, as objects: solutions and evidence by name.

    Their model's module must be importable. Reading them runs code, as importing a module does: files are read only if
    they belong to you, nobody else can write to them, and their content is what was written. Labelled numbers for
    other programs are in the same files, and in `results.nc`.

    Raises `ProblemError` if there is no journal, and, when a result is asked for, if it cannot be read.
    """
    place = as_path(folder)
    return Loaded(place, entries_in(place))


def entries_in(place: Path) -> tuple[Entry, ...]:
    """What the journal of a folder says, in the order of beginnings; what waits comes last.

    Raises `ProblemError` if there is no journal.
    """
    if not (place / FILE).is_file():
        raise ProblemError(
            f"load: there is no journal in '{place}': expected a folder in which `aleator run` or a script within "
            "`al.journal(folder)` has kept results."
        )
    entries = map(seen, read(place / FILE).by_key.values())
    return tuple(sorted(entries, key=lambda one: one.state is State.WAITING))


def examined(place: Path) -> tuple[Entry, ...]:
    """What the journal of a folder says, and what is so: whether somebody works there, and whether files are whole.

    What is running has been interrupted if no process writes there any more; a result whose file is missing or
    damaged is lost. Raises `ProblemError` if there is no journal.
    """
    entries, busy = entries_in(place), has_writer(place)
    return tuple(_examined(place, one, busy) for one in entries)


def _examined(place: Path, one: Entry, busy: bool) -> Entry:
    if one.state is State.RUNNING and not busy and one.host == socket.gethostname():
        one = unfinished(one)
    if not one.is_finished or not (why := _results.damage(place / one.file, one.digest)):
        return one
    return replace(one, state=State.LOST, why=f"{why}; it is computed again when it is asked for")


def finished(folder: Path, entries: Iterable[Entry], keys: Keys) -> tuple[dict[str, Any], list[str]]:
    """All results that can be read, by the names that a study gives them, or else those of `load`; and what cannot.

    Where several have one name, it is that of the last. Their keys are remembered, so that what follows from them is
    recognised.
    """
    found, refused = dict[str, Any](), list[str]()
    there = named(entries)
    last = {one.name: one.key for one in there.values()}
    for name, entry in there.items():
        place = entry.name if entry.name and last[entry.name] == entry.key else name
        try:
            found[place] = result = _results.read(folder / entry.file, entry.digest, entry.key)
        except ProblemError as error:
            refused.append(str(error))
        else:
            keys.remember(result, entry.key)
    return found, refused
