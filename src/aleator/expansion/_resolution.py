"""The instant from which an expansion of fixed order no longer resolves a trajectory.

As the phases of realisations drift apart, the response becomes more and more nonlinear in the germ (Wan and
Karniadakis, 2006, Long-term behavior of polynomial chaos in stochastic flow simulations), so that an order that is
ample at first fails later.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from aleator.expansion._collocation import Collocation, mean_squares, relative_error

UNRESOLVED = 0.05
"""Above this relative leave-one-out error an output is not resolved, unless its `Expansion` says otherwise."""


def leave_one_out_history(
    collocation: Collocation,
    samples: Float[Array, "points instants *shape"],
    coefficients: Float[Array, "terms instants *shape"],
) -> Float[Array, " instants"]:
    """The leave-one-out error at each instant, relative to the largest variance up to that instant.

    Relative to the variance at the same instant it would rise wherever all trajectories meet, as those of an oscillator
    do near its turning points. Rounding is judged in the same way, by the largest square up to that instant.
    """
    parts = mean_squares(collocation, samples, coefficients)
    error, variance, square = (part.reshape(samples.shape[1], -1).sum(axis=1) for part in parts)
    return relative_error(error, jax.lax.cummax(variance), jax.lax.cummax(square))


def resolved_instants(
    collocation: Collocation,
    samples: Float[Array, "points instants *shape"],
    coefficients: Float[Array, "terms instants *shape"],
    tolerance: float = UNRESOLVED,
) -> Int[Array, ""]:
    """How many instants of a history, from the first on, an expansion resolves: the index of the first unresolved one.

    An instant is unresolved if its `leave_one_out_history` exceeds `tolerance` or is NaN.
    """
    unresolved = ~(leave_one_out_history(collocation, samples, coefficients) <= tolerance)
    return jnp.where(unresolved.any(), jnp.argmax(unresolved), len(unresolved))
