"""Results one after another, the first ones from an earlier run as far as it came, new ones kept every few seconds."""

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar, final

from aleator._core.journalled import AbstractParts

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

# What is finished is kept so often, in seconds: a crash costs no more, and a file each time costs little.
_OFTEN = 3.0


def part_by_part(
    items: Sequence[_Item],
    work: Callable[[Sequence[_Item]], Iterator[tuple[_Item, _Result]]],
    parts: AbstractParts,
) -> Iterator[tuple[_Item, _Result]]:
    """What `work` finds for each item, in order; it is given those alone that no earlier run has finished."""
    done = 0
    for found in _recalled(parts):
        yield items[done], found
        done += 1
    keeping = _Keeping(parts, done)
    for item, found in work(items[done:]):
        keeping.add(found)
        yield item, found


def call_by_call(work: Callable[[_Item], _Result], parts: AbstractParts) -> Callable[[_Item], _Result]:
    """A function whose first calls an earlier run has answered: for the same calls in the same order."""
    earlier = list(_recalled(parts))
    keeping, known = _Keeping(parts, len(earlier)), iter(earlier)

    def answer(item: _Item) -> _Result:
        found = next(known, None)
        if found is None:
            found = work(item)
            keeping.add(found)
        return found

    return answer


def _recalled(parts: AbstractParts) -> Iterator[Any]:
    """The results of an earlier run, from the first one on, without a gap."""
    done = 0
    while (some := parts.recall(done)) is not None:
        yield from some
        done += len(some)


@final
class _Keeping:
    """Keeps the results from a number on, those of some seconds in one part."""

    def __init__(self, parts: AbstractParts, first: int):
        self._parts, self._first = parts, first
        self._unkept = list[Any]()
        self._kept_at = time.monotonic()

    def add(self, result: Any) -> None:
        """Add the next result."""
        self._unkept.append(result)
        if time.monotonic() - self._kept_at >= _OFTEN:
            self._parts.keep(self._first, self._unkept)
            self._first += len(self._unkept)
            self._unkept, self._kept_at = [], time.monotonic()
