"""MJCF, the format of MuJoCo, read by MuJoCo itself.

Defaults, includes, frames, replicated bodies, units of angles, and inertia from shapes have rules that only MuJoCo
knows in full: what it compiles is what it simulates.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from aleator._core.errors import ProblemError
from aleator.foreign._mjcf_bodies import bodies_of, joints_of, posture_of
from aleator.foreign._mjcf_effects import effects_of, gravity_of, has_equations, is_disabled
from aleator.foreign._mjcf_equalities import Equalities, are_held, equalities_of
from aleator.foreign._mjcf_specification import compiled
from aleator.foreign._mjcf_types import Model
from aleator.foreign._robot import Robot, robot_of
from aleator.foreign._robot_effects import checked_effects, refuse_effects
from aleator.foreign._xml import broken, root_of


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
        posture=posture_of(model, joints),
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
