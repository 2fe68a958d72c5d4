"""URDF: the Unified Robot Description Format of ROS (wiki.ros.org/urdf/XML), read by the XML parser of Python.

Of a URDF, dynamics need a handful of elements, which are all read here: a library would bring meshes and viewers along,
and would not say which element is wrong. Nothing is computed from geometry, which this format does not do either.
"""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from aleator._core.border import meant, one_of
from aleator.foreign._robot import Reading, Robot, carriers, geometry, moments
from aleator.mechanics import Fixed, Free, Prismatic, Revolute

_AXIAL = {"revolute": Revolute, "continuous": Revolute, "prismatic": Prismatic}
_KINDS = (*_AXIAL, "fixed", "floating")
# What is read, and what has no part in the motion of a tree of bodies.
_READ = {
    "robot": ("link", "joint", "material"),
    "link": ("inertial", "visual", "collision"),
    "joint": ("origin", "parent", "child", "axis", "dynamics", "limit", "mimic", "calibration", "safety_controller"),
}
# The attributes of elements that say where things are and what they weigh: another one is a slip of the pen.
_ATTRIBUTES = {
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "mass": ("value",),
    "inertia": ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"),
    "parent": ("link",),
    "child": ("link",),
}


def read_urdf(path: str | Path, *, floating: bool = False, leave_out: Sequence[str] = ()) -> Robot:
    """The robot in a URDF file, as a tree of bodies: an `al.Multibody` whose numbers are fields.

    - `floating`: whether the first link moves freely (coordinates `<link>_x`, ...), as those of drones and walking
      robots; otherwise it is fixed to the ground;
    - `leave_out`: effects to do without, by name: "friction" (dry friction, `<dynamics friction>`), "mimic" (a joint
      that follows another one becomes a joint of its own), "ball" (dampers of floating joints) and "extensions"
      (attributes of `<dynamics>` that the format does not have). A file with one of these is refused otherwise.

    Read are links with their inertial elements, and fixed, revolute, continuous, prismatic and floating joints with
    their dampers. Limits are in `robot.limits`. Geometry is not looked at: no file of a mesh need exist, bodies pass
    through one another, and a link without `<inertial>` has no mass, as the format has it. `robot.notes` says what else
    was not read.

    Raises `ProblemError`, with the file and the element, for what is no URDF, no tree or no possible body.
    """
    reading = Reading("read_urdf", path, leave_out)
    one_of("read_urdf: floating", floating, bool)
    root = reading.root("robot")
    links, joints = (_named(reading, root, tag) for tag in ("link", "joint"))
    names = carriers({name: name for name in joints}, links)
    _link(links[_root(reading, links, joints)], None, Free() if floating else Fixed())
    for name, joint in joints.items():
        _joint(joint, names[name], links)
    if root.find("link/collision") is not None:
        reading.notes.append("There is no contact: bodies pass through one another.")
    if bare := [name for name, link in links.items() if link.element.find("inertial") is None]:
        reading.notes.append(f"Links without <inertial> have no mass: {', '.join(bare)}.")
    for owner, tags in _READ.items():
        elements = [root] if owner == "robot" else root.findall(owner)
        if others := sorted({str(child.tag) for element in elements for child in element}.difference(tags)):
            reading.notes.append(f"Not read, in <{owner}>: {', '.join(f'<{tag}>' for tag in others)}.")
    return reading.robot()


class _Place(NamedTuple):
    """An element of a file, under a name that a user finds there."""

    reading: Reading
    where: str
    element: Element

    def child(self, tag: str) -> "_Place":
        """The element of a tag within; one without attributes if there is none.

        Raises `ProblemError` for several, and for attributes that it does not have.
        """
        found = self.element.findall(tag)
        place = _Place(self.reading, f"{self.where}, <{tag}>", found[0] if found else Element(tag))
        known = _ATTRIBUTES.get(tag, tuple(place.element.attrib))
        if others := [attribute for attribute in place.element.attrib if attribute not in known]:
            raise self.reading.broken(place.where, f"expected some of {list(known)}; received {others[0]!r}.")
        if len(found) > 1:
            raise self.reading.broken(place.where, f"expected one such element; received {len(found)}.")
        return place

    def text(self, attribute: str) -> str:
        """An attribute. Raises `ProblemError` where it is missing or empty."""
        if found := self.element.get(attribute, "").strip():
            return found
        raise self.reading.broken(self.where, f"expected the attribute {attribute}; received none.")

    def numbers(self, attribute: str, default: Any = None, count: int = 3) -> tuple[float, ...]:
        """So many finite numbers. Raises `ProblemError` for others."""
        if default is not None and attribute not in self.element.attrib:
            return tuple(default)
        text, found = self.text(attribute), ()
        with contextlib.suppress(ValueError):
            found = tuple(map(float, text.split()))
        if len(found) != count or not np.isfinite(found).all():
            what = f"expected {attribute} as finite numbers, {count} of them; received {text!r}."
            raise self.reading.broken(self.where, what)
        return found

    def number(self, attribute: str, default: float | None = None) -> float:
        """One finite number. Raises `ProblemError` for others."""
        return self.numbers(attribute, None if default is None else (default,), 1)[0]


def _named(reading: Reading, root: Element, tag: str) -> dict[str, _Place]:
    """The elements of a tag by name."""
    found: dict[str, _Place] = {}
    for element in root.findall(tag):
        name = _Place(reading, f"<{tag}>", element).text("name")
        if name in found:
            raise reading.broken(f"{tag} '{name}'", f"expected one {tag} of this name; received two.")
        found[name] = _Place(reading, f"{tag} '{name}'", element)
    return found


def _root(reading: Reading, links: Mapping[str, _Place], joints: Mapping[str, _Place]) -> str:
    """The link that no joint carries. Raises `ProblemError` for ends of joints that are no links, and for no tree."""
    carried: dict[str, str] = {}
    for name, joint in joints.items():
        for end in ("parent", "child"):
            if (link := joint.child(end).text("link")) not in links:
                what = f"expected a link of the file as its {end}; received '{link}'.{meant(link, links)}"
                raise reading.broken(joint.where, what)
        if (other := carried.setdefault(link := joint.child("child").text("link"), name)) != name:
            raise reading.broken(
                f"link '{link}'",
                f"expected one joint that carries it; received '{other}' and '{name}'. A tree has no loops: remove one "
                "joint, and close the loop by al.joints.Closure in a model of your own.",
            )
    roots = [name for name in links if name not in carried]
    if len(roots) != 1:
        what = f"expected one <link> that no joint carries, the root; received {roots or 'none'}"
        raise reading.broken("", f"{what}. Connect all but one of them by joints of the type fixed.")
    return roots[0]


def _link(link: _Place, parent: str | None, joint: Any, place: Any = ((0, 0, 0), (0, 0, 0))) -> None:
    """Read a link with its inertia, in its own frame."""
    # Without <inertial> it has no mass; with it, its numbers are needed.
    inertial, default = link.child("inertial"), 0.0 if link.element.find("inertial") is None else None
    origin, given = inertial.child("origin"), inertial.child("inertia")
    xx, yy, zz, xy, xz, yz = (given.number(name, default) for name in _ATTRIBUTES["inertia"])
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    turned = Rotation.from_euler("xyz", origin.numbers("rpy", (0, 0, 0)))
    mass, center = inertial.child("mass").number("value", default), geometry(origin.numbers("xyz", (0, 0, 0)))
    link.reading.link(link.text("name"), parent, joint, place, mass, center, moments(matrix, turned))


def _joint(joint: _Place, name: str, links: Mapping[str, _Place]) -> None:
    """Read a joint and the link behind it, its limits, and its effects for which a tree has no place."""
    parent, link = joint.child("parent").text("link"), links[joint.child("child").text("link")]
    place = [geometry(joint.child("origin").numbers(part, (0, 0, 0))) for part in ("xyz", "rpy")]
    if (kind := joint.text("type")) == "fixed":
        _link(link, parent, Fixed(), place)
        return
    reading, dynamics, limit = joint.reading, joint.child("dynamics"), joint.child("limit")
    damping, friction = dynamics.number("damping", 0.0), dynamics.number("friction", 0.0)
    if kind in _AXIAL:
        axis = geometry(joint.child("axis").numbers("xyz", (1, 0, 0)))
        with reading.naming(joint.where):
            moving: Any = _AXIAL[kind](axis, damping=damping or 0, stiffness=0, rest=0, armature=0)
    elif kind == "floating":
        moving = Free()
    else:
        raise reading.broken(joint.where, f"expected a joint of the types {list(_KINDS)}; received '{kind}'.")
    reading.carrier(name, parent, moving, place)
    _link(link, name, Fixed())

    others = sorted(dynamics.element.attrib.keys() - {"damping", "friction"})
    for effect, elements in {
        "mimic": [joint.where] * (joint.element.find("mimic") is not None),
        "friction": [joint.where] * (friction != 0),
        "ball": [joint.where] * (kind == "floating" and damping != 0),
        "extensions": [f"{joint.where} ({attribute})" for attribute in others],
    }.items():
        reading.effects.setdefault(effect, []).extend(elements)
    if kind in ("revolute", "prismatic") and limit.element.attrib:
        reading.limits[name] = limit.number("lower", 0.0), limit.number("upper", 0.0)
    for attribute, output in (("velocity", f"{name}_rate"), ("effort", f"{name}_torque")):
        if kind in _AXIAL and attribute in limit.element.attrib:
            reading.limits[output] = -limit.number(attribute), limit.number(attribute)
