"""Where the algebraic variables of a realised system have no solution, and why."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from aleator.dynamics._evaluation import derivative, initial_state
from aleator.dynamics._grid import Grid
from aleator.dynamics._index_one import guessed_algebraic, solved_algebraic
from aleator.dynamics._named_roots import failure_text, listed, numbers_in
from aleator.dynamics._newton import Root
from aleator.dynamics._system import System
from aleator.trajectories import AbstractSignal

# So many places along a step are looked at for the first one where the equations have no solution.
_LOOKED_AT = 16


def explain_algebraic(
    system: System, grid: Grid, inputs: dict[str, AbstractSignal], course: Float[np.ndarray, "instants states"]
) -> str:
    """Why the algebraic variables cannot be found along a course of the states, NaN at its end; empty if they can.

    - `inputs`: with the system's own signals; `course`: the states side by side at each instant of the grid.
    """
    now = inputs_on(grid, inputs)
    times = np.asarray(grid.times)
    _, named = ravel_pytree(initial_state(system, times[0], now(times[0])))

    @jax.jit
    @jax.vmap
    def found(t: Array, row: Array) -> Array:
        return jnp.isfinite(row).all() & solved_algebraic(system, t, named(row), now(t))[0].converged

    good = np.asarray(found(jnp.asarray(times), jnp.asarray(course)))
    if good.all():
        return ""
    last = max(int(np.argmin(good)) - 1, 0)
    return explain_from(system, float(times[last]), named(jnp.asarray(course[last])), float(grid.step), now)


def inputs_on(grid: Grid, inputs: dict[str, AbstractSignal]) -> Callable[[Any], dict[str, Array]]:
    """All inputs at a time on a grid."""
    stretched = {name: signal.over(grid.t_start, grid.t_final) for name, signal in inputs.items()}
    return lambda t: {name: signal(jnp.asarray(t, dtype=float)) for name, signal in stretched.items()}


def explain_from(system: System, t: float, z: Any, step: float, now: Callable[[Any], dict[str, Array]]) -> str:
    """Why the algebraic variables cannot be found at an instant or within a step after it; empty if they can.

    - `now`: the inputs at a time.
    """
    shares = np.arange(_LOOKED_AT + 1) / _LOOKED_AT

    @jax.jit
    @jax.vmap
    def onward(share: Array) -> tuple[Root, Any, Any, Array]:
        """The solution on the tangent to the course."""
        later, slope = t + share * step, derivative(system, t, z, now(t))
        place = jax.tree.map(lambda one, change: one + jnp.where(share > 0, share * step * change, 0.0), z, slope)
        at = system, later, place, now(later)
        root = solved_algebraic(*at)[0]
        return root, place, guessed_algebraic(*at), root.converged

    *found, converged = onward(jnp.asarray(shares))
    if np.all(converged):
        return ""
    first = int(np.argmin(converged))
    root, place, guess = jax.tree.map(lambda one: one[first], found)
    numbers = listed({**place._asdict(), **numbers_in(system)})
    return (
        f"{system.title}: its algebraic variables have no solution at about t = "
        f"{t + shares[first] * step:.4g} s{f', with {numbers}' if numbers else ''}. "
        f"{failure_text(root, ravel_pytree(guess)[1], guess)} {_remedy(root)}"
    )


def _remedy(root: Root) -> str:
    if np.isfinite(root.residuals).all() and not root.regular:
        return (
            "Each of them has to follow from the equations at a fixed state (index 1): differentiate by time those "
            "that do not contain them, or keep away from where solutions meet."
        )
    return "Check whether a solution exists there, and return values closer to it from algebraic_guess(t, z)."
