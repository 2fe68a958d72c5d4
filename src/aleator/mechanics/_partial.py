"""The equations of motion where some coordinates are prescribed: accelerations, torques and multipliers together; and
the outputs of the motion, by name.

Equations (70) and (71), and with constraints the saddle-point form of equation (6) for what is not prescribed. Forward
dynamics prescribe nothing, inverse dynamics everything: these two take the short cuts of a model, if it has any.
"""

import functools
from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator.mechanics._constraints import Bound, Loose, Saddle, jacobian_of, put_back
from aleator.mechanics._instant import along_time
from aleator.mechanics._matrices import block, entries, merged, product, solve_any, spread, taken
from aleator.mechanics._mechanical import (
    AbstractMechanical,
    Motion,
    accelerations,
    constraint_of,
    driven,
    load_on,
    on_manifold,
    rates,
    required_force,
    value_of,
)
from aleator.mechanics._sharing import Shares, bounds_of, shared
from aleator.mechanics._spatial import Numbers

# Prescribed rates may differ from `H v` by so much, beside the rates, and beside the coordinates each second.
_RATE_ERROR, _STILL = 1e-6, 1e-9


class Prescribed(NamedTuple):
    """The prescribed motion and the known torques at one instant (or their rates)."""

    position: Array
    velocity: Array
    acceleration: Array
    known: Array


class Partition(NamedTuple):
    """The places of prescribed coordinates, of the velocities that these drive, and of known torques; of how many; and
    how many constraints there are.
    """

    prescribed: tuple[int, ...]
    driven: tuple[int, ...]
    known: tuple[int, ...]
    coordinates: int
    speeds: int
    actuators: int
    constraints: int

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

    @property
    def surplus(self) -> int:
        """How many constraints the prescribed motion must obey by itself, for the others follow from the rest."""
        return max(self.constraints - len(self.undriven), 0)

    def may_miss(self, model: AbstractMechanical) -> bool:
        """Whether rates may miss what they must obey: those prescribed `H v` of the velocities that they drive, all of
        them velocity constraints.
        """
        return bool(model.velocity_constraint_names) or self.may_slip(model)

    def may_slip(self, model: AbstractMechanical) -> bool:
        """Whether prescribed rates may differ from `H v` of the velocities that they drive."""
        square = len(self.prescribed) == len(self.driven) and not self.undriven
        return bool(self.prescribed) and not (model.moves_directly or square)

    def merged(self, prescribed: Numbers, others: Array) -> Float[Numbers, " coordinates"]:
        """Coordinates in their order."""
        return _merged(prescribed, self.prescribed, others, self.others)

    def joined(self, driven: Array, others: Array) -> Float[Array, " speeds"]:
        """Velocities in their order."""
        return _merged(driven, self.driven, others, self.undriven)


def _without(places: tuple[int, ...], count: int) -> tuple[int, ...]:
    return tuple(i for i in range(count) if i not in places)


def _merged(first: Any, places: tuple[int, ...], second: Any, others: tuple[int, ...]) -> Any:
    if not places or not others:
        return second if others else first
    return merged(first, places, second, others)


class Solved(NamedTuple):
    """The complete motion at one instant.

    - `q_ddot`: `None` where it follows from `v_dot`;
    - `multipliers`, `reactions`, `constraint`, `constraint_rate`, `drift`: of constraints; `drift` is how far the
      coordinates had been from them before they were put back;
    - `motion_error`: how far rates are from `H v` and from what velocity constraints ask; `shortfall`: how much of a
      force the torques cannot make within their bounds; `None` where there is nothing to check;
    - `valid`: whether all of these could be obeyed; `None` where they always are.
    """

    q: Array
    q_dot: Array
    v: Array
    v_dot: Array
    torque: Array
    q_ddot: Any = None
    multipliers: Any = None
    reactions: Any = None
    constraint: Any = None
    constraint_rate: Any = None
    drift: Any = None
    motion_error: Any = None
    shortfall: Any = None
    valid: Any = None

    def checked(self, error: tuple[Any, Any], shares: Shares) -> "Solved":
        """The same with a `motion_error` and a `shortfall`, only valid where both are rounding."""
        flags = [flag for flag in (self.valid, error[1], shares.valid) if flag is not None]
        valid = functools.reduce(jnp.logical_and, flags) if flags else None
        return self._replace(motion_error=error[0], shortfall=shares.shortfall, valid=valid)


def solved(model: AbstractMechanical, parts: Partition, given: Prescribed, q_u: Array, v_u: Array) -> Solved:
    """The motion and the torques, from what is given and what is integrated."""
    if model.constraints or (parts.driven and (parts.undriven or parts.known)):
        return _partly_prescribed(model, parts, given, q_u, v_u)
    if parts.driven:
        path = follow(model, parts, given, q_u, v_u)
        force, bounds = required_force(model, path.q, path.v, path.v_dot), bounds_of(model, path.q, path.v)
        if model.acts_directly and bounds is None:
            found = Shares(force)
        else:
            found = shared(value_of(model, "actuation", path.q), force, bounds)
        motion = Solved(path.q, path.q_dot, path.v, path.v_dot, found.torque, path.q_ddot)
        return motion.checked(motion_error(model, parts, path.q, path.q_dot, path.v), found)
    q = model.normalised(q_u)
    return Solved(
        q, rates(model, q, v_u), v_u, driven(model, q, v_u, _known_force(model, parts, q, given)), given.known
    )


def motion_error(model: AbstractMechanical, parts: Partition, q: Array, rate: Array, v: Array) -> tuple[Any, Any]:
    """How far rates of prescribed coordinates are from `H v`, and all velocities from what velocity constraints ask;
    and whether that is rounding. `None` twice if they never are.

    `rate` are those of all coordinates, of which the prescribed ones count.
    """
    if not parts.may_miss(model):
        return None, None
    apart, sizes = list[Array](), list[Array]()
    if parts.may_slip(model):
        apart.append(taken(rate - rates(model, q, v), parts.prescribed))
        sizes.append(taken(rate, parts.prescribed))
    if model.velocity_constraint_names:
        apart.append(value_of(model, "velocity_constraint", q, v))
        sizes.append(v)
    amount, size = (jnp.abs(jnp.concatenate(both)).max() for both in (apart, sizes))
    return amount, amount <= _RATE_ERROR * size + _STILL * jnp.abs(q).max()


def _partly_prescribed(
    model: AbstractMechanical, parts: Partition, given: Prescribed, q_u: Array, v_u: Array
) -> Solved:
    a, u, free = parts.driven, parts.undriven, parts.unknown
    drift = valid = None
    if model.holonomic:
        integrated = parts.merged(given.position, q_u)
        q, valid, drift = put_back(model, integrated, parts.loose)
        q_u = taken(q, parts.others)
    q, rate, _, v_a, v_dot_a = follow(model, parts, given, q_u, v_u)
    model = model.seen_at(q)
    M, bound = value_of(model, "mass_matrix", q), Bound(model, q)
    G_a, G_u = (columns(bound.G, some) for some in (a, u))
    saddle = Saddle(block(M, u, u), G_u)
    # By the least kinetic energy of a change of what is not prescribed.
    v = parts.joined(v_a, v_u)
    if model.constraints:
        v = parts.joined(v_a, v_u - saddle.least(bound.rate(v)))
    rest = value_of(model, "bias", q, v) - load_on(model, q, v) - _known_force(model, parts, q, given)
    force, gamma, found = -taken(rest, u), bound.acceleration(v), Shares(given.known)
    if not a:
        v_dot, multipliers = saddle.solve(force, gamma)
    elif parts.surplus:
        v_dot = parts.joined(v_dot_a, saddle.least(gamma - product(G_a, v_dot_a)))
        B, needed = columns(value_of(model, "actuation", q), free), product(M, v_dot) + rest
        found = shared(B, needed, bounds_of(model, q, v, free), bound.G)
        multipliers = solve_any(bound.G.T, product(B, found.torque) - needed)
    else:
        M_ua, B = block(M, u, a), value_of(model, "actuation", q)
        B_a, B_u = block(B, a, free), block(B, u, free)
        # The other accelerations and the multipliers: with no unknown torque, and for each of these.
        forces = jnp.concatenate([(force - product(M_ua, v_dot_a))[:, None], B_u], axis=1)
        gammas = jnp.concatenate([(gamma - product(G_a, v_dot_a))[:, None], jnp.zeros((len(G_a), len(free)))], axis=1)
        moved, borne = saddle.solve(forces, gammas)
        needed = product(block(M, a, a), v_dot_a) + taken(rest, a)
        needed = needed + product(M_ua.T, moved[:, 0]) + product(G_a.T, borne[:, 0])
        effect = B_a - product(M_ua.T, moved[:, 1:]) - product(G_a.T, borne[:, 1:])
        found = shared(effect, needed, bounds_of(model, q, v, free))
        v_dot = parts.joined(v_dot_a, moved[:, 0] + product(moved[:, 1:], found.torque))
        multipliers = borne[:, 0] + product(borne[:, 1:], found.torque)
    torque = _merged(found.torque, free, given.known, parts.known)
    motion = Solved(q, rates(model, q, v), v, v_dot, torque, drift=drift, valid=valid)
    if model.constraints:
        motion = motion._replace(
            multipliers=multipliers,
            reactions=-product(bound.G.T, multipliers),
            constraint=constraint_of(model, q),
            constraint_rate=bound.rate(v),
        )
    return motion.checked(motion_error(model, parts, q, rate, v), found)


def columns(M: Float[Array, "m n"], places: tuple[int, ...]) -> Float[Array, "m places"]:
    """Some columns of a matrix."""
    return M if places == tuple(range(M.shape[1])) else taken(M.T, places).T


def _known_force(model: AbstractMechanical, parts: Partition, q: Array, given: Prescribed) -> Any:
    """The generalised force of the known torques."""
    if not parts.known:
        return jnp.zeros(parts.speeds)
    if model.acts_directly:
        return spread(given.known, parts.known, parts.speeds) if parts.unknown else given.known
    return columns(value_of(model, "actuation", q), parts.known) @ given.known


def effect_of_torques(
    model: AbstractMechanical, parts: Partition, q: Float[Numbers, " coordinates"]
) -> Float[Array, "driven unknown"] | None:
    """How the torques to find act along the prescribed velocities, the others moving as they must.

    `None` where none are to be found, or each acts for itself.
    """
    a, u, free = parts.driven, parts.undriven, parts.unknown
    if not a or (not u and model.acts_directly):
        return None
    B = value_of(model, "actuation", q)
    if not (u or model.constraints):
        return B
    M, G = value_of(model, "mass_matrix", q), jacobian_of(model, q)
    if parts.surplus:
        return jnp.concatenate([columns(B, free), G.T], axis=1)
    G_a, G_u = (columns(G, some) for some in (a, u))
    moved, borne = Saddle(block(M, u, u), G_u).solve(block(B, u, free), jnp.zeros((len(G), len(free))))
    return block(B, a, free) - product(block(M, a, u), moved) - product(G_a.T, borne)


class Followed(NamedTuple):
    """A prescribed motion at one instant: all coordinates, their prescribed rates, and the velocities that they drive.

    `q_dot` and `q_ddot` are of the prescribed coordinates alone where they are the velocities, and of all elsewhere.
    """

    q: Float[Array, " coordinates"]
    q_dot: Array
    q_ddot: Array
    v: Float[Array, " driven"]
    v_dot: Float[Array, " driven"]


def follow(model: AbstractMechanical, parts: Partition, given: Prescribed, q_u: Array, v_u: Array) -> Followed:
    """Equations (66) and (67) for the prescribed coordinates, whose rates no other velocity enters."""
    q, still, a = parts.merged(given.position, q_u), jnp.zeros_like(q_u), parts.prescribed
    if model.moves_directly or not a:
        return Followed(q, given.velocity, given.acceleration, given.velocity, given.acceleration)

    def own(now: AbstractMechanical, where: Array) -> Array:
        return columns(taken(value_of(now, "velocity_map", where), a), parts.driven)

    q, rate, acceleration = on_manifold(model, q, *(parts.merged(one, still) for one in given[1:3]))
    v_a = solve_any(own(model, q), taken(rate, a))
    q_dot = rates(model, q, parts.joined(v_a, v_u)) if parts.undriven else rate
    change = along_time(lambda *now: own(*now) @ v_a, model, (q,), (q_dot,))[1]
    return Followed(q, rate, acceleration, v_a, solve_any(own(model, q), taken(acceleration, a) - change))


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
