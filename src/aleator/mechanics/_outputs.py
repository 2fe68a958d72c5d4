"""The standard outputs of every mechanical system, named after its coordinates, velocities and actuators."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

from jaxtyping import Array

from aleator._core.errors import ProblemError
from aleator.mechanics._mechanical import AbstractMechanical
from aleator.mechanics._motion import Motion


def standard_outputs(model: AbstractMechanical, motion: Motion, torque_rate: Array | None) -> dict[str, Any]:
    """Coordinates, rates, accelerations, torques and their rates by name, and the model's own outputs.

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
