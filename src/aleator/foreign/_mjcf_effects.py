"""What a compiled MuJoCo model does beside moving a tree of bodies."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Bool

from aleator.foreign._mjcf_specification import library
from aleator.foreign._mjcf_types import Model


def is_disabled(model: Model, flag: str) -> bool:
    """Whether a file switches an effect off: "SPRING", "DAMPER", "GRAVITY" and others of `mjtDisableBit`."""
    return bool(model.opt.disableflags & getattr(library().mjtDisableBit, f"mjDSBL_{flag}"))


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
    return np.logical_or.reduce([(one != 0).any(axis=tuple(range(1, one.ndim))) for one in values]) if values else False


def _joints(model: Model, joints: Iterable[Any]) -> list[str]:
    return [_said("joint", model.joint(int(joint)).name, joint) for joint in joints]


def _named(model: Model, kind: str, is_found: Any) -> list[str]:
    return [_said(kind, getattr(model, kind)(int(i)).name, i) for i in np.flatnonzero(is_found)]


def _said(kind: str, name: str, number: Any) -> str:
    return f"{kind} '{name}'" if name else f"{kind} {int(number)} (without a name)"
