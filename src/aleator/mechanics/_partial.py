"""Dynamics with some coordinates prescribed: the others' accelerations, torques and multipliers together.

Equations (70) and (71), and with constraints the saddle-point form of equation (6) for what is not prescribed.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator.mechanics._constraints import Bound, Loose, Saddle, put_back
from aleator.mechanics._instant import along_time
from aleator.mechanics._matrices import block, merged, product, solve_any, taken
from aleator.mechanics._mechanical import (
    AbstractMechanical,
    actuation_map,
    bias_of,
    jacobian_of,
    load_on,
    mass_of,
    on_manifold,
    rate_map,
    rates,
)


class Prescribed(NamedTuple):
    """The prescribed motion and the known torques at one instant (or their rates)."""

    position: Array
    velocity: Array
    acceleration: Array
    known: Array


class Solved(NamedTuple):
    """The complete motion at one instant, and whether its constraints could be satisfied."""

    q: Array
    v: Array
    v_dot: Array
    torque: Array
    multipliers: Array
    obeyed: Any
    bound: Bound


class Partition(NamedTuple):
    """The places of prescribed coordinates, of the velocities that these drive, and of known torques; of how many."""

    prescribed: tuple[int, ...]
    driven: tuple[int, ...]
    known: tuple[int, ...]
    coordinates: int
    speeds: int
    actuators: int

    @classmethod
    def of(
        cls, model: AbstractMechanical, prescribed: tuple[int, ...], driven: tuple[int, ...], known: tuple[int, ...]
    ) -> "Partition":
        """The partition of a model's coordinates, velocities and torques."""
        return cls(prescribed, driven, known, len(model.coordinates), len(model.speeds), len(model.actuators))

    @property
    def others(self) -> tuple[int, ...]:
        """The places of coordinates that are not prescribed."""
        return _without(self.prescribed, self.coordinates)

    @property
    def undriven(self) -> tuple[int, ...]:
        """The places of the other velocities."""
        return _without(self.driven, self.speeds)

    @property
    def unknown(self) -> tuple[int, ...]:
        """The places of torques to find."""
        return _without(self.known, self.actuators)

    @property
    def loose(self) -> Loose:
        """What follows constraints, if there are any."""
        return Loose(self.others, self.undriven)

    def merged(self, prescribed: Array, others: Array) -> Float[Array, " coordinates"]:
        """Coordinates in their order."""
        return merged(prescribed, self.prescribed, others, self.others)

    def joined(self, driven: Array, others: Array) -> Float[Array, " speeds"]:
        """Velocities in their order."""
        return merged(driven, self.driven, others, self.undriven)

    def applied(self, unknown: Array, known: Array) -> Float[Array, " actuators"]:
        """Torques in their order."""
        return merged(unknown, self.unknown, known, self.known)


def _without(places: tuple[int, ...], count: int) -> tuple[int, ...]:
    return tuple(i for i in range(count) if i not in places)


def solved(model: AbstractMechanical, parts: Partition, given: Prescribed, q_u: Array, v_u: Array) -> Solved:
    """Coordinates, velocities, accelerations and torques, from what is given and what is integrated."""
    a, u, free = parts.driven, parts.undriven, parts.unknown
    q_u, obeyed = _put_back(model, parts, given, q_u)
    q, v_a, v_dot_a = prescribed_velocities(model, parts, given, q_u, v_u)
    M, B = mass_of(model, q), actuation_map(model, q)
    bound = Bound(model, q)
    G_a, G_u = (taken(bound.G.T, some).T for some in (a, u))
    saddle = Saddle(block(M, u, u), G_u)
    # By the least kinetic energy of a change of what is not prescribed.
    v = parts.joined(v_a, v_u)
    if model.constraints:
        v = parts.joined(v_a, v_u - saddle.least(bound.rate(v)))
    rest = bias_of(model, q, v) - load_on(model, q, v) - product(taken(B.T, parts.known).T, given.known)
    M_ua, B_a, B_u = block(M, u, a), block(B, a, free), block(B, u, free)
    rest_a, rest_u = taken(rest, a), taken(rest, u)
    # The other accelerations and the multipliers: with no unknown torque, and for each of these.
    force = jnp.concatenate([-(rest_u + product(M_ua, v_dot_a))[:, None], B_u], axis=1)
    gammas = jnp.concatenate(
        [(bound.acceleration(v) - product(G_a, v_dot_a))[:, None], jnp.zeros((len(G_a), len(free)))], axis=1
    )
    moved, borne = saddle.solve(force, gammas)
    needed = product(block(M, a, a), v_dot_a) + rest_a + product(M_ua.T, moved[:, 0]) + product(G_a.T, borne[:, 0])
    torque = solve_any(B_a - product(M_ua.T, moved[:, 1:]) - product(G_a.T, borne[:, 1:]), needed)
    v_dot = parts.joined(v_dot_a, moved[:, 0] + product(moved[:, 1:], torque))
    multipliers = borne[:, 0] + product(borne[:, 1:], torque)
    return Solved(q, v, v_dot, parts.applied(torque, given.known), multipliers, obeyed, bound)


def effect_of_torques(
    model: AbstractMechanical, parts: Partition, q: Float[Array, " coordinates"]
) -> Float[Array, "driven unknown"]:
    """How the torques to find act along the prescribed velocities, the others moving as they must."""
    M, B, G = mass_of(model, q), actuation_map(model, q), jacobian_of(model, q)
    a, u, free = parts.driven, parts.undriven, parts.unknown
    G_a, G_u = (taken(G.T, some).T for some in (a, u))
    moved, borne = Saddle(block(M, u, u), G_u).solve(block(B, u, free), jnp.zeros((len(G), len(free))))
    return block(B, a, free) - product(block(M, a, u), moved) - product(G_a.T, borne)


def prescribed_velocities(
    model: AbstractMechanical, parts: Partition, given: Prescribed, q_u: Array, v_u: Array
) -> tuple[Array, Array, Array]:
    """Equations (66) and (67) for the prescribed coordinates alone, whose rates no other velocity enters."""
    if model.moves_directly:
        return parts.merged(given.position, q_u), given.velocity, given.acceleration

    def own(now: AbstractMechanical, where: Array) -> Array:
        return block(rate_map(now, where), parts.prescribed, parts.driven)

    still, a = jnp.zeros_like(q_u), parts.prescribed
    curve = (parts.merged(given.position, q_u), *(parts.merged(one, still) for one in given[1:3]))
    q, rate, acceleration = on_manifold(model, *curve)
    v_a = solve_any(own(model, q), taken(rate, a))
    q_dot = rates(model, q, parts.joined(v_a, v_u))
    change = along_time(lambda *now: own(*now) @ v_a, model, (q,), (q_dot,))[1]
    return q, v_a, solve_any(own(model, q), taken(acceleration, a) - change)


def _put_back(model: AbstractMechanical, parts: Partition, given: Prescribed, q_u: Array) -> tuple[Array, Any]:
    """The integrated coordinates on the constraints, and whether they could be put there."""
    if not model.constraints:
        return q_u, True
    q, obeyed = put_back(model, parts.merged(given.position, q_u), parts.loose)
    return taken(q, parts.others), obeyed
