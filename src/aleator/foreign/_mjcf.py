"""MJCF, the format of MuJoCo, read by MuJoCo itself.

Defaults, includes, frames, replicated bodies, units of angles, and inertia from shapes have rules that only MuJoCo
knows in full: what it compiles is what it simulates. Where its equations yield (`solref`, `solimp`), ours hold.
"""

import warnings
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from aleator._core.errors import ProblemError, optional
from aleator.foreign._robot import Reading, Robot, carriers, geometry, moments, orientation
from aleator.mechanics import AbstractJoint, Ball, Closure, Coupling, Fixed, Free, Prismatic, Revolute

Model: TypeAlias = Any
"""A compiled model, `mujoco.MjModel`, which declares no types: rows of arrays for bodies, joints, speeds and so on."""
_FREE, _BALL, _SLIDE, _HINGE = range(4)
_CONNECT, _WELD, _JOINT = range(3)
# Directions that differ by less, relative to one, are the same.
_SAME = 1e-9
# Effects by the elements that have them: where one of some fields is not zero, unless a flag switches it off.
_EFFECTS = (
    ("friction", "joint", ("dof_frictionloss",), ("CONSTRAINT", "FRICTIONLOSS")),
    ("friction", "tendon", ("tendon_frictionloss",), ("CONSTRAINT", "FRICTIONLOSS")),
    ("tendons", "tendon", ("tendon_stiffness", "tendon_stiffnesspoly"), ("SPRING",)),
    ("tendons", "tendon", ("tendon_damping", "tendon_dampingpoly"), ("DAMPER",)),
    ("tendons", "tendon", ("tendon_armature",), ()),
    ("ball", "joint", ("jnt_stiffness",), ("SPRING",)),
    ("ball", "joint", ("dof_damping",), ("DAMPER",)),
    ("ball", "joint", ("dof_armature",), ()),
    ("polynomials", "joint", ("jnt_stiffnesspoly",), ("SPRING",)),
    ("polynomials", "joint", ("dof_dampingpoly",), ("DAMPER",)),
    ("actuators", "actuator", ("actuator_armature",), ()),
    ("actuators", "actuator", ("actuator_damping", "actuator_dampingpoly"), ("DAMPER",)),
)


def read_mjcf(path: str | Path, *, leave_out: Sequence[str] = ()) -> Robot:
    """The robot in an MJCF file, as a tree of bodies: an `al.Multibody` whose numbers are fields.

    Needs MuJoCo (`pip install 'aleator[robots]'`), which reads the file with all its defaults, includes and units, and
    computes inertia from primitive shapes. Hinges, slides, balls and free joints are read with springs, dampers and
    armature, several to a body; coordinates have the values that MuJoCo gives them, and the reference posture is in
    `robot.start`, limits in `robot.limits`. Files of meshes and textures need not exist.

    Equations that are active hold exactly: `connect` and `weld` close loops, `joint` couples coordinates
    (`robot.loops`, `robot.couplings`); a loop of hinges in one plane is closed in this plane.

    `leave_out` names effects to do without: "friction" (frictionloss), "equality" (all equations), "tendons" (their
    springs, dampers and armature), "ball" (those of ball and free joints), "polynomials" (stiffness or damping that
    varies), "actuators" (their armature and damping), "fluid", "gravcomp", "flex", "plugins". A file with others is
    refused, and so is one with inertia from a mesh. Each joint has a torque in the place of the file's actuators; there
    is no contact. `robot.notes` says what else was not read.

    Raises `ProblemError`, with the file and the element, for what is no MJCF or no possible body, and
    `MissingExtraError` without MuJoCo.
    """
    reading = Reading("read_mjcf", path, leave_out)
    reading.root("mujoco")
    model = _compiled(path, reading)
    joints, posture = _joints_of(model), dict[str, float]()
    for body in range(1, model.nbody):
        _read_body(model, body, joints, reading)
    for i, name in joints.items():
        joint = model.joint(i)
        places = zip(_joint(model, joint).coordinates, joint.qpos0.tolist(), strict=True)
        posture |= {f"{name}{end}": value for end, value in places if value}
        is_axial = joint.type[0] in (_SLIDE, _HINGE)
        if is_axial and joint.limited[0] and not _is_disabled(model, "LIMIT"):
            reading.limits[name] = tuple(joint.range.tolist())
        if is_axial and model.jnt_actfrclimited[i]:
            reading.limits[f"{name}_torque"] = tuple(model.jnt_actfrcrange[i].tolist())
    loops, couplings = _equations(model, joints, reading)
    _note_effects(model, reading)
    gravity = (0.0, 0.0, 0.0) if _is_disabled(model, "GRAVITY") else tuple(model.opt.gravity.tolist())
    return reading.robot(gravity=gravity, posture=tuple(posture.items()), loops=loops, couplings=couplings)


def _library() -> Any:
    """MuJoCo, imported late. Raises `MissingExtraError` where it is not installed."""
    return optional("mujoco", "read_mjcf", "'aleator[robots]'")


def _compiled(path: str | Path, reading: Reading) -> Model:
    """The compiled model, without its deformable bodies, which are an effect.

    Raises `ProblemError` for what MuJoCo refuses, and for inertia from a mesh.
    """
    with warnings.catch_warnings(record=True, action="always") as heard:
        try:
            specification = _library().MjSpec.from_file(str(path))
            reading.effects["flex"] += [f"flex '{flex.name}'" for flex in specification.flexes]
            _delete(specification, specification.flexes)
            # Bodies keep their names and places.
            specification.compiler.fusestatic = False
            _remove_files(specification, reading)
            model = specification.compile()
        except ProblemError:
            raise
        except ValueError as error:
            said = "; ".join(line.strip() for line in str(error).splitlines() if line.strip())
            raise reading.broken("", f"expected a model that MuJoCo accepts; received its refusal: {said}.") from error
    reading.notes += [f"MuJoCo: {warning.message}." for warning in heard]
    return model


def _remove_files(specification: Any, reading: Reading) -> None:
    """Remove what is read from further files: meshes, height fields, textures, skins, and what refers to them.

    Raises `ProblemError` for inertia from a mesh: where that of a moving body hangs on the size of spheres instead.
    """
    shapes = [geom for geom in specification.geoms if geom.meshname or geom.hfieldname]
    named = [geom.meshname or geom.name for geom in shapes]
    for owner in (*specification.geoms, *specification.sites, *specification.tendons):
        owner.material = ""
    for shape in shapes:
        shape.type, shape.meshname, shape.hfieldname = _library().mjtGeom.mjGEOM_SPHERE, "", ""
    for parts in ("sensors", "tuples", "skins", "meshes", "hfields", "materials", "textures"):
        _delete(specification, getattr(specification, parts))
    if not shapes:
        return
    models = list[Model]()
    for size in (1, 2):
        for shape in shapes:
            shape.size = [size] * 3
        models.append(specification.compile())
    small, large = models
    is_moving, hangs = small.body_weldid > 0, np.any(small.body_inertia != large.body_inertia, axis=1)
    if (bodies := np.flatnonzero(is_moving & hangs)).size:
        name = next((name for name, shape in zip(named, shapes, strict=True) if shape.parent.id == bodies[0]), named[0])
        raise reading.broken(
            f"body '{small.body(bodies[0]).name}'",
            f"expected its inertia in numbers; received a mesh ('{name}') to compute it from, which is not read. Give "
            "the body an <inertial> with pos, mass and fullinertia (MuJoCo writes the numbers that it computes itself "
            "by mj_saveLastXML).",
        )
    for shape in shapes:
        shape.mass = 0
    reading.notes.append(f"Meshes and height fields are not read ({len(shapes)}).")


def _delete(specification: Any, parts: Collection[Any]) -> None:
    for part in list(parts):
        specification.delete(part)


def _is_disabled(model: Model, *flags: str) -> bool:
    """Whether a file switches some of the effects off: "SPRING", "DAMPER", "GRAVITY" and others of `mjtDisableBit`."""
    return any(model.opt.disableflags & getattr(_library().mjtDisableBit, f"mjDSBL_{flag}") for flag in flags)


def _note_effects(model: Model, reading: Reading) -> None:
    """Note effects for which a tree of bodies has no place, with the elements that have them, and what is not read."""

    def add(effect: str, kind: str, places: Iterable[Any]) -> None:
        names = [(int(i), getattr(model, kind)(int(i)).name) for i in places]
        elements = [f"{kind} '{name}'" if name else f"{kind} {i} (without a name)" for i, name in names]
        reading.effects[effect] += elements

    for effect, kind, fields, flags in _EFFECTS:
        # Fields that an older MuJoCo does not have are zero.
        present = [np.asarray(getattr(model, field)) for field in fields if hasattr(model, field)]
        rows = {int(row) for values in present for row in np.argwhere(values)[:, 0]}
        if fields[0].startswith("dof_"):
            rows = {int(model.dof_jntid[row]) for row in rows}
        if effect == "ball":
            rows = {row for row in rows if model.jnt_type[row] in (_FREE, _BALL)}
        add(effect, kind, [] if _is_disabled(model, *flags) else sorted(rows))
    # MuJoCo leaves out all passive forces if both are switched off.
    if not (_is_disabled(model, "SPRING") and _is_disabled(model, "DAMPER")):
        is_weightless = _is_disabled(model, "GRAVITY") or not np.any(model.opt.gravity)
        add("gravcomp", "body", [] if is_weightless else np.flatnonzero(model.body_gravcomp))
        reading.effects["fluid"] += ["option"] * (model.opt.density > 0 or model.opt.viscosity > 0)
    add("plugins", "body", np.flatnonzero(model.body_plugin >= 0))
    for count, note in (
        (model.nu, "Actuators are not read ({}): each joint has a torque of its own."),
        (model.ngeom, "There is no contact: bodies pass through one another."),
        (model.ntendon, "Tendons are not read, nor their limits ({})."),
        (model.nmocap, "Bodies that a program moves (mocap) are fixed to the ground ({})."),
    ):
        if count:
            reading.notes.append(note.format(count))


# --- Bodies and joints ------------------------------------------------------------------------------------------------


def _joints_of(model: Model) -> dict[int, str]:
    """The names of the bodies that carry joints, by MuJoCo's number of the joint: those of the joints, as a rule."""
    links = [_link_name(model, body) for body in range(1, model.nbody)]
    joints = [model.joint(i) for i in range(model.njnt)]
    given = {joint.id: joint.name or _link_name(model, int(joint.bodyid[0])) for joint in joints}
    return given | carriers({joint.id: given[joint.id] for joint in joints if not _is_link_itself(model, joint)}, links)


def _link_name(model: Model, body: int) -> Any:
    """The name of a body, or one by its number; None for the ground."""
    return model.body(body).name or f"body_{body}" if body else None


def _joints_on(model: Model, body: int) -> list[Any]:
    return [model.joint(i) for i in np.flatnonzero(model.jnt_bodyid == body).tolist()]


def _is_link_itself(model: Model, joint: Any) -> bool:
    """Whether a joint needs no body of its own: it has no name, and is the only one of its link, at its origin."""
    return not joint.name and not np.any(joint.pos) and model.body_jntnum[joint.bodyid[0]] == 1


def _read_body(model: Model, body: int, joints: dict[int, str], reading: Reading) -> None:
    """Read a link, and before it the bodies of its joints, each about its anchor."""
    parent = _link_name(model, int(model.body_parentid[body]))
    position, turned = model.body_pos[body], _rotation(model.body_quat[body])
    mine: Any = Fixed()
    for joint in _joints_on(model, body):
        kind, axis, reference = joint.type[0], joint.axis, float(joint.qpos0[0])
        anchor = joint.pos if kind in (_BALL, _HINGE) else np.zeros(3)
        if kind == _FREE:
            # Its coordinates are those of the world.
            position, turned = np.zeros(3), Rotation.identity()
        position = position + turned.apply(anchor)
        if kind == _SLIDE:
            position = position - turned.apply(axis) * reference
        if kind == _HINGE:
            turned = turned * Rotation.from_rotvec(-reference * axis)
        if _is_link_itself(model, joint):
            mine = _joint(model, joint)
            break
        reading.link(joints[joint.id], parent, _joint(model, joint), (geometry(position), orientation(turned)))
        parent, position, turned = joints[joint.id], -anchor, Rotation.identity()
    inertia = moments(np.diag(model.body_inertia[body]), _rotation(model.body_iquat[body]))
    place = geometry(position), orientation(turned)
    weight = {"mass": float(model.body_mass[body]) or 0, "center": geometry(model.body_ipos[body]), "inertia": inertia}
    reading.link(_link_name(model, body), parent, mine, place, **weight)


def _joint(model: Model, joint: Any) -> AbstractJoint:
    if joint.type[0] in (_FREE, _BALL):
        return Free() if joint.type[0] == _FREE else Ball()
    numbers = {"rest": joint.qpos_spring, "armature": joint.armature}
    numbers |= {} if _is_disabled(model, "SPRING") else {"stiffness": joint.stiffness}
    numbers |= {} if _is_disabled(model, "DAMPER") else {"damping": joint.damping}
    kind = Prismatic if joint.type[0] == _SLIDE else Revolute
    return kind(geometry(joint.axis), **{name: float(values[0]) or 0 for name, values in numbers.items()})


def _rotation(quaternion: np.ndarray) -> Rotation:
    return Rotation.from_quat(quaternion, scalar_first=True)


# --- Equations --------------------------------------------------------------------------------------------------------


_End: TypeAlias = tuple[int, Float[np.ndarray, "3"], Rotation]
"""A frame that an equation binds: of a body, in whose frame it has a position and a rotation."""


def _equations(
    model: Model, joints: dict[int, str], reading: Reading
) -> tuple[dict[str, Closure], dict[str, Coupling]]:
    """The active equations that a robot holds, by name; the others are an effect.

    A weld of a loop in one plane is not held: it would say three things twice, and so leave its forces undetermined.
    """
    loops, couplings, others = dict[str, Closure](), dict[str, Coupling](), reading.effects["equality"]
    if _is_disabled(model, "CONSTRAINT", "EQUALITY"):
        return loops, couplings
    for index in np.flatnonzero(model.eq_active0).tolist():
        name, kind = model.equality(index).name or f"equality_{index}", model.eq_type[index]
        if "equality" in reading.left_out or kind not in (_CONNECT, _WELD, _JOINT):
            others.append(f"equality '{name}'")
            continue
        if kind == _JOINT:
            couplings[name] = _coupling(model, name, index, joints)
            continue
        ends = _ends(model, index)
        between = _joints_between(model, ends)
        axis = _plane(model, between)
        if not between:
            reading.notes.append(f"Equality '{name}' says nothing: its bodies do not move against one another.")
        elif kind == _WELD and axis is not None:
            others.append(f"equality '{name}'")
        else:
            loops[name] = _closure(model, name, ends, axis, is_weld=kind == _WELD)
    if loops or couplings:
        reading.notes.append(f"Equations hold exactly, where MuJoCo yields: {', '.join([*loops, *couplings])}.")
    if asleep := int(np.sum(model.eq_active0 == 0)):
        reading.notes.append(f"Equations that are not active at the start are not read ({asleep}).")
    return loops, couplings


def _coupling(model: Model, name: str, index: int, joints: dict[int, str]) -> Coupling:
    ends = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    rest, leader_rest = (float(model.qpos0[model.jnt_qposadr[joint]]) or 0 if joint >= 0 else 0 for joint in ends)
    return Coupling(
        name,
        follower=joints[ends[0]],
        leader=joints.get(ends[1]),
        coefficients=geometry(model.eq_data[index, :5]),
        rest=rest,
        leader_rest=leader_rest,
    )


def _closure(model: Model, name: str, ends: Sequence[_End], axis: Any, *, is_weld: bool) -> Closure:
    (parent, position, turned), (child, child_position, child_turned) = ends
    joint: Any = Fixed() if is_weld else Ball()
    if axis is not None:
        own = _posture(model).xmat[parent].reshape(3, 3).T @ axis
        along = int(np.argmax(np.abs(own)))
        # An axis of coordinates by its name, whatever its sense.
        joint = Revolute("xyz"[along] if abs(own[along]) > 1 - _SAME else geometry(own))
    return Closure(
        name,
        parent=_link_name(model, parent),
        child=_link_name(model, child),
        joint=joint,
        position=geometry(position),
        child_position=geometry(child_position),
        orientation=orientation(turned) if is_weld else (0, 0, 0),
        child_orientation=orientation(child_turned) if is_weld else (0, 0, 0),
        planar=axis is not None,
    )


def _ends(model: Model, index: int) -> list[_End]:
    """What an equation binds, as MuJoCo's engine takes its numbers."""
    numbers, pair = model.eq_data[index], [int(model.eq_obj1id[index]), int(model.eq_obj2id[index])]
    if model.eq_objtype[index] == _library().mjtObj.mjOBJ_SITE:
        return [(int(model.site_bodyid[i]), model.site_pos[i], _rotation(model.site_quat[i])) for i in pair]
    is_weld, straight = model.eq_type[index] == _WELD, Rotation.identity()
    first, second = (numbers[3:6], numbers[:3]) if is_weld else (numbers[:3], numbers[3:6])
    return [(pair[0], first, _rotation(numbers[6:10]) if is_weld else straight), (pair[1], second, straight)]


def _joints_between(model: Model, ends: Sequence[_End]) -> list[Any]:
    """The joints by which two bodies move against one another."""
    chains: list[set[int]] = []
    for body, *_ in ends:
        chains.append(set())
        while body:
            chains[-1].add(body)
            body = int(model.body_parentid[body])
    return [joint for body in sorted(chains[0] ^ chains[1]) for joint in _joints_on(model, body)]


def _plane(model: Model, between: Sequence[Any]) -> Float[np.ndarray, "3"] | None:
    """The direction, in the world's axes, across a plane to which joints confine a loop; None for a loop in space."""
    directions = _posture(model).xaxis
    hinges, slides = ([directions[one.id] for one in between if one.type[0] == kind] for kind in (_HINGE, _SLIDE))
    if not hinges or len(hinges) + len(slides) < len(between):
        return None
    apart = [*np.cross(hinges, hinges[0]).flat, *(slide @ hinges[0] for slide in slides)]
    return hinges[0] if np.max(np.abs(apart)) <= _SAME else None


def _posture(model: Model) -> Any:
    """MuJoCo's data in the reference posture."""
    data = _library().MjData(model)
    _library().mj_kinematics(model, data)
    return data
