"""Numbers and names in the attributes of XML elements."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self
from xml.etree.ElementTree import Element

import numpy as np

from aleator.foreign._files import broken
from aleator.foreign._robot import known


@dataclass(frozen=True)
class Place:
    """An element, and where it is: in a file, and under a name that a user finds there."""

    path: Any
    where: str
    element: Element

    def child(self, tag: str) -> Self | None:
        """The element of a tag within, if there is one. Raises `ProblemError` for several."""
        found = self.element.findall(tag)
        if len(found) > 1:
            raise broken(self.path, self.where, f"expected one <{tag}>; received {len(found)}.")
        return type(self)(self.path, f"{self.where}, <{tag}>", found[0]) if found else None

    def needed(self, tag: str) -> Self:
        """The element of a tag within. Raises `ProblemError` where there is none."""
        found = self.child(tag)
        if found is None:
            raise broken(self.path, self.where, f"expected <{tag}>; received none.")
        return found

    def text(self, attribute: str) -> str:
        """An attribute. Raises `ProblemError` where it is missing or empty."""
        found = self.element.get(attribute, "").strip()
        if not found:
            raise broken(self.path, self.where, f"expected the attribute {attribute}; received none.")
        return found

    def numbers(self, attribute: str, default: Sequence[float] | None = None) -> tuple[float, ...]:
        """Three finite numbers. Raises `ProblemError` for others."""
        if default is not None and attribute not in self.element.attrib:
            return tuple(default)
        return self._finite(attribute, 3)

    def number(self, attribute: str, default: float | None = None) -> float:
        """One finite number. Raises `ProblemError` for others."""
        if default is not None and attribute not in self.element.attrib:
            return default
        return self._finite(attribute, 1)[0]

    def _finite(self, attribute: str, count: int) -> tuple[float, ...]:
        text = self.text(attribute)
        try:
            found = tuple(map(float, text.split()))
        except ValueError:
            found = ()
        if len(found) != count or not np.isfinite(found).all():
            expected = "a finite number" if count == 1 else f"{count} finite numbers"
            raise broken(self.path, self.where, f"expected {attribute} as {expected}; received {text!r}.")
        return found


def geometry(numbers: Sequence[float]) -> tuple[float | int, ...]:
    """Numbers of a place or a direction; zeros and ones as whole numbers."""
    return tuple(map(known, numbers))
