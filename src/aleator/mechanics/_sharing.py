"""How actuators share a force that they make together: the torques of least norm, within bounds if they have any.

These solve `minimise |τ|²/2` subject to `E τ = force`, `lower <= τ <= upper`. At the optimum `τ` is `Eᵀ μ` between its
bounds and at a bound elsewhere: the multipliers `μ`, of which there are few, maximise the concave dual, by Newton's
method. The search has no derivatives. Those of its result are those of the linear equations that hold once it is known
which torques are at a bound: exact to any order, but for the instant at which another torque reaches its bound.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.border import refusal, traceable
from aleator._core.errors import ProblemError
from aleator.mechanics._matrices import solve_any, solve_positive
from aleator.mechanics._mechanical import AbstractMechanical, evaluated

# The most Newton steps, and the parts of each of which the best is taken: where all torques are at bounds, steps are
# as long as the reciprocal of the damping.
_STEPS, _PARTS = 50, 0.5 ** np.arange(40.0)

# What keeps equations regular where too few torques are between their bounds, in the search and in its result.
_DAMPING, _LEAST_DAMPING = 1e-10, 1e-12

# A part of the force that is smaller than this, beside one and the force, is rounding.
_ROUNDING = 1e-9


class Shares(NamedTuple):
    """Torques; how much of a force their bounds leave out, and whether that is rounding; `None` without bounds."""

    torque: Float[Array, " torques"]
    shortfall: Any = None
    valid: Any = None


def shared(
    E: Float[Array, "n torques"],
    force: Float[Array, " n"],
    bounds: Float[Array, "2 torques"] | None,
    G: Float[Array, "constraints n"] | None = None,
) -> Shares:
    """The torques of least norm that make a force, `E τ = force`, within bounds; what acts along `Gᵀ` is borne."""
    rank, beside = len(E), None
    if G is not None:
        # The force that is not borne has fewer directions than entries: `Gᵀ G` stands for the others.
        rank, beside = len(E) - len(G), G.T @ G
        along = jnp.eye(len(E)) - solve_any(G, G)
        E, force = along @ E, along @ force
    if bounds is None or E.shape[1] <= rank:
        torque = solve_any(E, force) if beside is None else E.T @ solve_positive(E @ E.T + beside, force)
        if bounds is None:
            return Shares(torque)
        within = jnp.clip(torque, *bounds)
    else:
        dual = _Dual(E, force, bounds[0], bounds[1], jnp.zeros((len(E), len(E))) if beside is None else beside)
        still = jax.lax.stop_gradient(dual)
        start = jnp.zeros(len(E)), jnp.zeros((), int), jnp.asarray(True)
        mu, *_ = jax.lax.while_loop(lambda state: state[2] & (state[1] < _STEPS), still.advanced, start)
        mu, held, is_free = dual.newton(mu, _LEAST_DAMPING)
        torque, within = jnp.where(is_free, mu @ E, held), dual.torque(mu)
    left = jnp.where(jnp.all(bounds[0] <= bounds[1]), jnp.abs(E @ within - force), jnp.inf)
    slack = _ROUNDING * (1 + jnp.abs(E) @ jnp.abs(within) + jnp.abs(force))
    return Shares(torque, left.max(), jnp.all(left <= slack))


class _Dual(NamedTuple):
    """The dual problem: maximise `force · μ - Σ max((Eᵀ μ) τ - τ²/2)`, the maxima over `τ` within its bounds.

    `beside`: what makes `E Eᵀ` regular, and does not act on any force that is made.
    """

    E: Float[Array, "m torques"]
    force: Float[Array, " m"]
    lower: Float[Array, " torques"]
    upper: Float[Array, " torques"]
    beside: Float[Array, "m m"]

    def torque(self, mu: Float[Array, " m"]) -> Float[Array, " torques"]:
        return jnp.clip(mu @ self.E, self.lower, self.upper)

    def beyond(self, mu: Float[Array, " m"]) -> Float[Array, " torques"]:
        """1 where a torque is held by its lower bound, -1 by its upper one, 0 if it is free."""
        return jnp.sign(self.torque(mu) - mu @ self.E)

    def newton(self, mu: Float[Array, " m"], damping: float) -> tuple[Array, Array, Array]:
        """The multipliers with which the torques that are free make what those held at bounds leave; these two."""
        E, is_free = self.E, self.beyond(mu) == 0
        held = jnp.where(is_free, 0.0, self.torque(mu))
        damped = damping * E @ E.T
        matrix = (E * is_free[None]) @ E.T + damped + self.beside
        return solve_positive(matrix, self.force - E @ held + damped @ mu), held, is_free

    def advanced(self, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        """Multipliers after the best part of a step, the number of steps, and whether other torques are held then."""
        mu, steps, _ = state
        whole, *_ = self.newton(mu, _DAMPING)
        best = jnp.argmax(jax.vmap(lambda part: self.level(mu + part * (whole - mu)))(_PARTS))
        return mu + 0.5**best * (whole - mu), steps + 1, jnp.any(self.beyond(whole) != self.beyond(mu))

    def level(self, mu: Float[Array, " m"]) -> Float[Array, ""]:
        """What is maximised."""
        torque = self.torque(mu)
        return mu @ self.force - (mu @ self.E) @ torque + torque @ torque / 2


def bounds_of(
    model: AbstractMechanical, q: Array, v: Array, places: Sequence[int] | None = None
) -> Float[Array, "2 torques"] | None:
    """The bounds of torques, of all or at some places. Raises `ProblemError` for anything but pairs by name."""
    who, names = f"{type(model).__name__}.torque_bounds(q, v)", model.actuators
    some = names if places is None else [names[i] for i in places]
    if not (model.is_bounded and some):
        return None
    given = evaluated(model, "torque_bounds", q, v)
    if not (
        isinstance(given, Mapping)
        and set(given) <= set(names)
        and all(isinstance(ends, tuple | list) and len(ends) == 2 for ends in given.values())
    ):
        raise refusal(who, f"the least and the largest torque, by name, of some of {list(names)}", given)
    pairs = [(name, given.get(name, (None, None))) for name in some]
    return jnp.stack(
        [
            jnp.stack([_bound(f"{who}, '{name}'", limit if ends[i] is None else ends[i]) for name, ends in pairs])
            for i, limit in enumerate((-np.inf, np.inf))
        ]
    )


def _bound(who: str, end: Any) -> Float[Array, ""]:
    array = traceable(who, end)
    if array.shape != ():
        raise ProblemError(f"{who}: expected one number; received shape {array.shape}.")
    return array
