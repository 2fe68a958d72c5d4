"""Algebraic equations projected onto a basis (equations 20 and 22): equations for all coefficients together."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from aleator.analysis._projection import Quadrature
from aleator.dynamics import AlgebraicSystem, explain_failure, solve_algebraic
from aleator.dynamics._algebraic import equations, first_guess, outputs_at
from aleator.dynamics._named_roots import constant_terms
from aleator.dynamics._newton import newton


def projected_outputs(realised: AlgebraicSystem, quadrature: Quadrature) -> dict[str, Float[Array, "terms *shape"]]:
    """The coefficients of the outputs; NaN if Newton's method finds no coefficients of the unknowns.

    The unknowns' coefficients solve `<Psi_n, A(sum_j rho_j Psi_j, theta)> = 0` for every term `n` and every equation
    `A`: equation (20), projected as (22) is, with `j, n = 0..n_b-1`. `realised` is the system at each quadrature node,
    with a leading axis for the nodes. Numbers affine in the germ, equations (13) and (14), are there as (20) expands
    them; others are not truncated. Newton's method starts from the coefficients of the guess.
    """
    guesses = eqx.filter_vmap(first_guess)(realised)
    guess = jax.tree.map(quadrature.project, guesses)
    start, named = ravel_pytree(guess)
    if not start.size:
        return _projected_at(realised, quadrature, guess)
    at_node = sum(values[0].size for values in guesses)

    def left(vector: Float[Array, " n"]) -> Float[Array, " n"]:
        values = _at_nodes(lambda one, rho: equations(one, rho, at_node), realised, quadrature, named(vector))
        return jnp.ravel(quadrature.project(values))

    def terms_of(one: AlgebraicSystem, rho: Any) -> Float[Array, " equations"]:
        return constant_terms(lambda numbers: equations(numbers, rho, at_node), one)

    sizes = eqx.filter_vmap(terms_of)(realised, guesses)
    root = newton(left, start, jnp.ravel(jnp.abs(quadrature.projection) @ sizes), _numbers_expanded(guess))
    outputs = _projected_at(realised, quadrature, named(root.point))
    return {name: jnp.where(root.converged, terms, jnp.nan) for name, terms in outputs.items()}


def unsolved_node(realised_at: Callable[[Array], AlgebraicSystem], points: Float[Array, "nodes variables"]) -> str:
    """Why the equations have no solution at some quadrature node; empty if they have one at every node."""
    converged = eqx.filter_vmap(lambda point: solve_algebraic(realised_at(point)).converged)(points)
    return "" if np.all(converged) else explain_failure(realised_at(points[int(np.argmin(converged))]))


def _at_nodes(function: Callable[..., Any], realised: AlgebraicSystem, quadrature: Quadrature, rho: Any) -> Any:
    """`function(system, unknowns)` at each node, where the unknowns have the coefficients `rho`."""
    return eqx.filter_vmap(function)(realised, jax.tree.map(quadrature.at_nodes, rho))


def _projected_at(realised: AlgebraicSystem, quadrature: Quadrature, rho: Any) -> dict[str, Array]:
    return jax.tree.map(quadrature.project, _at_nodes(outputs_at, realised, quadrature, rho))


def _numbers_expanded(rho: Any) -> np.ndarray:
    """The number, counted over all unknowns, to which each coefficient belongs, and whose unit it shares."""
    counts = [values[0].size for values in rho]
    first = np.cumsum([0, *counts])
    return np.concatenate(
        [
            np.tile(first[i] + np.arange(count), len(values))
            for i, (count, values) in enumerate(zip(counts, rho, strict=True))
        ]
    )
