"""From coordinates to generalised velocities and back (equations 4 and 65-67)."""

from typing import Any, NamedTuple

import jax
from jaxtyping import Array, Float

from aleator.mechanics._instant import along_time
from aleator.mechanics._matrices import solve_any
from aleator.mechanics._mechanical import AbstractMechanical, rate_map


class Followed(NamedTuple):
    """A prescribed motion at one instant: coordinates, velocities and their rates."""

    q: Float[Array, " coordinates"]
    q_dot: Float[Array, " coordinates"]
    q_ddot: Float[Array, " coordinates"]
    v: Float[Array, " speeds"]
    v_dot: Float[Array, " speeds"]


def rates(model: AbstractMechanical, q: Array, v: Array) -> Float[Array, " coordinates"]:
    """`q̇ = H(q) v`, equation (4)."""
    return v if model.moves_directly else rate_map(model, q) @ v


def accelerations(model: AbstractMechanical, q: Array, v: Array, v_dot: Array) -> Float[Array, " coordinates"]:
    """`q̈ = H v̇ + Ḣ v`, equation (65), with the total derivative `Ḣ` along the motion as a directional derivative."""
    if model.moves_directly:
        return v_dot
    return along_time(rates, model, (q, v), (rates(model, q, v), v_dot))[1]


def follow(model: AbstractMechanical, position: Array, velocity: Array, acceleration: Array) -> Followed:
    """The motion prescribed by a curve of coordinates, equations (66) and (67)."""
    q, q_dot, q_ddot = on_manifold(model, position, velocity, acceleration)
    if model.moves_directly:
        return Followed(q, q_dot, q_ddot, q_dot, q_ddot)
    H = rate_map(model, q)
    v = solve_any(H, q_dot)
    change = along_time(lambda now, at: rate_map(now, at) @ v, model, (q,), (q_dot,))[1]
    return Followed(q, q_dot, q_ddot, v, solve_any(H, q_ddot - change))


def on_manifold(model: AbstractMechanical, position: Array, velocity: Array, acceleration: Array) -> Any:
    """The curve projected to valid coordinates (unit quaternions), with its time derivatives."""
    if model.moves_directly:
        return position, velocity, acceleration

    def first(at: Array, along: Array) -> tuple[Array, Array]:
        return jax.jvp(model.normalised, (at,), (along,))

    (q, q_dot), (_, q_ddot) = jax.jvp(first, (position, velocity), (velocity, acceleration))
    return q, q_dot, q_ddot
