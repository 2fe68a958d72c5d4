"""From coordinates to generalised velocities and back (equations 4 and 65-67), and from torques to their forces."""

from enum import Enum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.border import one_of, real_array, refusal
from aleator.mechanics._instant import along_time
from aleator.mechanics._matrices import solve_any
from aleator.mechanics._mechanical import AbstractMechanical, actuation_map, jacobian_of, rate_map
from aleator.mechanics._spatial import Numbers


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


class Actuation(Enum):
    """The actuation schemes of figure 2.2."""

    PASSIVE = "passive"
    FULL = "fully actuated"
    UNDER = "under-actuated"
    OVER = "over-actuated"
    UNDER_OVER = "under-over-actuated"


def actuation_of(model: AbstractMechanical, q: Float[Array, " coordinates"]) -> Actuation:
    """The actuation scheme of a realised system in a posture, from the rank of `B(q)` and the number of torques.

    For a system with constraints, `B` is taken on the motions that these leave free, in a posture that satisfies them.
    """
    one_of("actuation_of", model, AbstractMechanical, "an al.Multibody")
    posture = real_array("actuation_of: q", q)
    if posture.shape != (len(model.coordinates),) or not np.isfinite(posture).all():
        raise refusal("actuation_of: q", f"finite numbers for {list(model.coordinates)}", q)
    q = jnp.asarray(posture)
    B = np.asarray(actuation_map(model, q))
    if model.constraints:
        G = np.asarray(jacobian_of(model, q))
        B = np.linalg.svd(G)[2][len(G) :] @ B
    return scheme(B)


def scheme(B: Float[np.ndarray, "speeds actuators"]) -> Actuation:
    """The scheme of an actuation map."""
    rank = int(np.linalg.matrix_rank(B)) if B.size else 0
    speeds, actuators = B.shape
    if rank == 0:
        return Actuation.PASSIVE
    if rank == speeds:
        return Actuation.FULL if actuators == speeds else Actuation.OVER
    return Actuation.UNDER if actuators == rank else Actuation.UNDER_OVER


def torques(
    model: AbstractMechanical, q: Float[Numbers, " coordinates"], force: Float[Array, " speeds"]
) -> Float[Array, " actuators"]:
    """The torques that produce a generalised force; those of least norm where there are many."""
    if model.acts_directly:
        return force
    return solve_any(actuation_map(model, q), force)
