"""The journal of a run: finished results that a later run with the same code and numbers takes from there.

Whoever computes a result that takes long asks for its place (`journalled`), without knowing whether anybody keeps a
journal, and where. A long one is kept part by part, every few seconds; files of JSON lines only grow.
"""

import abc
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, final

from aleator._core.border import content_of, json_of

Result = TypeVar("Result")


class NotKeptError(KeyboardInterrupt):
    """A result is not in the folder: work on it stops here, as Ctrl-C would stop it, and keeps what it has."""


class AbstractParts(abc.ABC):
    """Finished parts of a result that is not finished, by the number at which each begins."""

    @abc.abstractmethod
    def recall(self, number: int) -> Any:
        """The part that begins at a number; None if no earlier run has finished it."""

    @abc.abstractmethod
    def keep(self, number: int, part: Any) -> None:
        """Keep a part at once, until the whole result is kept."""


def _nothing(given: Any) -> None:
    del given


@final
@dataclass(frozen=True)
class Place:
    """The place of one result in a journal. As it stands, one to which nothing can be added.

    - `recalled`: what an earlier run found, None if there is nothing;
    - `parts`: those of the result so far; None where nothing is kept of these;
    - `keep`: keeps a finished result at once, unless the user stopped it;
    - `failed`: notes the exception in the place of a result.
    """

    recalled: Any = None
    parts: AbstractParts | None = None
    keep: Callable[[Any], None] = _nothing
    failed: Callable[[BaseException], None] = _nothing


class AbstractJournal(abc.ABC):
    """Gives results their places."""

    @abc.abstractmethod
    def place(self, what: str, given: Mapping[str, Any]) -> Place:
        """The place of a result that follows from what is given, whatever the process."""


_present: ContextVar[AbstractJournal | None] = ContextVar("journal", default=None)
_parts: ContextVar[AbstractParts | None] = ContextVar("parts of the result that is being computed", default=None)
_called: ContextVar[str] = ContextVar("name of the work", default="")


@contextmanager
def _set(variable: ContextVar[Any], value: Any) -> Iterator[None]:
    """Let a variable have a value within a block."""
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)


def journalling(journal: AbstractJournal) -> AbstractContextManager[None]:
    """Let results within a block be kept by a journal."""
    return _set(_present, journal)


def place_of(what: str, given: Mapping[str, Any]) -> Place:
    """The place of a result in the present journal; one that keeps nothing if there is none."""
    journal = _present.get()
    return Place() if journal is None else journal.place(what, given)


def calling(name: str) -> AbstractContextManager[None]:
    """Let a journal call what is computed within a block by a name, until a study gives it another."""
    return _set(_called, name)


def called() -> str:
    """The name of the present work; empty if it has none."""
    return _called.get()


def journalled(what: str, given: Mapping[str, Any], compute: Callable[[], Result]) -> Result:
    """The result that an earlier run has found from the same code and numbers, or else computed and kept.

    `given`: all that the result follows from, by name. Results within it are computed without a journal: they are parts
    of this one.
    """
    place = place_of(what, given)
    if place.recalled is not None:
        return place.recalled
    try:
        with _set(_present, None), _set(_parts, place.parts):
            result = compute()
    except BaseException as error:
        place.failed(error)
        raise
    place.keep(result)
    return result


def parts_so_far() -> AbstractParts | None:
    """The parts of the result that is being computed, for whoever computes it part by part; None if none are kept."""
    return _parts.get()


_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

# What is finished is kept so often, in seconds: a crash costs no more, and a file each time costs little.
_OFTEN = 3.0


def part_by_part(
    items: Sequence[_Item],
    work: Callable[[Sequence[_Item]], Iterator[tuple[_Item, _Result]]],
    parts: AbstractParts | None,
) -> Iterator[tuple[_Item, _Result]]:
    """What `work` finds for each item, in order; it is given those alone that no earlier run has finished."""
    keeping = _Keeping(parts)
    done = len(keeping.earlier)
    yield from zip(items[:done], keeping.earlier, strict=True)
    for item, found in work(items[done:]):
        keeping.add(found)
        yield item, found


def call_by_call(work: Callable[[_Item], _Result], parts: AbstractParts | None) -> Callable[[_Item], _Result]:
    """A function whose first calls an earlier run has answered: for the same calls in the same order."""
    keeping = _Keeping(parts)
    known = iter(keeping.earlier)

    def answer(item: _Item) -> _Result:
        found = next(known, None)
        if found is None:
            found = work(item)
            keeping.add(found)
        return found

    return answer


@final
class _Keeping:
    """Results of an earlier run, from the first one on without a gap, and the later ones, kept together for seconds."""

    def __init__(self, parts: AbstractParts | None):
        self.earlier = list[Any]()
        while parts is not None and (some := parts.recall(len(self.earlier))) is not None:
            self.earlier += some
        self._parts, self._first = parts, len(self.earlier)
        self._unkept = list[Any]()
        self._kept_at = time.monotonic()

    def add(self, result: Any) -> None:
        """Add the next result."""
        if self._parts is None:
            return
        self._unkept.append(result)
        if time.monotonic() - self._kept_at >= _OFTEN:
            self._parts.keep(self._first, self._unkept)
            self._first += len(self._unkept)
            self._unkept, self._kept_at = [], time.monotonic()


class Line(NamedTuple):
    """A line that was written whole: its number from 1, its text, and what it says; None if it is no JSON."""

    number: int
    text: bytes
    value: Any


class Lines(NamedTuple):
    """The whole lines of a file, their size in bytes, and what stands after them: a last line that was cut off."""

    lines: tuple[Line, ...]
    size: int
    cut: bytes


def read_lines(path: Path) -> Lines:
    """The whole lines of a file; none if there is no file. A last line without its end was cut off by a crash.

    Raises `OSError` if it cannot be read.
    """
    try:
        content = content_of(path)
    except FileNotFoundError:
        return Lines((), 0, b"")
    *whole, cut = content.split(b"\n")
    lines = [Line(number, text, _value(text)) for number, text in enumerate(whole, 1) if text.strip()]
    return Lines(tuple(lines), len(content) - len(cut), cut)


def _value(text: bytes) -> Any:
    try:
        return json_of(text)
    except ValueError:  # UnicodeDecodeError is one
        return None
