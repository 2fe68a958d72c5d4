"""Readings of code, and descriptions of the differences between two of them."""

from typing import Any, NamedTuple, final


class Place(NamedTuple):
    """A place where code reads something: the owner, the kind (a global, a closure variable, ...) and the name."""

    who: str
    kind: str
    name: str

    def __str__(self) -> str:
        if self.kind == "code":
            return f"the code of {self.who}"
        if self.kind == "attribute":
            return f"{self.who}.{self.name}"
        if self.kind == "name":
            return f"'{self.name}' in {self.who}"
        return f"the {self.kind} '{self.name}' that {self.who} reads"


@final
class Reading(NamedTuple):
    """Everything that some code reads.

    - `reads`: the object at each place, equal if unchanged; `doubts`: places where a change cannot be detected.
    """

    reads: tuple[tuple[Place, Any], ...]
    doubts: tuple[Place, ...]

    def by_place(self) -> dict[Place, list[Any]]:
        """The objects read at each place."""
        found: dict[Place, list[Any]] = {}
        for place, token in self.reads:
            found.setdefault(place, []).append(token)
        return found


def changed_places(old: Reading, new: Reading) -> dict[Place, str]:
    """The places at which two readings differ, each with a description of the difference."""
    before, after = old.by_place(), new.by_place()
    return {
        place: _difference(before.get(place, []), after.get(place, []))
        for place in dict.fromkeys([*before, *after])
        if before.get(place) != after.get(place)
    }


def _difference(before: list[Any], after: list[Any]) -> str:
    shown = [repr(one[0].value) for one in (before, after) if len(one) == 1 and isinstance(one[0], Plain)]
    return f"was {shown[0]} and is {shown[1]}" if len(shown) == 2 and shown[0] != shown[1] else "has changed"


class Same:
    """An object that is equal only to itself, kept alive."""

    __slots__ = ("it",)

    def __init__(self, it: Any):
        self.it = it

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and self.it is other.it

    def __hash__(self) -> int:
        return id(self.it)


@final
class Again(Same):
    """An object that has been read before: the one that came as number `order`."""

    __slots__ = ("order",)

    def __init__(self, it: Any, order: int):
        super().__init__(it)
        self.order = order


class Plain(NamedTuple):
    """An immutable value: 1 and True differ, and so do 0.0 and -0.0."""

    kind: type
    value: Any
    text: str = ""
