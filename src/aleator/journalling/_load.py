"""`load`: the results in a folder, as objects again."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator._core.border import meant
from aleator._core.errors import ProblemError
from aleator.journalling import _results
from aleator.journalling._entry import FILE, Entry, State, numbered, read
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
