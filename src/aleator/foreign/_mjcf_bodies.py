"""Bodies, joints and equations of a compiled MuJoCo model, as those of a tree.

`connect` and `weld` become closed loops, `joint` coupled coordinates. MuJoCo yields where its solver needs to
(`solref`, `solimp`); here equations hold.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from aleator.foreign._mjcf_model import Model, Posture, is_disabled, library
from aleator.foreign._robot import broken, carriers, geometry, known
from aleator.mechanics import AbstractJoint, Ball, Body, Closure, Coupling, Fixed, Free, Prismatic, Revolute

_FREE, _BALL, _SLIDE, _HINGE = range(4)
# The rounding error of a rotation matrix from a quaternion, whose zeros and ones are not exact.
_ROUNDING = 1e-15
_CONNECT, _WELD, _JOINT = range(3)
# Directions and places that differ by less, relative to one or in m, are the same.
_SAME = 1e-9


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
    return (0, 0, 0) if np.array_equal(clean, np.eye(3)) else geometry(clean)


def _inertia(moments: np.ndarray, rotation: np.ndarray) -> tuple[float, ...]:
    """Principal moments along turned axes as those along the axes of the body."""
    if not np.any(moments):
        return (0, 0, 0)
    if np.array_equal(orientation(rotation), (0, 0, 0)):
        return np.array(moments)
    matrix = rotation @ np.diag(moments) @ rotation.T
    return matrix[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


class _End(NamedTuple):
    """A frame that an equation binds: of a body, in whose frame it has a position and a rotation."""

    body: int
    position: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]


class Equalities(NamedTuple):
    """Equations that a robot holds, by name, and notes on the others."""

    loops: dict[str, Closure]
    couplings: dict[str, Coupling]
    notes: tuple[str, ...]


def are_held(model: Model) -> Bool[np.ndarray, " equations"]:
    """Which equations of a model, active or not, a robot can hold.

    A weld of a loop in one plane would say three things twice, and so leave its forces undetermined.
    """
    data = _at_reference(model)
    return np.array(
        [
            kind in (_CONNECT, _JOINT) or (kind == _WELD and _plane(model, data, _ends(model, index)) is None)
            for index, kind in enumerate(model.eq_type)
        ],
        dtype=bool,
    )


def equalities_of(path: str | Path, model: Model, joints: Mapping[int, str]) -> Equalities:
    """The active equations of a model whose joints have these names.

    Raises `ProblemError` for one that cannot hold, because nothing between its bodies moves as it would have to.
    """
    data = _at_reference(model)
    loops: dict[str, Closure] = {}
    couplings: dict[str, Coupling] = {}
    notes: list[str] = []
    for index in np.flatnonzero(model.eq_active0).tolist():
        name = model.equality(index).name or f"equality_{index}"
        if model.eq_type[index] == _JOINT:
            couplings[name] = _coupling(model, name, index, joints)
            continue
        ends = _ends(model, index)
        if not list(_between(model, ends)):
            _refuse_apart(path, name, data, ends, np.eye(3))
            notes.append(f"Equality '{name}' says nothing: its bodies do not move against one another.")
            continue
        axis = _plane(model, data, ends)
        if axis is not None:
            _refuse_apart(path, name, data, ends, axis[:, None])
        loops[name] = _closure(model, data, name, model.eq_type[index] == _WELD, ends, axis)
    if loops or couplings:
        notes.append(f"Equations hold exactly, where MuJoCo yields: {', '.join([*loops, *couplings])}.")
    if len(asleep := np.flatnonzero(model.eq_active0 == 0)):
        notes.append(f"Equations that are not active at the start are not read ({len(asleep)}).")
    return Equalities(loops, couplings, tuple(notes))


def _coupling(model: Model, name: str, index: int, joints: Mapping[int, str]) -> Coupling:
    follower, leader = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    rest = [known(float(model.qpos0[model.jnt_qposadr[joint]])) if joint >= 0 else 0 for joint in (follower, leader)]
    coefficients = tuple(model.eq_data[index, :5].tolist())
    return Coupling(
        name,
        follower=joints[follower],
        leader=joints[leader] if leader >= 0 else None,
        coefficients=coefficients,
        rest=rest[0],
        leader_rest=rest[1],
    )


def _closure(
    model: Model, data: Posture, name: str, is_weld: bool, ends: tuple[_End, _End], axis: Float[np.ndarray, "3"] | None
) -> Closure:
    outer, inner = ends
    joint: Any = Fixed() if is_weld else Ball()
    if axis is not None:
        joint = Revolute(_named(_rotation_of_body(data, outer.body).T @ axis))
    return Closure(
        name,
        parent=link_name(model, outer.body) if outer.body else None,
        child=link_name(model, inner.body) if inner.body else None,
        joint=joint,
        position=geometry(outer.position),
        child_position=geometry(inner.position),
        orientation=orientation(outer.rotation) if is_weld else (0, 0, 0),
        child_orientation=orientation(inner.rotation) if is_weld else (0, 0, 0),
        planar=axis is not None,
    )


def _ends(model: Model, index: int) -> tuple[_End, _End]:
    """What an equation binds, as MuJoCo's engine takes its numbers."""
    first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    if model.eq_objtype[index] == library().mjtObj.mjOBJ_SITE:
        return _of_site(model, first), _of_site(model, second)
    numbers, straight = model.eq_data[index], np.eye(3)
    if model.eq_type[index] == _WELD:
        return _End(first, numbers[3:6], rotation_of(numbers[6:10])), _End(second, numbers[:3], straight)
    return _End(first, numbers[:3], straight), _End(second, numbers[3:6], straight)


def _of_site(model: Model, site: int) -> _End:
    return _End(int(model.site_bodyid[site]), model.site_pos[site], rotation_of(model.site_quat[site]))


def _between(model: Model, ends: tuple[_End, _End]) -> Iterator[int]:
    """The joints by which two bodies move against one another."""
    chains = [set(_upwards(model, end.body)) for end in ends]
    for body in sorted(chains[0] ^ chains[1]):
        yield from range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])


def _upwards(model: Model, body: int) -> Iterator[int]:
    while body:
        yield body
        body = int(model.body_parentid[body])


def _plane(model: Model, data: Posture, ends: tuple[_End, _End]) -> Float[np.ndarray, "3"] | None:
    """The direction, in the world's axes, across a plane to which the joints between two bodies confine them."""
    joints = list(_between(model, ends))
    hinges = [joint for joint in joints if model.jnt_type[joint] == _HINGE]
    if not hinges or any(model.jnt_type[joint] not in (_SLIDE, _HINGE) for joint in joints):
        return None
    axis = data.xaxis[hinges[0]]
    for joint in joints:
        across = data.xaxis[joint] @ axis if model.jnt_type[joint] == _SLIDE else np.cross(data.xaxis[joint], axis)
        if np.max(np.abs(across)) > _SAME:
            return None
    return axis


def _refuse_apart(
    path: str | Path, name: str, data: Posture, ends: tuple[_End, _End], fixed: Float[np.ndarray, "3 n"]
) -> None:
    """Raise `ProblemError` for points that stay apart along `fixed` directions, in which nothing moves them."""
    outer, inner = (data.xpos[end.body] + _rotation_of_body(data, end.body) @ end.position for end in ends)
    if (distance := float(np.linalg.norm((inner - outer) @ fixed))) > _SAME:
        raise broken(
            path,
            f"equality '{name}'",
            f"expected points that its joints can bring together; received two that stay {distance:.3g} m apart.",
        )


def _rotation_of_body(data: Posture, body: int) -> Float[np.ndarray, "3 3"]:
    return data.xmat[body].reshape(3, 3)


def _at_reference(model: Model) -> Posture:
    """What MuJoCo makes of a model in its reference posture."""
    data = library().MjData(model)
    library().mj_kinematics(model, data)
    return data


def _named(axis: Float[np.ndarray, "3"]) -> Any:
    """An axis of coordinates by its name, whatever its sense, and any other one as numbers."""
    along = int(np.argmax(np.abs(axis)))
    return "xyz"[along] if abs(axis[along]) > 1 - _SAME else geometry(axis)
