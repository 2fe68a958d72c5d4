"""URDF: the Unified Robot Description Format of ROS (wiki.ros.org/urdf/XML), read by the XML parser of Python.

Of a URDF, dynamics need a handful of elements, which are all read here: a library would bring meshes and viewers along,
and would not say which element is wrong. Nothing is computed from geometry, which this format does not do either.
"""

import contextlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from aleator._core.border import meant, one_of
from aleator._core.errors import ProblemError
from aleator.foreign._robot import (
    Robot,
    broken,
    carrier,
    carriers,
    checked_effects,
    geometry,
    moments,
    refuse_effects,
    robot_of,
    root_of,
)
from aleator.mechanics import AbstractJoint, Body, Fixed, Free, Prismatic, Revolute

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
    left_out = checked_effects("read_urdf", leave_out)
    one_of("read_urdf: floating", floating, bool)
    root = root_of("read_urdf", path, "robot")
    if any("xacro" in str(element.tag) or "${" in "".join(element.attrib.values()) for element in root.iter()):
        raise broken(path, "", "expected no macros of xacro. Expand them first: xacro FILE > robot.urdf.")
    links, joints = (_named(path, root, tag) for tag in ("link", "joint"))
    names = carriers({name: name for name in joints}, links)
    bodies = [_body(links[_root(path, links, joints)], None, Free() if floating else Fixed())]
    for name, joint in joints.items():
        bodies += _behind(joint, names[name], links)
    limits = {output: ends for name, joint in joints.items() for output, ends in _limits(joint, names[name])}
    notes = refuse_effects(path, _effects(joints), left_out)
    return robot_of(path, bodies, limits=limits, notes=(*notes, *_notes(root, links, limits)))


class _Place(NamedTuple):
    """An element, and where it is: in a file, and under a name that a user finds there."""

    path: str | Path
    where: str
    element: Element

    def child(self, tag: str) -> "_Place":
        """The element of a tag within; one without attributes if there is none.

        Raises `ProblemError` for several, and for attributes that it does not have.
        """
        found = self.element.findall(tag)
        if len(found) > 1:
            raise self.broken(f"expected one <{tag}>; received {len(found)}.")
        place = _Place(self.path, f"{self.where}, <{tag}>", found[0] if found else Element(tag))
        known = _ATTRIBUTES.get(tag, tuple(place.element.attrib))
        if others := [attribute for attribute in place.element.attrib if attribute not in known]:
            raise place.broken(f"expected some of {list(known)}; received {others[0]!r}.")
        return place

    def has(self, tag: str) -> bool:
        """Whether there is an element of a tag within."""
        return self.element.find(tag) is not None

    def text(self, attribute: str) -> str:
        """An attribute. Raises `ProblemError` where it is missing or empty."""
        found = self.element.get(attribute, "").strip()
        if not found:
            raise self.broken(f"expected the attribute {attribute}; received none.")
        return found

    def numbers(self, attribute: str, default: Any = None, count: int = 3) -> tuple[float, ...]:
        """So many finite numbers. Raises `ProblemError` for others."""
        if default is not None and attribute not in self.element.attrib:
            return tuple(default)
        text, found = self.text(attribute), ()
        with contextlib.suppress(ValueError):
            found = tuple(map(float, text.split()))
        if len(found) != count or not np.isfinite(found).all():
            raise self.broken(f"expected {attribute} as finite numbers, {count} of them; received {text!r}.")
        return found

    def number(self, attribute: str, default: float | None = None) -> float:
        """One finite number. Raises `ProblemError` for others."""
        return self.numbers(attribute, None if default is None else (default,), 1)[0]

    @contextlib.contextmanager
    def naming(self) -> Iterator[None]:
        """Have errors of a block say where they arose."""
        try:
            yield
        except ProblemError as error:
            raise self.broken(str(error)) from error

    def broken(self, what: str) -> ProblemError:
        """The error that says what is wrong here."""
        return broken(self.path, self.where, what)


def _named(path: str | Path, root: Element, tag: str) -> dict[str, _Place]:
    """The elements of a tag by name."""
    found: dict[str, _Place] = {}
    for element in root.findall(tag):
        name = _Place(path, f"<{tag}>", element).text("name")
        if name in found:
            raise broken(path, f"{tag} '{name}'", f"expected one {tag} of this name; received two.")
        found[name] = _Place(path, f"{tag} '{name}'", element)
    return found


def _root(path: str | Path, links: Mapping[str, _Place], joints: Mapping[str, _Place]) -> str:
    """The link that no joint carries. Raises `ProblemError` for ends of joints that are no links, and for no tree."""
    carried: dict[str, str] = {}
    for name, joint in joints.items():
        for end in ("parent", "child"):
            if (link := joint.child(end).text("link")) not in links:
                raise joint.broken(f"expected a link of the file as its {end}; received '{link}'.{meant(link, links)}")
        if (other := carried.setdefault(link := joint.child("child").text("link"), name)) != name:
            raise links[link].broken(
                f"expected one joint that carries it; received '{other}' and '{name}'. A tree has no loops: remove one "
                "joint, and close the loop by al.joints.Closure in a model of your own."
            )
    roots = [name for name in links if name not in carried]
    if len(roots) != 1:
        raise broken(
            path,
            "",
            f"expected one <link> that no joint carries, the root; received {roots or 'none'}. Connect all but one of "
            "them by joints of the type fixed.",
        )
    return roots[0]


def _behind(joint: _Place, name: str, links: Mapping[str, _Place]) -> list[Body]:
    """The bodies of a joint and of the link behind it."""
    parent, link = joint.child("parent").text("link"), links[joint.child("child").text("link")]
    origin = joint.child("origin")
    place = [geometry(origin.numbers(part, (0, 0, 0))) for part in ("xyz", "rpy")]
    if (kind := joint.text("type")) == "fixed":
        return [_body(link, parent, Fixed(), place)]
    if kind not in _KINDS:
        instead = " Use two prismatic joints and a continuous one in its place." if kind == "planar" else ""
        raise joint.broken(f"expected a joint of the types {list(_KINDS)}; received '{kind}'.{instead}")
    return [carrier(name, parent, _joint(joint, kind), *place), _body(link, name, Fixed())]


def _joint(joint: _Place, kind: str) -> AbstractJoint:
    if kind == "floating":
        return Free()
    damping = joint.child("dynamics").number("damping", 0.0)
    axis = geometry(joint.child("axis").numbers("xyz", (1, 0, 0)))
    with joint.naming():
        found = _AXIAL[kind](axis, damping=damping or 0, stiffness=0, rest=0, armature=0)
        found.refuse_impossible()
    return found


def _body(link: _Place, parent: str | None, joint: Any, place: Sequence[Any] = ((0, 0, 0), (0, 0, 0))) -> Body:
    """A link with its inertia, in its own frame."""
    # Without <inertial> it has no mass; with it, its numbers are needed.
    inertial, default = link.child("inertial"), None if link.has("inertial") else 0.0
    origin, given = inertial.child("origin"), inertial.child("inertia")
    xx, yy, zz, xy, xz, yz = (given.number(f"i{name}", default) for name in ("xx", "yy", "zz", "xy", "xz", "yz"))
    turned = Rotation.from_euler("xyz", origin.numbers("rpy", (0, 0, 0)))
    with link.naming():
        return Body(
            link.text("name"),
            parent=parent,
            joint=joint,
            mass=inertial.child("mass").number("value", default) or 0,
            center=geometry(origin.numbers("xyz", (0, 0, 0))),
            inertia=moments(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), turned),
            position=place[0],
            orientation=place[1],
        )


def _effects(joints: Mapping[str, _Place]) -> dict[str, list[str]]:
    """Effects for which a tree has no place, with the joints that have them."""
    found: dict[str, list[str]] = {"mimic": [], "friction": [], "ball": [], "extensions": []}
    for joint in joints.values():
        if (kind := joint.text("type")) == "fixed":
            continue
        dynamics = joint.child("dynamics")
        found["mimic"] += [joint.where] * joint.has("mimic")
        found["friction"] += [joint.where] * (dynamics.number("friction", 0.0) != 0)
        found["ball"] += [joint.where] * (kind == "floating" and dynamics.number("damping", 0.0) != 0)
        others = sorted(dynamics.element.attrib.keys() - {"damping", "friction"})
        found["extensions"] += [f"{joint.where} ({name})" for name in others]
    return found


def _limits(joint: _Place, name: str) -> Iterator[tuple[str, tuple[float, float]]]:
    kind, limit = joint.text("type"), joint.child("limit")
    if kind not in _AXIAL or not joint.has("limit"):
        return
    if kind != "continuous":
        yield name, (limit.number("lower", 0.0), limit.number("upper", 0.0))
    for attribute, output in (("velocity", f"{name}_rate"), ("effort", f"{name}_torque")):
        if attribute in limit.element.attrib:
            yield output, (-limit.number(attribute), limit.number(attribute))


def _notes(root: Element, links: Mapping[str, _Place], limits: Collection[str]) -> Iterator[str]:
    if limits:
        yield "Limits are in robot.limits; nothing enforces them."
    if root.find("link/collision") is not None:
        yield "There is no contact: bodies pass through one another."
    if bare := [name for name, link in links.items() if not link.has("inertial")]:
        yield f"Links without <inertial> have no mass: {', '.join(bare)}."
    for owner, tags in _READ.items():
        elements = [root] if owner == "robot" else root.findall(owner)
        others = sorted({str(child.tag) for element in elements for child in element}.difference(tags))
        if others:
            yield f"Not read, in <{owner}>: {', '.join(f'<{tag}>' for tag in others)}."
