"""Files of robots: numbers and names in their XML, sentences for broken ones, effects that a tree has no place for."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from aleator._core.border import members
from aleator._core.errors import ProblemError
from aleator.foreign._robot import known

_READERS = {"robot": "al.foreign.read_urdf", "mujoco": "al.foreign.read_mjcf"}
EFFECTS: Mapping[str, str] = {
    "friction": "dry friction; put a smooth law into `bias` of a model of your own",
    "mimic": "a coordinate that follows another one; add a constraint to a model of your own",
    "extensions": "attributes that the format does not have; replace numbers of the robot that is read without them",
    "equality": "equations but connect, joint, and weld in space; write them as `constraint` of a model of your own",
    "tendons": "springs, dampers or inertia of tendons",
    "ball": "springs, dampers or armature of a ball or free joint",
    "polynomials": "stiffness or damping that is not constant",
    "actuators": "armature or damping of actuators; give them to the joints",
    "fluid": "forces of a fluid; write them as `body_loads` of a model of your own",
    "gravcomp": "compensated gravity",
    "flex": "deformable bodies",
    "plugins": "plugins of bodies",
}
"""The effects that can be left out, and what they are."""


def broken(path: str | Path, where: str, what: str) -> ProblemError:
    """The error that names a file, an element in it, and what is wrong there."""
    return ProblemError(f"{path}, {where}: {what}" if where else f"{path}: {what}")


def root_of(reader: str, path: str | Path, outermost: str) -> Element:
    """The outermost element of a file. Raises `ProblemError` where it cannot be read, or has another name."""
    try:
        root = _parsed(Path(path).read_bytes())
    except TypeError as error:
        raise ProblemError(f"{reader}: expected the path of a file; received {path!r}.") from error
    except (OSError, ValueError, LookupError) as error:
        reason = getattr(error, "strerror", None) or error
        raise broken(path, "", f"expected a file that can be read; received: {reason}.") from error
    except expat.ExpatError as error:
        raise broken(path, "", f"expected XML; received what is none: {error}.") from error
    if root.tag != outermost:
        other = f" Read it by {_READERS[root.tag]}." if root.tag in _READERS else ""
        raise broken(path, "", f"expected <{outermost}> as the outermost element; received <{root.tag}>.{other}")
    return root


def _parsed(text: bytes) -> Element:
    """XML without namespaces: robots' files use prefixes, such as those of other programs, that they do not declare."""
    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(text, True)
    return builder.close()


@dataclass(frozen=True)
class Place:
    """An element, and where it is: in a file, and under a name that a user finds there."""

    path: str | Path
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
        # Python takes 1_000 for a number, and no other reader of these files does.
        if len(found) != count or "_" in text or not np.isfinite(found).all():
            expected = "a finite number" if count == 1 else f"{count} finite numbers"
            raise broken(self.path, self.where, f"expected {attribute} as {expected}; received {text!r}.")
        return found


def geometry(numbers: Iterable[float]) -> tuple[float | int, ...]:
    """Numbers of a place or a direction; zeros and ones as whole numbers."""
    return tuple(map(known, numbers))


def checked_effects(reader: str, given: Any) -> frozenset[str]:
    """The effects that a user leaves out. Raises `ProblemError` for what is none."""
    names = members(f"{reader}: leave_out", [given] if isinstance(given, str) else given, str)
    for name in names:
        if name not in EFFECTS:
            raise ProblemError(f"{reader}: leave_out: expected some of {sorted(EFFECTS)}; received {name!r}.")
    return frozenset(names)


def refuse_effects(
    path: str | Path, found: Mapping[str, Collection[str]], left_out: Collection[str]
) -> tuple[str, ...]:
    """Notes on the effects found, by name with the elements that have them.

    Raises `ProblemError` for one that is not left out.
    """
    missing = tuple(name for name in found if name not in left_out)
    if missing:
        what = f"a tree of bodies has no place for {EFFECTS[missing[0]]}"
        raise broken(path, _shown(found[missing[0]]), f"{what}. Or read the robot without it by leave_out={missing!r}.")
    return tuple(f"Left out, as asked: {name} ({_shown(elements)})." for name, elements in found.items())


def _shown(elements: Collection[str]) -> str:
    return ", ".join(list(elements)[:3]) + (f" and {len(elements) - 3} more" if len(elements) > 3 else "")
