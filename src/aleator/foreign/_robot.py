"""`Robot`: the tree of bodies that a file describes; `Reading`, which the readers of all formats fill; URDF.

URDF is the Unified Robot Description Format of ROS (wiki.ros.org/urdf/XML). Of it, dynamics need a handful of elements,
which are all read here, by the XML parser of Python: a library would bring meshes and viewers along, and would not say
which element is wrong. Nothing is computed from geometry, which this format does not do either.
"""

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, final
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import equinox as eqx
import numpy as np
from scipy.spatial.transform import Rotation
from typing_extensions import override

from aleator._core.border import content_of, meant, members, one_of, refusal
from aleator._core.errors import ProblemError
from aleator._core.leaves import transparent
from aleator.mechanics import Body, Closure, Coupling, Fixed, Free, Multibody, Prismatic, Revolute
from aleator.mechanics._bodies import sorted_bodies

Key = TypeVar("Key", int, str)
# The rounding error of a rotation matrix, whose zeros and ones are not exact.
_ROUNDING = 1e-15
_NONE = (0, 0, 0)
# The effects that can be left out, and what they are.
_EFFECTS: Mapping[str, str] = {
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


@final
@transparent("parts")
class Robot(Multibody):
    """A mechanical system read from a file, by `al.foreign.read_urdf` or `al.foreign.read_mjcf`.

    - `parts`: its bodies by name. Each link of the file is a body with its `mass`, `center` and `inertia`, and each
      joint that moves is a body without mass, with its `joint` (`axis`, `damping`, `stiffness`, `rest`, `armature`),
      `position` and `orientation`; the link behind it is fixed to it. A joint whose name a link has as well ends in
      `_joint`; one without a name is part of its link. Coordinates and torques have the names of the joints;
    - `gravity` (3,), m/s²; a URDF has none, and gets `(0, 0, -9.81)`;
    - `loops`: the joints that close loops, by name, as `al.joints.Closure`; `couplings`: coordinates that follow
      others, by name, with their `coefficients`. Both are constraints, whose multipliers have their names;
    - `limits`: what the file allows, by the names of outputs: `robot.limits["elbow"]` is the lowest and the highest
      angle, beside `elbow_rate` and `elbow_torque`. Nothing enforces them: they are for constraints of a problem;
    - `start`: the coordinates in the file's own posture, where they are not zero;
    - `notes`: what was in the file and is not in the model, in sentences.

    Any of its numbers may be replaced:

        robot = eqx.tree_at(lambda robot: robot.parts["forearm"].mass, robot, al.Uniform(3.0, half_width=0.2))

    For more bodies, loads, or outputs write an `al.Multibody` with a robot as a field, whose `bodies` begin with
    `self.robot.bodies()`, and whose `closures` with `self.robot.closures()`.
    """

    parts: dict[str, Body]
    gravity: Any = (0.0, 0.0, -9.81)
    loops: dict[str, Closure] = eqx.field(default_factory=dict, kw_only=True)
    couplings: dict[str, Coupling] = eqx.field(default_factory=dict, kw_only=True)
    # A dictionary of a pytree comes back in the order of the alphabet.
    order: tuple[str, ...] = eqx.field(static=True, default=(), kw_only=True)
    allowed: tuple[tuple[str, tuple[float, float]], ...] = eqx.field(static=True, default=(), kw_only=True)
    posture: tuple[tuple[str, float], ...] = eqx.field(static=True, default=(), kw_only=True)
    notes: tuple[str, ...] = eqx.field(static=True, default=(), kw_only=True)

    limits = property(lambda self: dict(self.allowed))
    start = property(lambda self: dict(self.posture))

    @override
    def bodies(self) -> Sequence[Body]:
        return tuple(self.parts[name] for name in self.order)

    @override
    def closures(self) -> Sequence[Closure | Coupling]:
        held = {**self.loops, **self.couplings}
        return tuple(held[name] for name in (*sorted(self.loops), *sorted(self.couplings)))


@final
class Reading:
    """What a reader has found in a file: `bodies`, `limits` by output, `notes`, and `effects` without a place in a tree
    of bodies, by name with the elements that have them.

    Raises `ProblemError` for effects to leave out that there are not.
    """

    def __init__(self, reader: str, path: str | Path, leave_out: Any):
        self._path = one_of(reader, path, (str, Path), "'robot.xml'")
        self.left_out = members(f"{reader}: leave_out", [leave_out] if isinstance(leave_out, str) else leave_out, str)
        if unknown := [name for name in self.left_out if name not in _EFFECTS]:
            raise refusal(f"{reader}: leave_out", f"some of {sorted(_EFFECTS)}", unknown[0])
        self.bodies: list[Body] = []
        self.limits: dict[str, tuple[float, float]] = {}
        self.notes: list[str] = []
        self.effects = defaultdict[str, list[str]](list)

    def broken(self, where: str, what: str) -> ProblemError:
        """The error that names the file, an element in it, and what is wrong there."""
        return ProblemError(f"{self._path}, {where}: {what}" if where else f"{self._path}: {what}")

    @contextmanager
    def naming(self, where: str) -> Iterator[None]:
        """Have errors of a block say in which element they arose."""
        try:
            yield
        except ProblemError as error:
            raise self.broken(where, str(error)) from error

    def root(self, outermost: str) -> Element:
        """The outermost element of the file. Raises `ProblemError` where it cannot be read, or has another name.

        Without namespaces: robots' files use prefixes, such as those of other programs, that they do not declare.
        """
        builder, parser = TreeBuilder(), expat.ParserCreate()
        parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
        parser.CharacterDataHandler = builder.data
        try:
            parser.Parse(content_of(self._path), True)
        except (OSError, ValueError, LookupError, expat.ExpatError) as error:
            reason = getattr(error, "strerror", None) or error
            raise self.broken("", f"expected a file of XML that can be read; received: {reason}.") from error
        root = builder.close()
        if root.tag != outermost:
            raise self.broken("", f"expected <{outermost}> as the outermost element; received <{root.tag}>.")
        return root

    def link(self, name: str, parent: str | None, joint: Any, place: Any = (_NONE, _NONE), **weight: Any) -> None:
        """Add a body; `place`: its position and orientation; `weight`: its mass, center, and inertia by `moments`, none
        of a body that only carries a joint.
        """
        numbers = {"position": place[0], "orientation": place[1], "mass": 0, "center": _NONE, "inertia": _NONE}
        with self.naming(f"link '{name}'"):
            self.bodies.append(Body(name, parent=parent, joint=joint, **(numbers | weight)))

    def robot(self, **fields: Any) -> Robot:
        """The robot, with further fields.

        Raises `ProblemError` for what is no tree, and for an effect that is not left out.
        """
        shown: dict[str, str] = {}
        for name, elements in self.effects.items():
            if found := list(dict.fromkeys(elements)):
                shown[name] = ", ".join(found[:3]) + f" and {len(found) - 3} more" * (len(found) > 3)
        if missing := tuple(name for name in shown if name not in self.left_out):
            what = f"a tree of bodies has no place for {_EFFECTS[missing[0]]}"
            advice = f"Or read the robot without it by leave_out={missing!r}."
            raise self.broken(shown[missing[0]], f"{what}. {advice}")
        left_out = [f"Left out, as asked: {name} ({elements})." for name, elements in shown.items()]
        limits = ["Limits are in robot.limits; nothing enforces them."] * bool(self.limits)
        with self.naming(""):
            parts = {body.name: body for body in sorted_bodies(self.bodies)}
        notes = (*left_out, *self.notes, *limits)
        return Robot(parts, order=tuple(parts), allowed=tuple(self.limits.items()), notes=notes, **fields)


def carriers(joints: Mapping[Key, str], links: Collection[str]) -> dict[Key, str]:
    """The names of the bodies that carry joints: those of the joints, with an ending where a link has the same."""
    found: dict[Key, str] = {}
    for joint, name in joints.items():
        taken = {*links, *joints.values(), *found.values()}
        others = (f"{name}_joint{end}" for end in ("", *(f"_{i}" for i in range(2, len(taken) + 3))))
        found[joint] = name if name not in links else next(other for other in others if other not in taken)
    return found


def geometry(numbers: Any) -> Any:
    """Numbers of a place, a direction or a rotation, each by itself: structure if all are zeros and ones.

    Structure costs nothing where a model is traced.
    """
    array = np.array(numbers, dtype=float)
    return tuple((array.astype(int) if np.isin(array, (-1, 0, 1)).all() else array).tolist())


def orientation(turned: Rotation) -> Any:
    """A rotation as a matrix, or no angles for none; entries that are whole but for rounding are whole."""
    matrix = turned.as_matrix()
    whole = np.round(matrix)
    clean = np.where(np.abs(matrix - whole) < _ROUNDING, whole, matrix)
    return _NONE if np.array_equal(clean, np.eye(3)) else geometry(clean)


def moments(matrix: Any, turned: Rotation) -> Any:
    """Moments of inertia along the axes of a body, from a matrix (3, 3) of those along axes that are turned."""
    if not np.any(matrix):
        return _NONE
    if not np.array_equal(orientation(turned), _NONE):
        matrix = turned.as_matrix() @ matrix @ turned.as_matrix().T
    numbers = matrix[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return numbers if np.any(numbers[3:]) else numbers[:3]


# --- URDF -------------------------------------------------------------------------------------------------------------

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
        with suppress(ValueError):
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


def _link(link: _Place, parent: str | None, joint: Any, *place: Any) -> None:
    """Read a link with its inertia, in its own frame."""
    # Without <inertial> it has no mass; with it, its numbers are needed.
    inertial, default = link.child("inertial"), 0.0 if link.element.find("inertial") is None else None
    origin, given = inertial.child("origin"), inertial.child("inertia")
    xx, yy, zz, xy, xz, yz = (given.number(name, default) for name in _ATTRIBUTES["inertia"])
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    turned = Rotation.from_euler("xyz", origin.numbers("rpy", (0, 0, 0)))
    mass, center = inertial.child("mass").number("value", default), geometry(origin.numbers("xyz", (0, 0, 0)))
    weight = {"mass": mass or 0, "center": center, "inertia": moments(matrix, turned)}
    link.reading.link(link.text("name"), parent, joint, *place, **weight)


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
            moving: Any = _AXIAL[kind](axis, damping=damping or 0)
    elif kind == "floating":
        moving = Free()
    else:
        raise reading.broken(joint.where, f"expected a joint of the types {list(_KINDS)}; received '{kind}'.")
    reading.link(name, parent, moving, place)
    _link(link, name, Fixed())

    others = sorted(dynamics.element.attrib.keys() - {"damping", "friction"})
    reading.effects["mimic"] += [joint.where] * (joint.element.find("mimic") is not None)
    reading.effects["friction"] += [joint.where] * (friction != 0)
    reading.effects["ball"] += [joint.where] * (kind == "floating" and damping != 0)
    reading.effects["extensions"] += [f"{joint.where} ({attribute})" for attribute in others]
    if kind in ("revolute", "prismatic") and limit.element.attrib:
        reading.limits[name] = limit.number("lower", 0.0), limit.number("upper", 0.0)
    for attribute, output in (("velocity", f"{name}_rate"), ("effort", f"{name}_torque")):
        if kind in _AXIAL and attribute in limit.element.attrib:
            reading.limits[output] = -limit.number(attribute), limit.number(attribute)
