"""Work that was ended goes on from its parts as often as it is ended."""

import itertools

import pytest

from aleator._core import part_by_part
from aleator._core.journalled import AbstractParts


class Kept(AbstractParts):
    """Parts in memory."""

    def __init__(self):
        self.parts = {}

    def recall(self, number):
        return self.parts.get(number)

    def keep(self, number, part):
        self.parts[number] = list(part)


@pytest.mark.parametrize("way", ["part by part", "call by call"])
def test_a_run_that_is_ended_twice_ends_as_an_undisturbed_one(monkeypatch: pytest.MonkeyPatch, way: str):
    monkeypatch.setattr(part_by_part, "_OFTEN", 0.0)
    kept, worked, items = Kept(), [], list(range(7))

    def square(item: int) -> int:
        worked.append(item)
        return item**2

    def results():
        if way == "call by call":
            return map(part_by_part.call_by_call(square, kept), items)
        squares = part_by_part.part_by_part(items, lambda some: ((one, square(one)) for one in some), kept)
        return (found for _, found in squares)

    for ended in (2, 3):
        assert list(itertools.islice(results(), ended)) == [one**2 for one in items[:ended]]
    assert list(itertools.islice(results(), 5)) == [0, 1, 4, 9, 16]
    assert list(results()) == [one**2 for one in items]
    assert worked == items
