"""The standard outputs of every mechanical system, named after its coordinates, velocities and actuators."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from aleator._core.errors import ProblemError
from aleator.mechanics._constraints import Bound
from aleator.mechanics._mechanical import AbstractMechanical, Motion, constraint_of


def standard_outputs(
    model: AbstractMechanical, motion: Motion, torque_rate: Array | None = None, bound: Bound | None = None
) -> dict[str, Any]:
    """Coordinates, rates, accelerations, torques and their rates by name, and the model's own outputs.

    `bound`: the constraints at this posture, if the model has any.

    Raises `ProblemError` where two of them have the same name, or one of the model's own has a name already taken.
    """
    listed: list[tuple[str, Any]] = []
    for i, name in enumerate(model.coordinates):
        along = (motion.q[i], motion.q_dot[i], motion.q_ddot[i])
        listed += zip((name, f"{name}_rate", f"{name}_acceleration"), along, strict=True)
    rates = {f"{name}_rate" for name in model.coordinates}
    for i, name in enumerate(model.speeds):
        if name not in rates:
            listed += [(name, motion.v[i]), (f"{name}_rate", motion.v_dot[i])]
    for i, name in enumerate(model.actuators):
        listed.append((name, motion.torque[i]))
        if torque_rate is not None:
            listed.append((f"{name}_rate", torque_rate[i]))
    if bound is not None and model.constraints:
        listed += _of_constraints(model, motion, bound)
    found = dict(listed)
    if len(found) < len(listed):
        twice = sorted(name for name, count in Counter(name for name, _ in listed).items() if count > 1)
        raise ProblemError(
            f"{type(model).__name__}: {twice} name two outputs each; rename its coordinates, velocities or actuators."
        )
    own = model.outputs(motion)
    if not isinstance(own, Mapping):
        raise ProblemError(
            f"{type(model).__name__}.outputs returns a dict of arrays by name; received {type(own).__name__}."
        )
    if taken := sorted(set(found) & set(own)):
        raise ProblemError(
            f"{type(model).__name__}.outputs: {taken} are standard outputs of every mechanical system; rename yours."
        )
    return {**found, **own}


def constrained_outputs(
    model: AbstractMechanical, found: dict[str, Any], integrated: Array, kept: Any
) -> dict[str, Any]:
    """The outputs of a system with constraints: not a number where these were not obeyed, and how far they had drifted.

    `integrated` are the coordinates before they were put back.
    """
    if not model.constraints:
        return found
    drift = {"constraint_drift": jnp.abs(constraint_of(model, model.normalised(integrated))).max()}
    return {name: jnp.where(kept, value, jnp.nan) for name, value in {**drift, **found}.items()}


def _of_constraints(model: AbstractMechanical, motion: Motion, bound: Bound) -> list[tuple[str, Any]]:
    listed: list[tuple[str, Any]] = [
        ("constraint_error", jnp.abs(constraint_of(model, motion.q)).max()),
        ("constraint_rate_error", jnp.abs(bound.rate(motion.v)).max()),
    ]
    listed += [(f"{name}_multiplier", value) for name, value in zip(model.constraints, motion.multipliers, strict=True)]
    forces = bound.reactions(motion.multipliers)
    return listed + [
        (f"{name.removesuffix('_rate')}_reaction", force) for name, force in zip(model.speeds, forces, strict=True)
    ]
