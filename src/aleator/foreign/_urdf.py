"""URDF: the Unified Robot Description Format of ROS (wiki.ros.org/urdf/XML), read by the XML parser of Python.

Of a URDF, dynamics need a handful of elements, which are all read here: a library would bring meshes and viewers along,
and would not say which element is wrong. Nothing is computed from geometry, which this format does not do either.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from aleator._core.border import meant, refusal
from aleator._core.errors import ProblemError
from aleator.foreign._robot import (
    Place,
    Robot,
    broken,
    carriers,
    checked_effects,
    geometry,
    known,
    refuse_effects,
    robot_of,
    root_of,
)
from aleator.mechanics import AbstractJoint, Body, Fixed, Free, Prismatic, Revolute

_AXIAL = {"revolute": Revolute, "continuous": Revolute, "prismatic": Prismatic}
_KINDS = (*_AXIAL, "fixed", "floating")
# What is read, and what has no part in the motion of a tree of bodies.
_READ: Mapping[str, frozenset[str]] = {
    "robot": frozenset({"link", "joint", "material"}),
    "link": frozenset({"inertial", "visual", "collision"}),
    "joint": frozenset(
        {"origin", "parent", "child", "axis", "dynamics", "limit", "mimic", "calibration", "safety_controller"}
    ),
}
# The attributes of elements that say where things are and what they weigh: another one is a slip of the pen.
_ATTRIBUTES: Mapping[str, frozenset[str]] = {
    "origin": frozenset({"xyz", "rpy"}),
    "axis": frozenset({"xyz"}),
    "mass": frozenset({"value"}),
    "inertia": frozenset({"ixx", "iyy", "izz", "ixy", "ixz", "iyz"}),
    "parent": frozenset({"link"}),
    "child": frozenset({"link"}),
}


def read_urdf(path: str | Path, *, floating: bool = False, leave_out: Sequence[str] = ()) -> Robot:
    """The robot in a URDF file, as a tree of bodies: an `al.Multibody` whose numbers are fields.

    - `floating`: whether the first link moves freely (coordinates `<link>_x`, ...), as those of drones and walking
      robots; otherwise it is fixed to the ground;
    - `leave_out`: effects to do without, by name: "friction" (dry friction, `<dynamics friction>`), "mimic" (a joint
      that follows another one becomes a joint of its own) and "extensions" (attributes of `<dynamics>` that the format
      does not have). A file with one of these is refused otherwise.

    Read are links with their inertial elements, and fixed, revolute, continuous, prismatic and floating joints with
    their dampers. Limits are in `robot.limits`. Geometry is not looked at: no file of a mesh need exist, bodies pass
    through one another, and a link without `<inertial>` has no mass, as the format has it. `robot.notes` says what else
    was not read.

    Raises `ProblemError`, with the file and the element, for what is no URDF, no tree or no possible body.
    """
    left_out = checked_effects("read_urdf", leave_out)
    if not isinstance(floating, bool):
        raise refusal("read_urdf: floating", "True or False", floating)
    root = root_of("read_urdf", path, "robot")
    _refuse_macros(path, root)
    _refuse_misspelt(path, root)
    links, joints = (_named(path, root, tag) for tag in ("link", "joint"))
    if not links:
        raise broken(path, "", "expected a robot with a <link>; received none.")
    first, joints = ordered(path, links, joints)
    notes = refuse_effects(path, _effects(joints), left_out)
    names = carriers({name: name for name in joints}, links)
    bodies = [_body(links[first], first, parent=None, joint=Free() if floating else Fixed())]
    for name, joint in joints.items():
        bodies += _behind(joint, names[name], links[joint.needed("child").text("link")])
    limits = {output: ends for name, joint in joints.items() for output, ends in _limits(joint, names[name])}
    return robot_of(path, bodies, limits=limits, notes=(*notes, *_notes(root, links, limits)))


def _named(path: str | Path, root: Element, tag: str) -> dict[str, Place]:
    """The elements of a tag by name."""
    found: dict[str, Place] = {}
    for element in root.findall(tag):
        name = Place(path, f"<{tag}>", element).text("name")
        if name in found:
            raise broken(path, f"{tag} '{name}'", f"expected one {tag} of this name; received two.")
        found[name] = Place(path, f"{tag} '{name}'", element)
    return found


def _behind(joint: Place, name: str, link: Place) -> tuple[Body, ...]:
    """The bodies of a joint and of the link behind it."""
    parent, child = joint.needed("parent").text("link"), link.text("name")
    origin = joint.child("origin")
    place = {
        "position": (0, 0, 0) if origin is None else geometry(origin.numbers("xyz", (0, 0, 0))),
        "orientation": (0, 0, 0) if origin is None else geometry(origin.numbers("rpy", (0, 0, 0))),
    }
    if joint.text("type") == "fixed":
        return (_body(link, child, parent=parent, joint=Fixed(), **place),)
    carrier = Body(name, parent=parent, joint=_joint(joint), mass=0, center=(0, 0, 0), inertia=(0, 0, 0), **place)
    still = {"position": (0, 0, 0), "orientation": (0, 0, 0)}
    return carrier, _body(link, child, parent=name, joint=Fixed(), **still)


def _joint(joint: Place) -> AbstractJoint:
    kind = joint.text("type")
    if kind not in _KINDS:
        instead = " Use two prismatic joints and a continuous one in its place." if kind == "planar" else ""
        raise broken(
            joint.path, joint.where, f"expected a joint of the types {list(_KINDS)}; received '{kind}'.{instead}"
        )
    dynamics = joint.child("dynamics")
    damping = 0.0 if dynamics is None else dynamics.number("damping", 0.0)
    if damping < 0:
        raise broken(joint.path, joint.where, f"expected a damping that is not negative; received {damping:g}.")
    if kind == "floating":
        if damping:
            raise broken(joint.path, joint.where, "expected a floating joint without damping; received one with it.")
        return Free()
    given = joint.child("axis")
    axis = (1, 0, 0) if given is None else geometry(given.numbers("xyz", (1, 0, 0)))
    if not any(axis):
        raise broken(joint.path, joint.where, "expected an axis that is not zero; received 0 0 0.")
    return _AXIAL[kind](axis, damping=damping or 0, stiffness=0, rest=0, armature=0)


def _body(link: Place, name: str, **joined: Any) -> Body:
    """A link with its inertia, in its own frame."""
    inertial = link.child("inertial")
    if inertial is None:
        return Body(name, mass=0, center=(0, 0, 0), inertia=(0, 0, 0), **joined)
    mass = inertial.needed("mass").number("value")
    if mass < 0:
        raise broken(link.path, link.where, f"expected a mass that is not negative; received {mass:g}.")
    origin = inertial.child("origin")
    center = (0, 0, 0) if origin is None else geometry(origin.numbers("xyz", (0, 0, 0)))
    turned = (0.0, 0.0, 0.0) if origin is None else origin.numbers("rpy", (0, 0, 0))
    given = inertial.needed("inertia")
    moments = [given.number(f"i{name}") for name in ("xx", "yy", "zz", "xy", "xz", "yz")]
    try:
        return Body(name, mass=mass, center=center, inertia=_along(turned, moments), **joined)
    except ProblemError as error:
        raise broken(link.path, link.where, str(error)) from error


def _along(turned: Sequence[float], moments: Sequence[float]) -> tuple[float | int, ...]:
    """Moments of inertia along the axes of a link, from those along axes that are turned by roll, pitch and yaw."""
    xx, yy, zz, xy, xz, yz = moments
    if not any(turned):
        return (xx, yy, zz, *map(known, (xy, xz, yz))) if any((xy, xz, yz)) else (xx, yy, zz)
    rotation = _rotation(turned)
    matrix = rotation @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ rotation.T
    return tuple(matrix[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist())


def _rotation(angles: Sequence[float]) -> np.ndarray:
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles), np.cos(angles)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def _effects(joints: Mapping[str, Place]) -> dict[str, list[str]]:
    """Effects for which a tree has no place, with the joints that have them."""
    found: dict[str, list[str]] = {}
    for joint in joints.values():
        dynamics = joint.child("dynamics")
        if joint.text("type") == "fixed":
            continue
        if joint.child("mimic") is not None:
            found.setdefault("mimic", []).append(joint.where)
        if dynamics is not None and dynamics.number("friction", 0.0):
            found.setdefault("friction", []).append(joint.where)
        others = () if dynamics is None else dynamics.element.attrib.keys() - {"damping", "friction"}
        found.setdefault("extensions", []).extend(f"{joint.where} ({name})" for name in sorted(others))
    return {name: elements for name, elements in found.items() if elements}


def _limits(joint: Place, name: str) -> Iterator[tuple[str, tuple[float, float]]]:
    kind, limit = joint.text("type"), joint.child("limit")
    if limit is None or kind not in _AXIAL:
        return
    if kind != "continuous":
        ends = limit.number("lower", 0.0), limit.number("upper", 0.0)
        if ends[0] > ends[1]:
            raise broken(limit.path, limit.where, f"expected a lower limit below the upper; received {ends}.")
        yield name, ends
    for attribute, output in (("velocity", f"{name}_rate"), ("effort", f"{name}_torque")):
        if attribute in limit.element.attrib:
            most = limit.number(attribute)
            if most < 0:
                raise broken(limit.path, limit.where, f"expected {attribute} that is not negative; received {most:g}.")
            yield output, (-most, most)


def _notes(root: Element, links: Mapping[str, Place], limits: Collection[str]) -> Iterator[str]:
    if limits:
        yield "Limits are in robot.limits; nothing enforces them."
    if root.find("link/collision") is not None:
        yield "There is no contact: bodies pass through one another."
    bare = [name for name, link in links.items() if link.child("inertial") is None]
    if bare:
        yield f"Links without <inertial> have no mass: {', '.join(bare)}."
    for owner, tags in _READ.items():
        elements = [root] if owner == "robot" else root.findall(owner)
        others = sorted({str(child.tag) for element in elements for child in element} - tags)
        if others:
            yield f"Not read, in <{owner}>: {', '.join(f'<{tag}>' for tag in others)}."


def _refuse_misspelt(path: str | Path, root: Element) -> None:
    """Raise `ProblemError` for elements and attributes that are nearly those that are read, and would be ignored."""
    for owner in (*root.findall("link"), *root.findall("joint")):
        where = f"{owner.tag} '{owner.get('name', '')}'"
        for child in owner:
            tag = str(child.tag)
            if tag not in _READ[owner.tag] and (hint := meant(tag, _READ[owner.tag])):
                raise broken(path, where, f"expected one of {sorted(_READ[owner.tag])}; received <{tag}>.{hint}")
        for part in (*owner.findall("*"), *owner.findall("inertial/*")):
            known = _ATTRIBUTES.get(str(part.tag))
            if known is not None and (others := sorted(set(part.attrib) - known)):
                raise broken(path, where, f"<{part.tag}>: expected some of {sorted(known)}; received {others[0]!r}.")


def _refuse_macros(path: str | Path, root: Element) -> None:
    for element in root.iter():
        if "xacro" in str(element.tag) or any("${" in value for value in element.attrib.values()):
            raise broken(
                path,
                "",
                "expected a URDF; received one with macros of xacro. Expand them first: xacro FILE > robot.urdf.",
            )


def ordered(path: str | Path, links: Mapping[str, Place], joints: Mapping[str, Place]) -> tuple[str, dict[str, Place]]:
    """The first link, and the joints, those of parents before those of children.

    Raises `ProblemError` for links that do not exist, and for joints that make no tree with one root.
    """
    ends = {name: _ends(joint, links) for name, joint in joints.items()}
    carriers: dict[str, str] = {}
    for name, (_, child) in ends.items():
        if child in carriers:
            raise broken(
                path,
                f"link '{child}'",
                f"expected one joint that carries it; received '{carriers[child]}' and '{name}'. A tree has no loops: "
                "remove one joint, and close the loop by al.joints.Closure in a model of your own.",
            )
        carriers[child] = name
    roots = [name for name in links if name not in carriers]
    if len(roots) > 1:
        raise broken(
            path,
            "",
            f"expected one link that no joint carries, the root; received {roots}. Connect all but one of them by "
            "joints of the type fixed.",
        )
    found: dict[str, Place] = {}
    reached = set(roots)
    while following := [name for name, (parent, _) in ends.items() if parent in reached and name not in found]:
        found |= {name: joints[name] for name in following}
        reached |= {ends[name][1] for name in following}
    if len(found) < len(joints):
        circle = [name for name in links if name not in reached]
        raise broken(path, "", f"expected a tree of links; received a cycle: {circle} carry one another.")
    return roots[0], found


def _ends(joint: Place, links: Mapping[str, Place]) -> tuple[str, str]:
    """The links before and behind a joint."""
    parent, child = (joint.needed(end).text("link") for end in ("parent", "child"))
    for end, name in (("parent", parent), ("child", child)):
        if name not in links:
            raise broken(
                joint.path,
                joint.where,
                f"expected a link of the file as its {end}; received '{name}', which is none of {sorted(links)}."[:300],
            )
    return parent, child
