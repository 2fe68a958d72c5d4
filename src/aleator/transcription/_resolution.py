"""How well the expansions of a problem resolve its functionals at one point, and their moments there."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.compilation import Compiled, Use
from aleator.design import AbstractFunctional
from aleator.expansion import Collocation, leave_one_out, leave_one_out_history
from aleator.statistics import Mean, Std


class Resolved(NamedTuple):
    """One functional at given decisions: its moments, and how well its expansion predicts a new sample.

    - `history`: the leave-one-out error of a path at each instant (see `leave_one_out_history`); None for a number;
    - `tangents`: the leave-one-out error of its derivative by each decision that is a parameter of a distribution;
      derivatives of statistics follow from these. None if unknown.
    """

    mean: Float[Array, "*shape"]
    std: Float[Array, "*shape"]
    leave_one_out: Float[Array, ""]
    history: Float[Array, " instants"] | None
    tangents: Float[Array, " parameters"] | None


# Evenly spread instants of a path at which its derivatives are checked: enough to show how well they are resolved.
_SEEN = 50


def seen(samples: Float[Array, "points *shape"], is_path: bool) -> Float[Array, "points *few"]:
    """The samples of a functional whose derivatives are checked: of a path at some instants, including the last."""
    return samples[:, :: -max(1, samples.shape[1] // _SEEN)] if is_path else samples


def _resolve(
    functionals: tuple[AbstractFunctional, ...],
    collocation: Collocation,
    samples: tuple[Float[Array, "points ..."], ...],
    tangents: tuple[Float[Array, "points ... parameters"] | None, ...],
) -> tuple[Resolved, ...]:
    parts = zip(functionals, samples, tangents, strict=True)
    return tuple(_resolved(one, collocation, values, slopes) for one, values, slopes in parts)


def _resolved(
    functional: AbstractFunctional,
    collocation: Collocation,
    samples: Float[Array, "points ..."],
    tangents: Float[Array, "points ... parameters"] | None,
) -> Resolved:
    terms = collocation.coefficients(samples)
    return Resolved(
        mean=Mean().of(terms, ()),
        std=Std().of(terms, ()),
        leave_one_out=leave_one_out(collocation, samples, terms),
        history=leave_one_out_history(collocation, samples, terms) if functional.is_path else None,
        tangents=None if tangents is None else _errors_of(collocation, tangents),
    )


def _errors_of(
    collocation: Collocation, tangents: Float[Array, "points ... parameters"]
) -> Float[Array, " parameters"]:
    """The leave-one-out error of each tangent's own expansion.

    A fit is linear, so that the derivatives of its coefficients are the coefficients of the derivative.
    """
    each = jnp.moveaxis(tangents, -1, 0)
    return jax.vmap(lambda one: leave_one_out(collocation, one, collocation.coefficients(one)))(each)


RESOLVE = Compiled(_resolve, use=Use.ONCE)
