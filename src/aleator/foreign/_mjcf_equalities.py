"""Equations of a compiled MuJoCo model: `connect` and `weld` as closed loops, `joint` as coupled coordinates.

MuJoCo yields where its solver needs to (`solref`, `solimp`); here equations hold.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from aleator.foreign._couplings import Coupling
from aleator.foreign._mjcf_bodies import link_name, orientation, rotation_of
from aleator.foreign._mjcf_specification import library
from aleator.foreign._mjcf_types import Model, Posture
from aleator.foreign._robot import known
from aleator.foreign._xml import broken, geometry
from aleator.mechanics import Ball, Closure, Fixed, Revolute

_CONNECT, _WELD, _JOINT = range(3)
_SLIDE, _HINGE = 2, 3
# Directions and places that differ by less, relative to one or in m, are the same.
_SAME = 1e-9


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
            couplings[name] = _coupling(model, index, joints)
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


def _coupling(model: Model, index: int, joints: Mapping[int, str]) -> Coupling:
    follower, leader = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    rest = [known(float(model.qpos0[model.jnt_qposadr[joint]])) if joint >= 0 else 0 for joint in (follower, leader)]
    coefficients = tuple(model.eq_data[index, :5].tolist())
    return Coupling(joints[follower], joints[leader] if leader >= 0 else None, coefficients, *rest)


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
