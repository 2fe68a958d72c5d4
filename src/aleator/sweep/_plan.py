"""The points of a front in the order in which workers solve them, each from the nearest of those before."""

from collections.abc import Iterator, Mapping, Sequence
from typing import final


@final
class Plan:
    """Points from coarse to fine, by the values of their bound.

    Each starts from the nearest solved point of an earlier group (`groups`), whichever points other workers have
    finished by then. So a front depends neither on the number of workers nor on their speed.
    """

    def __init__(self, values: Sequence[float]):
        earlier = list[float]()
        self._before = dict[float, list[float]]()
        for group in groups(values):
            for value in group:
                self._before[value] = sorted(earlier, key=lambda one, value=value: abs(one - value))
            earlier += group
        self.first = earlier[0]

    def ready(self, finished: Mapping[float, bool]) -> Iterator[tuple[float, float | None]]:
        """The points that can be begun by now, each once, and the point that each starts from; None for its own start.

        `finished`: whether a finished point was solved.
        """
        for value, before in list(self._before.items()):
            nearest = next((one for one in before if finished.get(one, True)), None)
            if nearest is None or nearest in finished:
                del self._before[value]
                yield value, nearest


def groups(values: Sequence[float]) -> list[list[float]]:
    """Values in groups: the first given, the ends, then the middles of the gaps between those before, and so on."""
    ordered = sorted(values)
    found, gaps = [[values[0]], [ordered[0], ordered[-1]]], [(0, len(ordered) - 1)]
    while gaps:
        found.append([ordered[(low + high) // 2] for low, high in gaps if high - low > 1])
        gaps = [gap for low, high in gaps if high - low > 1 for gap in _halves(low, high)]
    known: set[float] = set()
    fresh = [[one for one in dict.fromkeys(group) if one not in known and not known.add(one)] for group in found]
    return [group for group in fresh if group]


def _halves(low: int, high: int) -> list[tuple[int, int]]:
    return [(low, (low + high) // 2), ((low + high) // 2, high)]
