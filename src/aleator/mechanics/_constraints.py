"""Holonomic constraints `g(q, t) = 0` at one instant: their derivatives, and accelerations and multipliers together.

The index is reduced by two differentiations (dissertation, equation 6). What integration then loses of the constraints
themselves is put back wherever the equations are evaluated, so that no gain is to be chosen: the motion obeys them at
all times, whatever carries it forward, and an integrator keeps its order.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from aleator.mechanics._instant import along_time
from aleator.mechanics._kinematics import rates
from aleator.mechanics._matrices import solve_any, solve_positive
from aleator.mechanics._mechanical import AbstractMechanical, constraint_of, jacobian_of, rate_map

# Corrections of the coordinates with one Jacobian: each multiplies what is missing by what was missing at first.
_CORRECTIONS = 3

# A last correction longer than this, beside one and the coordinates, does not converge.
_CLOSE = 1e-7


class Loose(NamedTuple):
    """The places of coordinates and velocities that are not prescribed, and follow the constraints."""

    coordinates: tuple[int, ...]
    speeds: tuple[int, ...]


def all_loose(model: AbstractMechanical) -> Loose:
    """All coordinates and velocities of a model."""
    return Loose(tuple(range(len(model.coordinates))), tuple(range(len(model.speeds))))


def constraint_rate(model: AbstractMechanical, q: Array, v: Array) -> Float[Array, " constraints"]:
    """`ġ = G v + ∂g/∂t`."""
    if model._when is not None:
        return along_time(constraint_of, model, (q,), (rates(model, q, v),))[1]
    return jacobian_of(model, q) @ v


def constrained_acceleration(model: AbstractMechanical, q: Array, v: Array) -> Float[Array, " constraints"]:
    """`γ` of `G v̇ = γ`: `-(Φ_q q̇)_q q̇ - 2 Φ_qt q̇ - Φ_tt`, equation (6)."""
    return -along_time(lambda now, at: constraint_rate(now, at, v), model, (q,), (rates(model, q, v),))[1]


def saddle(
    M: Float[Array, "n n"], G: Float[Array, "m n"], force: Float[Array, "n ..."], gamma: Float[Array, "m ..."]
) -> tuple[Float[Array, "n ..."], Float[Array, "m ..."]]:
    """Solve `[M Gᵀ; G 0] [x; λ] = [force; gamma]`, equation (6); not a number where that is singular.

    As many constraints as unknowns determine these whatever `M` is.
    """
    rows, columns = G.shape
    if rows == 0:
        return solve_positive(M, force), gamma
    if rows == columns:
        x = jnp.linalg.solve(G, gamma)
        return x, jnp.linalg.solve(G.T, force - M @ x)
    along = solve_positive(M, G.T)
    free = solve_positive(M, force)
    multipliers = solve_positive(G @ along, G @ free - gamma)
    return free - along @ multipliers, multipliers


def put_back(
    model: AbstractMechanical, q: Float[Array, " coordinates"], loose: Loose
) -> tuple[Float[Array, " coordinates"], Bool[Array, ""]]:
    """Coordinates beside their constraints, put back onto them by those that are loose; and whether that succeeds.

    By a Newton method with the Jacobian of the given place, on the shortest way.
    """
    q, moving = model.normalised(q), np.array(loose.coordinates)
    G = jacobian_of(model, q)[:, np.array(loose.speeds)]
    H = None if model.moves_directly else rate_map(model, q)[moving][:, np.array(loose.speeds)]
    step = jnp.zeros(())
    for _ in range(_CORRECTIONS):
        along = solve_any(G, constraint_of(model, q))
        correction = along if H is None else H @ along
        q = q.at[moving].add(-correction)
        step = jnp.abs(correction).max()
    q = model.normalised(q)
    return q, step <= _CLOSE * (1 + jnp.abs(q).max())


def put_back_velocities(
    model: AbstractMechanical, q: Array, v: Array, M: Float[Array, "speeds speeds"], loose: Loose
) -> Float[Array, " speeds"]:
    """Velocities that the constraints allow, by the least kinetic energy of a change of those that are loose."""
    moving = np.array(loose.speeds)
    G, M = jacobian_of(model, q)[:, moving], M[moving][:, moving]
    change = saddle(M, G, jnp.zeros(len(M)), -constraint_rate(model, q, v))[0]
    return v.at[moving].add(change)


def reactions(
    model: AbstractMechanical, q: Array, multipliers: Float[Array, " constraints"]
) -> Float[Array, " speeds"]:
    """The generalised force of the constraints, `-Gᵀ λ`."""
    return -jacobian_of(model, q).T @ multipliers
