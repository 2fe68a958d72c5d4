"""What a file may describe and a tree of bodies has no place for: refused, unless the user leaves it out by name."""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from aleator._core.border import members
from aleator._core.errors import ProblemError
from aleator.foreign._xml import broken

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
