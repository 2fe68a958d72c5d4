"""The bodies and joints of a compiled MuJoCo model, as those of a tree."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from aleator.foreign._mjcf_effects import is_disabled
from aleator.foreign._mjcf_types import Model
from aleator.foreign._robot import carriers, known
from aleator.foreign._xml import geometry
from aleator.mechanics import AbstractJoint, Ball, Body, Fixed, Free, Prismatic, Revolute

_FREE, _BALL, _SLIDE, _HINGE = range(4)
# The rounding error of a rotation matrix from a quaternion, whose zeros and ones are not exact.
_ROUNDING = 1e-15


def joints_of(model: Model) -> dict[int, str]:
    """The names of the bodies that carry joints, by MuJoCo's number of the joint: those of the joints, as a rule."""
    links = [link_name(model, body) for body in range(1, model.nbody)]
    given = {i: model.joint(i).name or link_name(model, int(model.jnt_bodyid[i])) for i in range(model.njnt)}
    carried = carriers({i: name for i, name in given.items() if not _is_link_itself(model, i)}, links)
    return {i: carried.get(i, name) for i, name in given.items()}


def bodies_of(model: Model, joints: Mapping[int, str]) -> list[Body]:
    """The bodies of a model, parents first: each link, and before it what carries it."""
    return [part for body in range(1, model.nbody) for part in _link(model, joints, body)]


def posture_of(model: Model, joints: Mapping[int, str]) -> dict[str, float]:
    """The coordinates of the reference posture that are not zero."""
    found: dict[str, float] = {}
    for joint, name in joints.items():
        ends = _joint(model, joint).coordinates
        first = int(model.jnt_qposadr[joint])
        values = model.qpos0[first : first + len(ends)].tolist()
        found |= {f"{name}{end}": value for end, value in zip(ends, values, strict=True) if value}
    return found


def _link(model: Model, joints: Mapping[int, str], body: int) -> Iterator[Body]:
    """A link and the bodies of its joints, each of which is turned about its own anchor."""
    name, above = link_name(model, body), int(model.body_parentid[body])
    parent = link_name(model, above) if above else None
    position, rotation = model.body_pos[body], rotation_of(model.body_quat[body])
    mine: Any = Fixed()
    for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
        kind, axis = model.jnt_type[joint], model.jnt_axis[joint]
        reference = float(model.qpos0[model.jnt_qposadr[joint]])
        if kind == _FREE:
            # Its coordinates are those of the world.
            position, rotation = np.zeros(3), np.eye(3)
        anchor = np.zeros(3) if kind in (_FREE, _SLIDE) else model.jnt_pos[joint]
        position = position + rotation @ anchor
        if kind == _SLIDE:
            position = position - rotation @ axis * reference
        if kind == _HINGE:
            rotation = rotation @ _about(axis, -reference)
        if _is_link_itself(model, joint):
            mine = _joint(model, joint)
            break
        carrier = joints[joint]
        place = {"position": geometry(position), "orientation": orientation(rotation)}
        still = {"mass": 0, "center": (0, 0, 0), "inertia": (0, 0, 0)}
        yield Body(carrier, parent=parent, joint=_joint(model, joint), **still, **place)
        parent, position, rotation = carrier, -anchor, np.eye(3)
    mass = float(model.body_mass[body])
    yield Body(
        name,
        parent=parent,
        joint=mine,
        mass=mass or 0,
        center=geometry(model.body_ipos[body]),
        inertia=_inertia(model.body_inertia[body], rotation_of(model.body_iquat[body])),
        position=geometry(position),
        orientation=orientation(rotation),
    )


def link_name(model: Model, body: int) -> str:
    """The name of a body, or one by its number."""
    return model.body(body).name or f"body_{body}"


def _is_link_itself(model: Model, joint: int) -> bool:
    """Whether a joint needs no body of its own: it has no name, and is the only one of its link, at its origin."""
    is_alone = model.body_jntnum[model.jnt_bodyid[joint]] == 1
    return is_alone and not model.joint(joint).name and not np.any(model.jnt_pos[joint])


def _joint(model: Model, joint: int) -> AbstractJoint:
    kind = model.jnt_type[joint]
    if kind in (_FREE, _BALL):
        return Free() if kind == _FREE else Ball()
    stiffness = 0.0 if is_disabled(model, "SPRING") else float(model.jnt_stiffness[joint])
    speed = model.jnt_dofadr[joint]
    damping = 0.0 if is_disabled(model, "DAMPER") else float(model.dof_damping[speed])
    return (Prismatic if kind == _SLIDE else Revolute)(
        geometry(model.jnt_axis[joint]),
        damping=damping or 0,
        stiffness=stiffness or 0,
        rest=known(float(model.qpos_spring[model.jnt_qposadr[joint]])),
        armature=float(model.dof_armature[speed]) or 0,
    )


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """The rotation matrix of a quaternion of any length."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _about(axis: np.ndarray, angle: float) -> np.ndarray:
    return rotation_of(np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis]))


def orientation(rotation: np.ndarray) -> Any:
    """A rotation matrix, or no angles for none; entries that are whole but for rounding are whole."""
    whole = np.round(rotation)
    clean = np.where(np.abs(rotation - whole) < _ROUNDING, whole, rotation)
    return (0, 0, 0) if np.array_equal(clean, np.eye(3)) else tuple(map(geometry, clean))


def _inertia(moments: np.ndarray, rotation: np.ndarray) -> tuple[float, ...]:
    """Principal moments along turned axes as those along the axes of the body."""
    if not np.any(moments):
        return (0, 0, 0)
    if np.array_equal(orientation(rotation), (0, 0, 0)):
        return tuple(moments.tolist())
    matrix = rotation @ np.diag(moments) @ rotation.T
    return tuple(matrix[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist())
