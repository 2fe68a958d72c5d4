"""The outputs of a mechanical system's motion, by name."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from aleator._core.errors import ProblemError
from aleator.mechanics._matrices import entries
from aleator.mechanics._mechanical import AbstractMechanical, Motion, accelerations
from aleator.mechanics._partial import Solved

# Outputs that are known even where they say that others are not.
_AMOUNTS = {"constraint_drift": "drift", "motion_error": "motion_error", "torque_shortfall": "shortfall"}


def outputs_of(model: AbstractMechanical, t: Any, solved: Solved, torque_rate: Array | None) -> dict[str, Any]:
    """Coordinates, rates, accelerations, torques and their rates by name, and the model's own outputs.

    Not a number where constraints or prescribed rates were not obeyed, except for how far they were missed.

    Raises `ProblemError` where two of them have the same name, or one of the model's own has a name already taken.
    """
    if solved.valid is not None:
        beside = {name: getattr(solved, name) for name in _AMOUNTS.values()}
        solved = jax.tree.map(lambda part: jnp.where(solved.valid, part, jnp.nan), solved)._replace(**beside)
    q, q_dot, v, v_dot, torque = solved[:5]
    q_ddot = accelerations(model, q, v, v_dot) if solved.q_ddot is None else solved.q_ddot
    motion = Motion(t, q, q_dot, q_ddot, v, v_dot, torque)
    if model.constraints:
        motion = motion._replace(multipliers=solved.multipliers)
    own = model.seen_at(q).outputs(motion)
    if solved.valid is not None:
        own = jax.tree.map(lambda part: jnp.where(solved.valid, part, jnp.nan), own)
    return _named(model, _standard(model, motion, torque_rate, solved) + _missed(solved), own)


def _standard(
    model: AbstractMechanical, motion: Motion, torque_rate: Array | None, solved: Solved
) -> list[tuple[str, Any]]:
    listed: list[tuple[str, Any]] = []
    for name, *along in zip(model.coordinates, *map(entries, (motion.q, motion.q_dot, motion.q_ddot)), strict=True):
        listed += zip((name, f"{name}_rate", f"{name}_acceleration"), along, strict=True)
    coordinate_rates = {f"{name}_rate" for name in model.coordinates}
    for name, *along in zip(model.speeds, entries(motion.v), entries(motion.v_dot), strict=True):
        listed += zip((name, f"{name}_rate"), along, strict=True) if name not in coordinate_rates else ()
    listed += zip(model.actuators, entries(motion.torque), strict=True)
    if torque_rate is not None:
        listed += zip((f"{name}_rate" for name in model.actuators), entries(torque_rate), strict=True)
    if model.constraints:
        missed = {"constraint_error": solved.constraint, "constraint_rate_error": solved.constraint_rate}
        listed += [(name, jnp.abs(one).max(initial=0.0)) for name, one in missed.items()]
        listed += zip((f"{name}_multiplier" for name in model.constraints), entries(motion.multipliers), strict=True)
        listed += zip(
            (f"{name.removesuffix('_rate')}_reaction" for name in model.speeds), entries(solved.reactions), strict=True
        )
    return listed


def _missed(solved: Solved) -> list[tuple[str, Any]]:
    amounts = ((name, getattr(solved, part)) for name, part in _AMOUNTS.items())
    return [(name, amount) for name, amount in amounts if amount is not None]


def _named(model: AbstractMechanical, listed: list[tuple[str, Any]], own: Any) -> dict[str, Any]:
    """Standard outputs and the model's own."""
    standard = dict(listed)
    if twice := sorted(name for name, count in Counter(name for name, _ in listed).items() if count > 1):
        raise ProblemError(
            f"{type(model).__name__}: {twice} name two outputs each; rename its coordinates, velocities or actuators."
        )
    if not isinstance(own, Mapping):
        raise ProblemError(
            f"{type(model).__name__}.outputs returns a dict of arrays by name; received {type(own).__name__}."
        )
    if taken := sorted(set(standard) & set(own)):
        raise ProblemError(
            f"{type(model).__name__}.outputs: {taken} are standard outputs of every mechanical system; rename yours."
        )
    return {**standard, **own}
