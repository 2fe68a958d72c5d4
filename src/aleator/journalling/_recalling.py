"""`recalling`: what a folder has, without computing or writing anything."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.identity import DoubtError
from aleator._core.journalled import AbstractEntry, AbstractJournal, NotKeptError, Settled, journalling
from aleator.journalling import _results
from aleator.journalling._keys import Keys
from aleator.journalling._load import entries_in, finished


@contextmanager
def recalling(folder: Path) -> "Iterator[Recalled]":
    """Take all results within a block from a folder; one that is not there ends its work by `NotKeptError`.

    Nothing is written, so that another process may be writing there. Raises `ProblemError` if there is no journal.
    """
    kept = Recalled(folder)
    with journalling(kept):
        yield kept


@final
class Recalled(AbstractJournal):
    """The results of a folder, for reading alone.

    - `missing`: what was asked for and is not there, or cannot be read, a sentence each.
    """

    def __init__(self, folder: Path):
        self._folder, self._keys = folder, Keys()
        self._entries = {one.key: one for one in entries_in(folder)}
        self.missing = list[str]()

    @override
    def entry(self, what: str, given: Mapping[str, Any]) -> AbstractEntry:
        try:
            identity = self._keys.identity(what, given)
        except DoubtError as doubt:
            raise self._not_kept(f"{what}: no run can tell whether it is the same ({doubt}).") from None
        known = self._entries.get(identity.key)
        if known is None or not known.is_finished:
            raise self._not_kept(f"{identity.what} is missing.")
        try:
            found = _results.read(self._folder / known.file, known.digest, known.key)
        except ProblemError as error:
            raise self._not_kept(str(error)) from error
        self._keys.remember(found, known.key)
        return Settled(found)

    @override
    def expect(self, what: str, problems: Mapping[str, Any]) -> list[str]:
        return []

    @override
    def withdraw(self, keys: Sequence[str]) -> None:
        pass

    def finished(self) -> dict[str, Any]:
        """All results that can be read: see `finished` in `_load`."""
        found, refused = finished(self._folder, self._entries.values(), self._keys)
        self.missing += refused
        return found

    def _not_kept(self, said: str) -> NotKeptError:
        self.missing.append(said)
        return NotKeptError(said)
