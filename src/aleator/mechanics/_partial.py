"""Dynamics with some coordinates prescribed: the others' accelerations, torques and multipliers together.

Equations (70) and (71), and with constraints the saddle-point form of equation (6) for what is not prescribed.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator.mechanics._constraints import (
    constrained_acceleration,
    jacobian_of,
    put_back,
    put_back_velocities,
    saddle,
)
from aleator.mechanics._instant import along_time
from aleator.mechanics._kinematics import on_manifold, rates
from aleator.mechanics._matrices import solve_any
from aleator.mechanics._mechanical import AbstractMechanical, actuation_map, bias_of, load_on, mass_of, rate_map
from aleator.mechanics._partition import Partition, Prescribed, Solved, block


def solved(model: AbstractMechanical, parts: Partition, given: Prescribed, q_u: Array, v_u: Array) -> Solved:
    """Coordinates, velocities, accelerations and torques, from what is given and what is integrated."""
    a, u, free = np.array(parts.driven), parts.undriven, parts.unknown
    q_u, kept = _put_back(model, parts, given, q_u)
    q, v_a, v_dot_a = prescribed_velocities(model, parts, given, q_u, v_u)
    M, B = mass_of(model, q), actuation_map(model, q)
    v, G, gamma = _on_constraints(model, parts, q, parts.joined(v_a, v_u), M)
    rest = bias_of(model, q, v) - load_on(model, q, v) - B[:, list(parts.known)] @ given.known
    M_ua, B_free = block(M, u, a), B[:, free]
    # The other accelerations and the multipliers: with no unknown torque, and for each of these.
    force = jnp.concatenate([-(rest[u] + M_ua @ v_dot_a)[:, None], B_free[u]], axis=1)
    gammas = jnp.concatenate([(gamma - G[:, a] @ v_dot_a)[:, None], jnp.zeros((len(G), len(free)))], axis=1)
    moved, borne = saddle(block(M, u, u), G[:, u], force, gammas)
    needed = block(M, a, a) @ v_dot_a + rest[a] + M_ua.T @ moved[:, 0] + G[:, a].T @ borne[:, 0]
    found = solve_any(B_free[a] - M_ua.T @ moved[:, 1:] - G[:, a].T @ borne[:, 1:], needed)
    v_dot = parts.joined(v_dot_a, moved[:, 0] + moved[:, 1:] @ found)
    multipliers = borne[:, 0] + borne[:, 1:] @ found
    return Solved(q, v, v_dot, parts.applied(found, given.known), multipliers, kept)


def effect_of_torques(
    model: AbstractMechanical, parts: Partition, q: Float[Array, " coordinates"]
) -> Float[Array, "driven unknown"]:
    """How the torques to find act along the prescribed velocities, the others moving as they must."""
    M, B, G = mass_of(model, q), actuation_map(model, q), jacobian_of(model, q)
    a, u, free = list(parts.driven), parts.undriven, parts.unknown
    moved, borne = saddle(block(M, u, u), G[:, u], block(B, u, free), jnp.zeros((len(G), len(free))))
    return block(B, a, free) - block(M, a, u) @ moved - G[:, a].T @ borne


def prescribed_velocities(
    model: AbstractMechanical, parts: Partition, given: Prescribed, q_u: Array, v_u: Array
) -> tuple[Array, Array, Array]:
    """Equations (66) and (67) for the prescribed coordinates alone, whose rates no other velocity enters."""
    if model.moves_directly:
        return parts.merged(given.position, q_u), given.velocity, given.acceleration

    def own(now: AbstractMechanical, where: Array) -> Array:
        return block(rate_map(now, where), parts.prescribed, parts.driven)

    still, a = jnp.zeros_like(q_u), np.array(parts.prescribed)
    curve = (parts.merged(given.position, q_u), *(parts.merged(one, still) for one in given[1:3]))
    q, rate, acceleration = on_manifold(model, *curve)
    v_a = solve_any(own(model, q), rate[a])
    q_dot = rates(model, q, parts.joined(v_a, v_u))
    change = along_time(lambda *now: own(*now) @ v_a, model, (q,), (q_dot,))[1]
    return q, v_a, solve_any(own(model, q), acceleration[a] - change)


def _put_back(model: AbstractMechanical, parts: Partition, given: Prescribed, q_u: Array) -> tuple[Array, Any]:
    """The integrated coordinates on the constraints, and whether they could be put there."""
    if not model.constraints:
        return q_u, True
    q, kept = put_back(model, parts.merged(given.position, q_u), parts.loose)
    return q[parts.others], kept


def _on_constraints(
    model: AbstractMechanical, parts: Partition, q: Array, v: Array, M: Array
) -> tuple[Array, Array, Array]:
    """Velocities on the constraints, their Jacobian `G`, and `γ`."""
    if not model.constraints:
        return v, jnp.zeros((0, len(v))), jnp.zeros(0)
    v = put_back_velocities(model, q, v, M, parts.loose)
    return v, jacobian_of(model, q), constrained_acceleration(model, q, v)
