"""Bodies, joints and equations of a compiled MuJoCo model, as those of a tree.

`connect` and `weld` become closed loops, `joint` coupled coordinates. MuJoCo yields where its solver needs to
(`solref`, `solimp`); here equations hold.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from aleator._core.errors import optional
from aleator.foreign._robot import broken, carrier, carriers, geometry, moments, orientation
from aleator.mechanics import AbstractJoint, Ball, Body, Closure, Coupling, Fixed, Free, Prismatic, Revolute

Model: TypeAlias = Any
"""A compiled model, `mujoco.MjModel`, which declares no types: rows of arrays for bodies, joints, speeds and so on."""
_FREE, _BALL, _SLIDE, _HINGE = range(4)
_CONNECT, _WELD, _JOINT = range(3)
# Directions and places that differ by less, relative to one or in m, are the same.
_SAME = 1e-9


def library() -> Any:
    """MuJoCo, imported late. Raises `MissingExtraError` where it is not installed."""
    return optional("mujoco", "read_mjcf", "'aleator[robots]'")


def is_disabled(model: Model, *flags: str) -> bool:
    """Whether a file switches some of the effects off: "SPRING", "DAMPER", "GRAVITY" and others of `mjtDisableBit`."""
    return any(model.opt.disableflags & getattr(library().mjtDisableBit, f"mjDSBL_{flag}") for flag in flags)


def joints_of(model: Model) -> dict[int, str]:
    """The names of the bodies that carry joints, by MuJoCo's number of the joint: those of the joints, as a rule."""
    links = [link_name(model, body) for body in range(1, model.nbody)]
    given = {i: model.joint(i).name or link_name(model, int(model.jnt_bodyid[i])) for i in range(model.njnt)}
    return given | carriers({i: name for i, name in given.items() if not _is_link_itself(model, i)}, links)


def posture_of(model: Model, joints: Mapping[int, str]) -> dict[str, float]:
    """The coordinates of the reference posture that are not zero."""
    found: dict[str, float] = {}
    for joint, name in joints.items():
        ends = _joint(model, joint).coordinates
        values = model.qpos0[model.jnt_qposadr[joint] :][: len(ends)].tolist()
        found |= {f"{name}{end}": value for end, value in zip(ends, values, strict=True) if value}
    return found


def bodies_of(model: Model, joints: Mapping[int, str]) -> Iterator[Body]:
    """The bodies of a model, parents first: each link, and before it those of its joints, each about its anchor."""
    for body in range(1, model.nbody):
        parent = link_name(model, int(model.body_parentid[body]))
        position, turned = model.body_pos[body], _rotation(model.body_quat[body])
        mine: Any = Fixed()
        for joint in _joints_on(model, body):
            kind, axis = model.jnt_type[joint], model.jnt_axis[joint]
            reference = float(model.qpos0[model.jnt_qposadr[joint]])
            anchor = model.jnt_pos[joint] if kind in (_BALL, _HINGE) else np.zeros(3)
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
            yield carrier(joints[joint], parent, _joint(model, joint), geometry(position), orientation(turned))
            parent, position, turned = joints[joint], -anchor, Rotation.identity()
        yield Body(
            link_name(model, body) or "",
            parent=parent,
            joint=mine,
            mass=float(model.body_mass[body]) or 0,
            center=geometry(model.body_ipos[body]),
            inertia=moments(np.diag(model.body_inertia[body]), _rotation(model.body_iquat[body])),
            position=geometry(position),
            orientation=orientation(turned),
        )


def link_name(model: Model, body: int) -> Any:
    """The name of a body, or one by its number; None for the ground."""
    return model.body(body).name or f"body_{body}" if body else None


def _joints_on(model: Model, body: int) -> range:
    return range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])


def _is_link_itself(model: Model, joint: int) -> bool:
    """Whether a joint needs no body of its own: it has no name, and is the only one of its link, at its origin."""
    is_alone = model.body_jntnum[model.jnt_bodyid[joint]] == 1
    return is_alone and not model.joint(joint).name and not np.any(model.jnt_pos[joint])


def _joint(model: Model, joint: int) -> AbstractJoint:
    kind = model.jnt_type[joint]
    if kind in (_FREE, _BALL):
        return Free() if kind == _FREE else Ball()
    speed = model.jnt_dofadr[joint]
    stiffness = 0 if is_disabled(model, "SPRING") else float(model.jnt_stiffness[joint])
    damping = 0 if is_disabled(model, "DAMPER") else float(model.dof_damping[speed])
    return (Prismatic if kind == _SLIDE else Revolute)(
        geometry(model.jnt_axis[joint]),
        damping=damping or 0,
        stiffness=stiffness or 0,
        rest=float(model.qpos_spring[model.jnt_qposadr[joint]]) or 0,
        armature=float(model.dof_armature[speed]) or 0,
    )


def _rotation(quaternion: np.ndarray) -> Rotation:
    return Rotation.from_quat(quaternion, scalar_first=True)


class _End(NamedTuple):
    """A frame that an equation binds: of a body, in whose frame it has a position and a rotation; and in the world."""

    body: int
    position: Float[np.ndarray, "3"]
    turned: Rotation
    place: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "3 3"]


class Equalities(NamedTuple):
    """Active equations of a model: those that a robot holds, by name, notes on these, and the numbers of the others."""

    loops: dict[str, Closure]
    couplings: dict[str, Coupling]
    notes: list[str]
    others: list[int]


def equalities_of(path: str | Path, model: Model, joints: Mapping[int, str], *, left_out: bool) -> Equalities:
    """The active equations of a model whose joints have these names; none is held if they are `left_out`.

    A weld of a loop in one plane is not held: it would say three things twice, and so leave its forces undetermined.
    Raises `ProblemError` for one that cannot hold, because nothing between its bodies moves as it would have to.
    """
    loops, couplings, notes, others = found = Equalities({}, {}, [], [])
    if is_disabled(model, "CONSTRAINT", "EQUALITY"):
        return found
    data = library().MjData(model)  # in the reference posture
    library().mj_kinematics(model, data)
    for index in np.flatnonzero(model.eq_active0).tolist():
        name, kind = model.equality(index).name or f"equality_{index}", model.eq_type[index]
        if left_out or kind not in (_CONNECT, _WELD, _JOINT):
            others.append(index)
            continue
        if kind == _JOINT:
            couplings[name] = _coupling(model, name, index, joints)
            continue
        ends = outer, inner = _ends(model, data, index)
        axis, is_still = _plane(model, data, ends), not _between(model, ends)
        # Nothing moves the points along these directions.
        fixed = np.eye(3) if is_still else np.zeros((3, 0)) if axis is None else axis[:, None]
        if (distance := float(np.linalg.norm((inner.place - outer.place) @ fixed))) > _SAME:
            what = f"expected points that its joints can bring together; received two that stay {distance:.3g} m apart."
            raise broken(path, f"equality '{name}'", what)
        if is_still:
            notes.append(f"Equality '{name}' says nothing: its bodies do not move against one another.")
        elif kind == _WELD and axis is not None:
            others.append(index)
        else:
            loops[name] = _closure(model, name, kind == _WELD, ends, axis)
    if loops or couplings:
        notes.append(f"Equations hold exactly, where MuJoCo yields: {', '.join([*loops, *couplings])}.")
    if not left_out and (asleep := int(np.sum(model.eq_active0 == 0))):
        notes.append(f"Equations that are not active at the start are not read ({asleep}).")
    return found


def _coupling(model: Model, name: str, index: int, joints: Mapping[int, str]) -> Coupling:
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


def _closure(model: Model, name: str, is_weld: bool, ends: tuple[_End, _End], axis: Any) -> Closure:
    outer, inner = ends
    joint: Any = Fixed() if is_weld else Ball()
    if axis is not None:
        own = outer.axes.T @ axis
        along = int(np.argmax(np.abs(own)))
        # An axis of coordinates by its name, whatever its sense.
        joint = Revolute("xyz"[along] if abs(own[along]) > 1 - _SAME else geometry(own))
    turned = [orientation(end.turned) if is_weld else (0, 0, 0) for end in ends]
    return Closure(
        name,
        parent=link_name(model, outer.body),
        child=link_name(model, inner.body),
        joint=joint,
        position=geometry(outer.position),
        child_position=geometry(inner.position),
        orientation=turned[0],
        child_orientation=turned[1],
        planar=axis is not None,
    )


def _ends(model: Model, data: Any, index: int) -> tuple[_End, _End]:
    """What an equation binds, as MuJoCo's engine takes its numbers."""
    numbers, straight = model.eq_data[index], Rotation.identity()

    def end(body: int, position: np.ndarray, turned: Rotation = straight) -> _End:
        axes = data.xmat[body].reshape(3, 3)
        return _End(body, position, turned, data.xpos[body] + axes @ position, axes)

    first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    if model.eq_objtype[index] == library().mjtObj.mjOBJ_SITE:
        site = [(int(model.site_bodyid[i]), model.site_pos[i], _rotation(model.site_quat[i])) for i in (first, second)]
        return end(*site[0]), end(*site[1])
    if model.eq_type[index] == _WELD:
        return end(first, numbers[3:6], _rotation(numbers[6:10])), end(second, numbers[:3])
    return end(first, numbers[:3]), end(second, numbers[3:6])


def _between(model: Model, ends: tuple[_End, _End]) -> list[int]:
    """The joints by which two bodies move against one another."""
    chains = [set(_upwards(model, end.body)) for end in ends]
    return [joint for body in sorted(chains[0] ^ chains[1]) for joint in _joints_on(model, body)]


def _upwards(model: Model, body: int) -> Iterator[int]:
    while body:
        yield body
        body = int(model.body_parentid[body])


def _plane(model: Model, data: Any, ends: tuple[_End, _End]) -> Float[np.ndarray, "3"] | None:
    """The direction, in the world's axes, across a plane to which the joints between two bodies confine them."""
    joints = _between(model, ends)
    hinges = [joint for joint in joints if model.jnt_type[joint] == _HINGE]
    if not hinges or any(model.jnt_type[joint] not in (_SLIDE, _HINGE) for joint in joints):
        return None
    axis = data.xaxis[hinges[0]]
    for joint in joints:
        across = data.xaxis[joint] @ axis if model.jnt_type[joint] == _SLIDE else np.cross(data.xaxis[joint], axis)
        if np.max(np.abs(across)) > _SAME:
            return None
    return axis
