"""Local search for a large value of an expansion, which shows how tight a bound is."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator.statistics._branch_and_bound import reach
from aleator.statistics._crossings import extrema, horner
from aleator.statistics._enclosure import Enclosure

# Sweeps over the variables.
_SWEEPS = 20


def climbed(coefficients: Float[Array, "entries terms"], form: Enclosure) -> Float[Array, " entries"]:
    """Large values of the expansions: maximised along each variable in turn, from the best corner."""
    corners = reach(jax.lax.stop_gradient(coefficients).at[:, 0].set(0.0), form).corner
    return jax.vmap(_climb, in_axes=(0, 0, None))(coefficients, corners, form)


def _climb(
    coefficients: Float[Array, " terms"], start: Float[Array, " variables"], form: Enclosure
) -> Float[Array, ""]:
    fixed = jax.lax.stop_gradient(coefficients)
    variables = len(form.shape)

    def move(step: int, at: Float[Array, " variables"]) -> Float[Array, " variables"]:
        variable = step % variables
        along = _along(fixed, form, at, variable)[:, None]
        candidates = jnp.append(extrema(along)[:, 0], at[variable] * 2 - 1)
        best = candidates[jnp.argmax(horner(along, candidates[:, None])[:, 0])]
        return at.at[variable].set((1 + best) / 2)

    at = jax.lax.fori_loop(0, _SWEEPS * variables, move, start)
    return horner(_along(coefficients, form, at, 0)[:, None], at[None, :1] * 2 - 1)[0, 0]


def _along(
    coefficients: Float[Array, " terms"], form: Enclosure, at: Float[Array, " variables"], variable: int | Array
) -> Float[Array, " orders"]:
    """The expansion along one variable through a point, by powers of that variable scaled to [-1, 1]."""
    orders = jnp.arange(form.powers.shape[1])
    monomials = (at[:, None] * 2 - 1) ** orders[None]
    values = jnp.einsum("vm,vmk->vk", monomials, form.powers)
    variables = jnp.arange(len(at))[None]
    factors = jnp.where(variables == variable, 1.0, values[variables, form.indices])
    terms = coefficients * jnp.prod(factors, axis=1)
    of_degree = form.indices[:, variable][None] == orders[:, None]
    return form.powers[variable] @ jnp.sum(jnp.where(of_degree, terms[None], 0.0), axis=1)
