"""`Element`: a box of the germ's domain with an expansion of its own (multi-element gPC, [11]-[16])."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import jax
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import Pytree, jax_array
from aleator.analysis._box import Box
from aleator.analysis._inputs import plain
from aleator.analysis._sampling import Sampler
from aleator.expansion import Basis, Expansion, collocate, leave_one_out
from aleator.uncertainty import AbstractGerm


@final
@dataclass(frozen=True)
class Element:
    """The expansion of all outputs in one box.

    - `coefficients`: of each output, shape (terms, *shape);
    - `known`: the same as plain numbers, a list with shapes (terms, entries);
    - `squared_errors`: mean squared leave-one-out error of each output, summed over its entries.
    """

    box: Box
    basis: Basis
    points: int
    coefficients: Pytree
    known: list[Float[np.ndarray, "terms entries"]]
    squared_errors: Float[np.ndarray, " outputs"]

    def prediction(self, points: Float[np.ndarray, "n variables"]) -> list[Float[np.ndarray, "n entries"]]:
        """Each output at germ points of the box."""
        matrix = self.basis.matrix(points)
        return [matrix @ terms for terms in self.known]


def element(box: Box, germs: Mapping[str, AbstractGerm], expansion: Expansion, sampler: Sampler) -> Element:
    """Expand all outputs in one box."""
    basis, collocation = collocate(box.germs(germs), expansion)
    samples = sampler.samples(collocation.points)
    values = flat(samples)
    known = [np.asarray(collocation.coefficients(jax_array(one))) for one in values]
    errors = [
        float(leave_one_out(collocation, jax_array(one), jax_array(terms))) ** 2 * one.var(axis=0).sum()
        for one, terms in zip(values, known, strict=True)
    ]
    coefficients = jax.tree.map(collocation.coefficients, samples)
    return Element(box, basis, len(collocation.points), coefficients, known, np.array(errors))


def flat(samples: Pytree) -> list[Float[np.ndarray, "points entries"]]:
    """Each output as plain numbers."""
    return [values.reshape(len(values), -1) for values in jax.tree.leaves(plain(samples))]
