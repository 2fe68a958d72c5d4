"""`Robot`: the tree of bodies that a file describes, and `Reading`, which the readers of all formats fill."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, final
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import equinox as eqx
import numpy as np
from scipy.spatial.transform import Rotation
from typing_extensions import override

from aleator._core.border import content_of, members, refusal
from aleator._core.errors import ProblemError
from aleator._core.leaves import transparent
from aleator.mechanics import Body, Closure, Coupling, Multibody
from aleator.mechanics._bodies import sorted_bodies

Key = TypeVar("Key", int, str)
# The rounding error of a rotation matrix, whose zeros and ones are not exact.
_ROUNDING = 1e-15
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
        self._reader, self._path = reader, path
        self.left_out = members(f"{reader}: leave_out", [leave_out] if isinstance(leave_out, str) else leave_out, str)
        if unknown := [name for name in self.left_out if name not in _EFFECTS]:
            raise refusal(f"{reader}: leave_out", f"some of {sorted(_EFFECTS)}", unknown[0])
        self.bodies: list[Body] = []
        self.limits: dict[str, tuple[float, float]] = {}
        self.notes: list[str] = []
        self.effects: dict[str, list[str]] = {}

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
        except TypeError as error:
            raise refusal(self._reader, "the path of a file", self._path) from error
        except (OSError, ValueError, LookupError, expat.ExpatError) as error:
            reason = getattr(error, "strerror", None) or error
            raise self.broken("", f"expected a file of XML that can be read; received: {reason}.") from error
        root = builder.close()
        if root.tag != outermost:
            raise self.broken("", f"expected <{outermost}> as the outermost element; received <{root.tag}>.")
        return root

    def link(self, name: str, parent: str | None, joint: Any, place: Any, *weight: Any) -> None:
        """Add a body. `place`: its position and orientation; `weight`: mass, center, and moments by `moments`."""
        mass, center, inertia = weight
        where = {"position": place[0], "orientation": place[1]}
        with self.naming(f"link '{name}'"):
            body = Body(name, parent=parent, joint=joint, mass=mass or 0, center=center, inertia=inertia, **where)
        self.bodies.append(body)

    def carrier(self, name: str, parent: str | None, joint: Any, place: Any) -> None:
        """Add a body without mass that a joint moves, and with it what is fixed to it."""
        self.link(name, parent, joint, place, 0, (0, 0, 0), (0, 0, 0))

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
    return (0, 0, 0) if np.array_equal(clean, np.eye(3)) else geometry(clean)


def moments(matrix: Any, turned: Rotation) -> Any:
    """Moments of inertia along the axes of a body, from a matrix (3, 3) of those along axes that are turned."""
    if not np.any(matrix):
        return (0, 0, 0)
    if not np.array_equal(orientation(turned), (0, 0, 0)):
        matrix = turned.as_matrix() @ matrix @ turned.as_matrix().T
    numbers = matrix[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return numbers if np.any(numbers[3:]) else numbers[:3]
