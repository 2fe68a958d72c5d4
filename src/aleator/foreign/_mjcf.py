"""MJCF, the format of MuJoCo, read by MuJoCo itself.

Defaults, includes, frames, replicated bodies, units of angles, and inertia from shapes have rules that only MuJoCo
knows in full: what it compiles is what it simulates.
"""

import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from aleator._core.errors import ProblemError
from aleator.foreign._mjcf_bodies import (
    Model,
    bodies_of,
    equalities_of,
    is_disabled,
    joints_of,
    library,
    posture_of,
)
from aleator.foreign._robot import Robot, broken, checked_effects, refuse_effects, robot_of, root_of


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
    root_of("read_mjcf", path, "mujoco")
    model, flexes, unread = _compiled(path)
    joints = joints_of(model)
    equalities = equalities_of(path, model, joints, left_out="equality" in left_out)
    notes = refuse_effects(path, {**_effects(model, equalities.others), **flexes}, left_out)
    limits = dict(_limits(model, joints))
    return robot_of(
        path,
        bodies_of(model, joints),
        gravity=_gravity(model),
        limits=limits,
        posture=tuple(posture_of(model, joints).items()),
        loops=equalities.loops,
        couplings=equalities.couplings,
        notes=(*notes, *unread, *equalities.notes, *_notes(model, limits)),
    )


def _compiled(path: str | Path) -> tuple[Model, dict[str, list[str]], tuple[str, ...]]:
    """The compiled model; its deformable bodies, which were removed before, as an effect; and notes on what else was.

    Raises `ProblemError` for what MuJoCo refuses, for a model without bodies, and for inertia from a mesh.
    """
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            specification = library().MjSpec.from_file(str(path))
            flexes = {"flex": [f"flex '{flex.name}'" for flex in specification.flexes]}
            _delete(specification, specification.flexes)
            notes = tuple(_without_files(path, specification))
            # Bodies keep their names and places.
            specification.compiler.fusestatic = False
            model = specification.compile()
        except ProblemError:
            raise
        except ValueError as error:
            said = "; ".join(line.strip() for line in str(error).splitlines() if line.strip())
            raise broken(path, "", f"expected a model that MuJoCo accepts; received its refusal: {said}.") from error
    if model.nbody == 1:
        raise broken(path, "", "expected a model with a body; received none.")
    return model, flexes, (*notes, *(f"MuJoCo: {warning.message}." for warning in heard))


def _without_files(path: str | Path, specification: Any) -> Iterator[str]:
    """Remove what is read from further files: meshes, height fields, textures, skins, and what refers to them."""
    shapes = [geom for geom in specification.geoms if geom.meshname or geom.hfieldname]
    for geom in shapes:
        if _gives_inertia(specification, geom):
            raise broken(
                path,
                f"body '{geom.parent.name}'",
                f"expected its inertia in numbers; received a mesh ('{geom.meshname or geom.name}') to compute it "
                "from, which is not read. Give the body an <inertial> with pos, mass and fullinertia (MuJoCo writes "
                "the numbers that it computes itself by mj_saveLastXML).",
            )
    if shapes:
        yield f"Meshes and height fields are not read ({len(shapes)})."
        names = {geom.name for geom in shapes if geom.name}
        _delete(specification, [pair for pair in specification.pairs if {pair.geomname1, pair.geomname2} & names])
        _delete(specification, shapes)
    for owner in (*specification.geoms, *specification.sites, *specification.tendons):
        owner.material = ""
    for parts in ("sensors", "tuples", "skins", "meshes", "hfields", "materials", "textures"):
        _delete(specification, getattr(specification, parts))


def _gives_inertia(specification: Any, geom: Any) -> bool:
    """Whether the inertia of a moving body is computed from a shape."""
    kinds, moving = library().mjtInertiaFromGeom, geom.parent
    while moving is not None and moving.name != "world" and not len(moving.joints):
        moving = moving.parent
    # Bodies of an attached file keep its settings.
    settings = getattr(geom.parent, "compiler", specification.compiler)
    rule, (first, last) = settings.inertiafromgeom, settings.inertiagrouprange
    is_fixed = moving is None or moving.name == "world"
    if is_fixed or not first <= geom.group <= last or rule == kinds.mjINERTIAFROMGEOM_FALSE:
        return False
    if rule != kinds.mjINERTIAFROMGEOM_TRUE and geom.parent.explicitinertial:
        return False
    # A mass that is not given is NaN.
    return geom.mass != 0 and (geom.mass > 0 or geom.density > 0)


def _delete(specification: Any, parts: Collection[Any]) -> None:
    for part in list(parts):
        specification.delete(part)


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


def _effects(model: Model, equations: Sequence[int]) -> dict[str, list[str]]:
    """Effects for which a tree of bodies has no place, some equations among them, with the elements that have them."""
    found: dict[str, list[str]] = {}
    for effect, kind, fields, flags in _EFFECTS:
        # Fields that an older MuJoCo does not have are zero.
        present = [np.asarray(getattr(model, field)) for field in fields if hasattr(model, field)]
        rows = {int(row) for values in present for row in np.argwhere(values)[:, 0]}
        if fields[0].startswith("dof_"):
            rows = {int(model.dof_jntid[row]) for row in rows}
        if effect == "ball":
            rows = {row for row in rows if model.jnt_type[row] <= 1}
        found.setdefault(effect, []).extend([] if is_disabled(model, *flags) else _named(model, kind, sorted(rows)))
    # MuJoCo leaves out all passive forces if both are switched off.
    is_passive = not (is_disabled(model, "SPRING") and is_disabled(model, "DAMPER"))
    is_weighty, is_fluid = any(_gravity(model)), model.opt.density > 0 or model.opt.viscosity > 0
    return found | {
        "equality": _named(model, "equality", equations),
        "fluid": ["option"] if is_passive and is_fluid else [],
        "gravcomp": _named(model, "body", np.flatnonzero(model.body_gravcomp) if is_passive and is_weighty else []),
        "plugins": _named(model, "body", np.flatnonzero(model.body_plugin >= 0)),
    }


def _named(model: Model, kind: str, places: Iterable[Any]) -> list[str]:
    """The elements of a kind at some places."""
    names = [(int(i), getattr(model, kind)(int(i)).name) for i in places]
    return [f"{kind} '{name}'" if name else f"{kind} {i} (without a name)" for i, name in names]


def _gravity(model: Model) -> tuple[float, ...]:
    """Gravity, m/s²."""
    return (0.0, 0.0, 0.0) if is_disabled(model, "GRAVITY") else tuple(model.opt.gravity.tolist())


def _limits(model: Model, joints: Mapping[int, str]) -> Iterator[tuple[str, tuple[float, float]]]:
    for joint, name in joints.items():
        is_axial = model.jnt_type[joint] > 1
        if is_axial and model.jnt_limited[joint] and not is_disabled(model, "LIMIT"):
            yield name, tuple(model.jnt_range[joint].tolist())
        if is_axial and model.jnt_actfrclimited[joint]:
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
