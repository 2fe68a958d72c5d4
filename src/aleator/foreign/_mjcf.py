"""MJCF, the format of MuJoCo, read by MuJoCo itself.

Defaults, includes, frames, replicated bodies, units of angles, and inertia from shapes have rules that only MuJoCo
knows in full: what it compiles is what it simulates.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Bool

from aleator._core.errors import ProblemError
from aleator.foreign._mjcf_bodies import Equalities, are_held, bodies_of, equalities_of, joints_of, posture_of
from aleator.foreign._mjcf_model import Model, compiled, is_disabled
from aleator.foreign._robot import Robot, broken, checked_effects, refuse_effects, robot_of, root_of


def gravity_of(model: Model) -> tuple[float, ...]:
    """Gravity, m/s²."""
    return (0.0, 0.0, 0.0) if is_disabled(model, "GRAVITY") else tuple(model.opt.gravity.tolist())


def has_equations(model: Model) -> bool:
    """Whether a file's equations are switched on."""
    return not (is_disabled(model, "CONSTRAINT") or is_disabled(model, "EQUALITY"))


def effects_of(model: Model, unheld: Bool[np.ndarray, " equations"]) -> dict[str, list[str]]:
    """Effects for which a tree of bodies has no place, by name with the elements that have them.

    `unheld`: which of the equations, if they are active, are among them.
    """
    constrained = not is_disabled(model, "CONSTRAINT")
    springs, dampers = (not is_disabled(model, flag) for flag in ("SPRING", "DAMPER"))
    rubs = constrained and not is_disabled(model, "FRICTIONLOSS")
    # MuJoCo leaves out all passive forces if both are switched off.
    passive = springs or dampers
    quaternions = model.jnt_type <= 1
    loose = quaternions[model.dof_jntid]
    found = {
        "friction": [
            *_joints(model, model.dof_jntid[(model.dof_frictionloss != 0) & rubs]),
            *_named(model, "tendon", (model.tendon_frictionloss != 0) & rubs),
        ],
        "equality": _named(model, "equality", model.eq_active0.astype(bool) & has_equations(model) & unheld),
        "tendons": _named(
            model,
            "tendon",
            (_nonzero(model, "tendon_stiffness", "tendon_stiffnesspoly") & springs)
            | (_nonzero(model, "tendon_damping", "tendon_dampingpoly") & dampers)
            | _nonzero(model, "tendon_armature"),
        ),
        "ball": [
            *_joints(model, np.flatnonzero(quaternions & (model.jnt_stiffness != 0) & springs)),
            *_joints(model, model.dof_jntid[loose & (model.dof_damping != 0) & dampers]),
            *_joints(model, model.dof_jntid[loose & (model.dof_armature != 0)]),
        ],
        "polynomials": [
            *_joints(model, np.flatnonzero(_nonzero(model, "jnt_stiffnesspoly") & springs)),
            *_joints(model, model.dof_jntid[_nonzero(model, "dof_dampingpoly") & dampers]),
        ],
        "actuators": _named(
            model,
            "actuator",
            _nonzero(model, "actuator_armature")
            | (_nonzero(model, "actuator_damping", "actuator_dampingpoly") & dampers),
        ),
        "fluid": ["option"] if passive and (model.opt.density > 0 or model.opt.viscosity > 0) else [],
        "gravcomp": _named(model, "body", (model.body_gravcomp != 0) & passive & any(gravity_of(model))),
        "plugins": _named(model, "body", model.body_plugin >= 0),
    }
    return {name: list(dict.fromkeys(elements)) for name, elements in found.items() if elements}


def _nonzero(model: Model, *fields: str) -> Any:
    """Where one of some fields is not zero; fields that an older MuJoCo does not have are."""
    values = [np.asarray(getattr(model, field)) for field in fields if hasattr(model, field)]
    rows = [(value != 0).any(axis=tuple(range(1, value.ndim))) for value in values]
    return np.logical_or.reduce(rows) if rows else False


def _joints(model: Model, joints: Iterable[Any]) -> list[str]:
    return [_said("joint", model.joint(int(joint)).name, joint) for joint in joints]


def _named(model: Model, kind: str, is_found: Any) -> list[str]:
    return [_said(kind, getattr(model, kind)(int(i)).name, i) for i in np.flatnonzero(is_found)]


def _said(kind: str, name: str, number: Any) -> str:
    return f"{kind} '{name}'" if name else f"{kind} {int(number)} (without a name)"


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
    left_out = checked_effects("read_mjcf", leave_out)
    _refuse_nan(path, root_of("read_mjcf", path, "mujoco"))
    model, unread = compiled(path, left_out)
    unheld = ~are_held(model) | ("equality" in left_out)
    notes = refuse_effects(path, effects_of(model, unheld), left_out)
    joints = joints_of(model)
    is_bound = has_equations(model) and "equality" not in left_out
    equalities = equalities_of(path, model, joints) if is_bound else Equalities({}, {}, ())
    try:
        bodies = bodies_of(model, joints)
    except ProblemError as error:
        raise broken(path, "", str(error)) from error
    limits = dict(_limits(model, joints))
    return robot_of(
        path,
        bodies,
        gravity=gravity_of(model),
        limits=limits,
        posture=tuple(posture_of(model, joints).items()),
        loops=equalities.loops,
        couplings=equalities.couplings,
        notes=(*notes, *unread, *equalities.notes, *_notes(model, limits)),
    )


def _refuse_nan(path: str | Path, root: Element) -> None:
    """Raise `ProblemError` for numbers that are none, which MuJoCo replaces by its defaults."""
    for element in root.iter():
        for attribute, text in element.attrib.items():
            if attribute != "name" and "nan" in text.lower().split():
                where = f"{element.tag} '{element.get('name', '')}'"
                raise broken(path, where, f"expected numbers as {attribute}; received {text!r}.")


def _limits(model: Model, joints: Mapping[int, str]) -> Iterator[tuple[str, tuple[float, float]]]:
    for joint, name in joints.items():
        if np.isin(model.jnt_type[joint], (2, 3)):  # slides and hinges
            if model.jnt_limited[joint] and not is_disabled(model, "LIMIT"):
                yield name, tuple(model.jnt_range[joint].tolist())
            if model.jnt_actfrclimited[joint]:
                yield f"{name}_torque", tuple(model.jnt_actfrcrange[joint].tolist())


def _notes(model: Model, limits: Mapping[str, Any]) -> Iterator[str]:
    if limits:
        yield "Limits are in robot.limits; nothing enforces them."
    if model.nu:
        yield f"Actuators are not read ({model.nu}): each joint has a torque of its own."
    if model.ngeom:
        yield "There is no contact: bodies pass through one another."
    if model.ntendon:
        yield f"Tendons are not read, nor their limits ({model.ntendon})."
    if model.nmocap:
        yield f"Bodies that a program moves (mocap) are fixed to the ground ({model.nmocap})."
