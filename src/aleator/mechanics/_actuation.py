"""The actuation scheme of a mechanical system, from its actuation map (section 2.3)."""

from enum import Enum

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.given import one_of, real_array, refusal
from aleator.mechanics._constraints import jacobian_of
from aleator.mechanics._matrices import solve_any
from aleator.mechanics._mechanical import AbstractMechanical, actuation_map
from aleator.mechanics._spatial import Numbers


class Actuation(Enum):
    """The actuation schemes of figure 2.2."""

    PASSIVE = "passive"
    FULL = "fully actuated"
    UNDER = "under-actuated"
    OVER = "over-actuated"
    UNDER_OVER = "under-over-actuated"


def actuation_of(model: AbstractMechanical, q: Float[Array, " coordinates"]) -> Actuation:
    """The actuation scheme of a realised system in a posture, from the rank of `B(q)` and the number of torques.

    For a system with constraints, `B` is taken on the motions that these leave free, in a posture that satisfies them.
    """
    one_of("actuation_of", model, AbstractMechanical, "an al.Multibody")
    posture = real_array("actuation_of: q", q)
    if posture.shape != (len(model.coordinates),) or not np.isfinite(posture).all():
        raise refusal("actuation_of: q", f"finite numbers for {list(model.coordinates)}", q)
    q = jnp.asarray(posture)
    B = np.asarray(actuation_map(model, q))
    if model.constraints:
        G = np.asarray(jacobian_of(model, q))
        B = np.linalg.svd(G)[2][len(G) :] @ B
    return scheme(B)


def scheme(B: Float[np.ndarray, "speeds actuators"]) -> Actuation:
    """The scheme of an actuation map."""
    rank = int(np.linalg.matrix_rank(B)) if B.size else 0
    speeds, actuators = B.shape
    if rank == 0:
        return Actuation.PASSIVE
    if rank == speeds:
        return Actuation.FULL if actuators == speeds else Actuation.OVER
    return Actuation.UNDER if actuators == rank else Actuation.UNDER_OVER


def torques(
    model: AbstractMechanical, q: Float[Numbers, " coordinates"], force: Float[Array, " speeds"]
) -> Float[Array, " actuators"]:
    """The torques that produce a generalised force; those of least norm where there are many."""
    if model.acts_directly:
        return force
    return solve_any(actuation_map(model, q), force)
