"""How well the expansions of a problem resolve its functionals at one point, and their moments there."""

from typing import NamedTuple

from jaxtyping import Array, Float

from aleator._core.compilation import Compiled
from aleator.collocation import Collocation, leave_one_out, leave_one_out_history
from aleator.design import AbstractFunctional
from aleator.statistics import Mean, Std


class Resolved(NamedTuple):
    """One functional at given decisions: its moments, and how well its expansion predicts a new sample.

    `history` is the leave-one-out error of a path at each instant (see `leave_one_out_history`); None for a number.
    """

    mean: Float[Array, "*shape"]
    std: Float[Array, "*shape"]
    leave_one_out: Float[Array, ""]
    history: Float[Array, " instants"] | None


def _resolve(
    functionals: tuple[AbstractFunctional, ...],
    collocation: Collocation,
    samples: tuple[Float[Array, "points ..."], ...],
) -> tuple[Resolved, ...]:
    return tuple(_resolved(one, collocation, values) for one, values in zip(functionals, samples, strict=True))


def _resolved(
    functional: AbstractFunctional, collocation: Collocation, samples: Float[Array, "points ..."]
) -> Resolved:
    terms = collocation.coefficients(samples)
    return Resolved(
        mean=Mean().of(terms, ()),
        std=Std().of(terms, ()),
        leave_one_out=leave_one_out(collocation, samples, terms),
        history=leave_one_out_history(collocation, samples, terms) if functional.is_path else None,
    )


RESOLVE = Compiled(_resolve)
