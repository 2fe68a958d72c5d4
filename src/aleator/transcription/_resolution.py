"""How well the expansions of a problem resolve its functionals at one point, and their moments there."""

from typing import NamedTuple

from jaxtyping import Array, Float, Int

from aleator._core.compilation import Compiled
from aleator.collocation import Collocation, leave_one_out, resolved_instants
from aleator.design import AbstractFunctional
from aleator.statistics import Mean, Std


class Resolved(NamedTuple):
    """One functional at given decisions: its moments, and how well its expansion predicts a new sample.

    `instants` is how many instants of a path are resolved, from the first on; None for a number.
    """

    mean: Float[Array, "*shape"]
    std: Float[Array, "*shape"]
    leave_one_out: Float[Array, ""]
    instants: Int[Array, ""] | None


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
        instants=resolved_instants(collocation, samples, terms) if functional.is_path else None,
    )


RESOLVE = Compiled(_resolve)
