"""Constraints at one instant: their derivatives, and accelerations and multipliers together.

All are linear in the velocities, `G(q, t) v + b(q, t) = 0`: the rates of holonomic ones, `g(q, t) = 0`, and those that
bind velocities alone. The index is reduced by differentiation (dissertation, equation 6). What integration then loses
of the constraints themselves is put back wherever the equations are evaluated, so that no gain is to be chosen: the
motion obeys them at all times, whatever carries it forward, and an integrator keeps its order. Where a system begins,
coordinates and velocities that its constraints allow are found from those given.
"""

import functools
from collections.abc import Collection
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from aleator.dynamics import newton
from aleator.mechanics._instant import along_time, later
from aleator.mechanics._matrices import (
    block,
    inverse,
    positive_solver,
    product,
    solve_any,
    solve_positive,
    spread,
    taken,
)
from aleator.mechanics._mechanical import (
    AbstractMechanical,
    constraint_of,
    rates,
    value_of,
)

# Corrections of the coordinates with one Jacobian: each multiplies what is missing by what was missing at first.
_CORRECTIONS = 3

# A last correction longer than this, beside one and the coordinates, does not converge.
_CLOSE = 1e-7


# A complete start may miss the constraints by so much, beside one and its numbers: published digits, and postures of
# simulators whose constraints yield, which a short lever makes a hundredth (the keyframe of Agility's Cassie).
_PUBLISHED = 1e-2


_AFFINE = (
    "velocity_constraint(q, v): expected equations that are linear in the velocities, each of at least one of them. "
    "What binds coordinates alone is written as constraint(q)."
)


def holonomic_jacobian(model: AbstractMechanical, q: Float[Array, " coordinates"]) -> Float[Array, "holonomic speeds"]:
    """`G(q)` of the constraints that bind coordinates. Raises `ProblemError` for another shape."""
    loops, own = model.closing_jacobian(q), len(model.constraint_names)
    if not own:
        return loops
    return jnp.concatenate([loops, value_of(model, "constraint_jacobian", q)])


def velocity_terms(model: AbstractMechanical, q: Array) -> tuple[Float[Array, "own speeds"], Float[Array, " own"]]:
    """`A(q)` and `b(q)` of the velocity constraints `A v + b = 0`."""
    # The value beside its derivative: traced once.
    return jax.jacfwd(lambda v: (value_of(model, "velocity_constraint", q, v),) * 2, has_aux=True)(
        jnp.zeros(len(model.speeds))
    )


def rate_terms(
    model: AbstractMechanical, q: Array
) -> tuple[Float[Array, "constraints speeds"], Float[Array, " constraints"] | None]:
    """`G(q)` and `b(q)` of the rates `G v + b` of all constraints; no `b` where it is known to be zero."""
    G, b = holonomic_jacobian(model, q), None
    if model._when is not None and len(G):
        b = along_time(constraint_of, model, (q,), (jnp.zeros_like(q),))[1]
    if model.velocity_constraint_names:
        A, own = velocity_terms(model, q)
        G, b = jnp.concatenate([G, A]), jnp.concatenate([jnp.zeros(len(G)) if b is None else b, own])
    return G, b


def jacobian_of(model: AbstractMechanical, q: Float[Array, " coordinates"]) -> Float[Array, "constraints speeds"]:
    """`G(q)` of all constraints. Raises `ProblemError` for another shape."""
    return rate_terms(model, q)[0]


def velocity_rule(model: AbstractMechanical, q: Array) -> dict[str, tuple[Array, Array]]:
    """The rule of velocity constraints, in words, with what they are by two ways: see `stated_twice`."""
    if not model.velocity_constraint_names:
        return {}
    v, (A, b) = jnp.linspace(0.4, 0.7, len(model.speeds)), velocity_terms(model, q)
    acts = jnp.any(A != 0, axis=1)
    return {
        _AFFINE: (jnp.stack([value_of(model, "velocity_constraint", q, v), acts]), jnp.stack([A @ v + b, acts | True]))
    }


class Loose(NamedTuple):
    """The places of coordinates and velocities that are not prescribed, and follow the constraints."""

    coordinates: tuple[int, ...]
    speeds: tuple[int, ...]


@final
class Bound:
    """The constraints of a model at one posture, with the terms of their rates, which are traced once for all uses."""

    def __init__(self, model: AbstractMechanical, q: Array):
        self._model, self._q = model, q
        if model.constraints:
            terms, self._along = jax.linearize(lambda s, at: rate_terms(later(model, s), at), np.zeros(()), q)
        else:
            terms = jnp.zeros((0, len(model.speeds))), None
            self._along = lambda *_: terms
        self.G, self._b = terms

    def rate(self, v: Float[Array, " speeds"]) -> Float[Array, " constraints"]:
        """`G v + b`, of holonomic constraints `ġ`, with `b = ∂g/∂t`."""
        return _affine((self.G, self._b), v)

    def acceleration(self, v: Float[Array, " speeds"]) -> Float[Array, " constraints"]:
        """`γ` of `G v̇ = γ`: `-(Ġ v + ḃ)`, of holonomic constraints that of equation (6)."""
        return -_affine(self._along(np.ones(()), rates(self._model, self._q, v)), v)


def _affine(terms: tuple[Float[Array, "m n"], Float[Array, " m"] | None], v: Float[Array, " n"]) -> Float[Array, " m"]:
    linear = product(terms[0], v)
    return linear if terms[1] is None else linear + terms[1]


@final
class Saddle:
    """`[M Gᵀ; G 0] [x; λ] = [force; γ]`, equation (6), factorised once; not finite where it is singular.

    As many constraints as unknowns, or more that agree, determine these whatever `M` is.
    """

    def __init__(self, M: Float[Array, "n n"], G: Float[Array, "m n"]):
        self._M, self._G = M, G
        rows, columns = G.shape
        if 0 < rows >= columns:
            self._free = jnp.zeros_like
            self._least = inverse(G) if rows == columns else solve_any(G, jnp.eye(rows))
        else:
            self._free = positive_solver(M)
            along = self._free(G.T)
            self._least = solve_positive(product(G, along), along.T).T

    def least(self, gamma: Float[Array, "m ..."]) -> Float[Array, "n ..."]:
        """The `x` of `G x = γ` with the least `xᵀ M x`."""
        return product(self._least, gamma)

    def solve(
        self, force: Float[Array, "n ..."], gamma: Float[Array, "m ..."]
    ) -> tuple[Float[Array, "n ..."], Float[Array, "m ..."]]:
        """`x` and `λ`, of vectors or column by column."""
        free = self._free(force)
        if not len(self._G):
            return free, gamma
        x = free + self.least(gamma - product(self._G, free))
        return x, product(self._least.T, force - product(self._M, x))


def put_back(
    model: AbstractMechanical, q: Float[Array, " coordinates"], loose: Loose
) -> tuple[Float[Array, " coordinates"], Bool[Array, ""], Float[Array, ""]]:
    """Coordinates beside their constraints, put back onto them by those that are loose; whether that succeeds; and how
    far they were from them, the largest `|g|`.

    By a Newton method with the Jacobian of the given place, on the shortest way.
    """
    q, moving = model.normalised(q), loose.coordinates
    model = model.seen_at(q)
    G = taken(holonomic_jacobian(model, q).T, loose.speeds).T
    H = None if model.moves_directly else block(value_of(model, "velocity_map", q), moving, loose.speeds)
    back = solve_any(G, jnp.eye(len(G)))

    def corrected(q: Array, _: Any) -> tuple[Array, tuple[Array, Array]]:
        left = constraint_of(model, q)
        along = product(back, left)
        correction = along if H is None else product(H, along)
        return q - spread(correction, moving, len(q)), (jnp.abs(left).max(), jnp.abs(correction).max())

    q, (left, steps) = jax.lax.scan(corrected, q, length=_CORRECTIONS)
    q = model.normalised(q)
    return q, steps[-1] <= _CLOSE * (1 + jnp.abs(q).max()), left[0]


class Stated(NamedTuple):
    """The places of coordinates and velocities that a start names, and of the others, which follow the constraints.

    A complete start follows them by itself, within what published ones miss: then all may move.
    """

    named: Loose
    loose: Loose

    @classmethod
    def by(cls, model: AbstractMechanical, start: Collection[str], moving: Loose) -> "Stated":
        """What a start names of what is not prescribed."""
        parts = list(zip((model.coordinates, model.speeds), moving, strict=True))
        named = Loose(*(tuple(i for i in places if names[i] in start) for names, places in parts))
        open_ones = (tuple(i for i in places if i not in some) for (_, places), some in zip(parts, named, strict=True))
        return cls(named, Loose(*(some or places for some, (_, places) in zip(open_ones, parts, strict=True))))


def consistent_start(
    model: AbstractMechanical, q: Float[Array, " coordinates"], v: Float[Array, " speeds"], stated: Stated
) -> tuple[Float[Array, " coordinates"], Float[Array, " speeds"]]:
    """Coordinates and velocities beside those given, moved where they are loose, that the constraints allow.

    Not a number where there are none, or none that agree with a complete start.
    """
    where = consistent_coordinates(model, q, stated.loose.coordinates)
    speeds = consistent_velocities(model, where, v, stated.loose.speeds)
    agreed = zip((where, speeds), (q, v), stated.named, stated.loose, strict=True)
    return tuple(
        jnp.where(agrees(new, old).all(), new, jnp.nan) if set(named) & set(loose) else new
        for new, old, named, loose in agreed
    )  # type: ignore[return-value]


def agrees(new: Any, old: Any) -> Any:
    """Whether numbers are those of a complete start, up to what published ones miss."""
    return abs(new - old) <= _PUBLISHED * (1 + abs(old))


def consistent_coordinates(
    model: AbstractMechanical, near: Float[Array, " coordinates"], moving: tuple[int, ...]
) -> Float[Array, " coordinates"]:
    """The posture that the constraints allow on the shortest way from one nearby, by some coordinates; or not a number.

    Shortest by the coordinates as they are, rad and m alike: at right angles to the constraints at the posture given.
    Differentiable, by the implicit function theorem.
    """
    if not model.holonomic:
        return near
    # Rounding of angles and lengths of about 1, for a start may obey the constraints with coordinates of zero.
    sizes = 1 + jnp.abs(near)
    slope = jax.jacfwd(functools.partial(constraint_of, model))(near)
    way = taken(slope.T, moving)

    def posture(lengths: Array) -> Array:
        return model.normalised(near + spread(product(way, lengths), moving, len(near)))

    start = jnp.zeros(len(model.holonomic))
    root = newton(lambda lengths: constraint_of(model, posture(lengths)), start, jnp.abs(slope) @ sizes)
    return posture(jnp.where(root.converged, root.point, jnp.nan))


def consistent_velocities(
    model: AbstractMechanical, q: Array, near: Float[Array, " speeds"], moving: tuple[int, ...]
) -> Float[Array, " speeds"]:
    """The velocities nearest to those given that the constraints allow, by some of them; not a number where none."""
    bound = Bound(model.seen_at(q), q)
    return near - spread(solve_any(taken(bound.G.T, moving).T, bound.rate(near)), moving, len(near))
