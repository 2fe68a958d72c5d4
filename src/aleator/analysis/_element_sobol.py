"""Sobol indices of an expansion in elements: exact parts of the variance of a piecewise polynomial.

Given some of the variables, the conditional mean of the output is a piecewise polynomial of these: in each element the
terms that depend on no others, weighted by the probability of the element's extent in the other variables. Its variance
is a sum over all pairs of elements of integrals over the intersection of their boxes, which factor by variable and are
exact by Gauss quadrature. Definitions: Sobol (2001), Global sensitivity indices for nonlinear mathematical models.
"""

from collections.abc import Callable
from itertools import combinations
from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.arrays import in_library, jax_array
from aleator._core.memory import NUMBER, refuse_beyond_memory
from aleator.analysis._partition import Partition
from aleator.analysis._restricted_germ import restricted
from aleator.expansion import Basis
from aleator.statistics import Sobol, TotalSobol
from aleator.statistics._sobol import place_of

Rule: TypeAlias = Callable[[Float[Array, "elements terms *shape"]], Float[Array, "*shape"]]
"""Gives a part of the variance from the coefficients in all elements, with the overall mean subtracted."""

# For memory: the product of the variables' contributions to pairs of terms, and one factor of it.
_MATRICES = 2


def variance_part(partition: Partition, kind: Sobol | TotalSobol) -> Rule:
    """The part of the variance whose share is a Sobol index.

    Raises `ProblemError` for an unknown variable, and if all pairs of elements would not fit into memory.
    """
    whole = Basis(partition.germs, partition.bases[0].indices)
    if isinstance(kind, TotalSobol):
        place = place_of(whole, kind.variable)
        others = _explained(partition, tuple(i for i in range(whole.variables) if i != place))
        everything = partition.probability

        def part(terms: Float[Array, "elements terms *shape"]) -> Float[Array, "*shape"]:
            library, known = in_library(terms)
            return jax_array(library.tensordot(everything, library.sum(known**2, axis=1), axes=1)) - others(terms)

        return part
    places = sorted(place_of(whole, name) for name in kind.variables)
    signed = [
        ((-1) ** (len(places) - size), _explained(partition, known))
        for size in range(1, len(places) + 1)
        for known in combinations(places, size)
    ]
    return lambda terms: jnp.asarray(sum(sign * explained(terms) for sign, explained in signed))


def _explained(partition: Partition, known: tuple[int, ...]) -> Rule:
    """The variance of the mean given the known variables: a quadratic form in the terms that depend on these alone."""
    indices = partition.bases[0].indices
    unknown = [i for i in range(indices.shape[1]) if i not in known]
    chosen = np.flatnonzero((indices[:, unknown] == 0).all(axis=1))
    degrees = indices[chosen]
    size = len(partition.boxes) * len(chosen)
    refuse_beyond_memory(
        f"Sobol index: all pairs of {len(chosen)} terms in {len(partition.boxes)} elements",
        NUMBER * _MATRICES * size**2,
        "Lower the budget of al.MultiElement, or take al.references.sobol_indices.",
    )
    cuts = [_cuts(partition, i) for i in range(indices.shape[1])]
    weights = np.prod([cuts[i].widths[cuts[i].owner] for i in unknown], axis=0) * np.ones(len(partition.boxes))
    rows = np.repeat(weights, len(chosen))
    form = rows[:, None] * rows[None]
    for i in known:
        gram = _gram(partition, i, cuts[i], int(degrees[:, i].max()))
        of_rows = np.repeat(cuts[i].owner, len(chosen)), np.tile(degrees[:, i], len(partition.boxes))
        form *= gram[of_rows[0][:, None], of_rows[0][None], of_rows[1][:, None], of_rows[1][None]]

    def variance(terms: Float[Array, "elements terms *shape"]) -> Float[Array, "*shape"]:
        library, terms = in_library(terms)
        kept = terms[:, chosen].reshape(size, *terms.shape[2:])
        return jax_array(library.sum(kept * library.tensordot(form, kept, axes=1), axis=0))

    return variance


class _Cuts(NamedTuple):
    """The intervals of probability levels into which one variable is cut.

    - `ends`: of each distinct interval; `owner`: the interval of each element.
    """

    ends: Float[np.ndarray, "intervals 2"]
    owner: Int[np.ndarray, " elements"]

    @property
    def widths(self) -> Float[np.ndarray, " intervals"]:
        """The probability of each interval."""
        return self.ends[:, 1] - self.ends[:, 0]


def _cuts(partition: Partition, variable: int) -> _Cuts:
    ends = np.array([(box.low[variable], box.high[variable]) for box in partition.boxes])
    different, owner = np.unique(ends, axis=0, return_inverse=True)
    return _Cuts(different, owner.ravel())


def _gram(
    partition: Partition, variable: int, cuts: _Cuts, degree: int
) -> Float[np.ndarray, "intervals intervals degrees degrees"]:
    """`E[1 p_a 1' p_b']` for the polynomials of any two intervals, each zero outside its own."""
    germ = list(partition.germs.values())[variable]
    distributions = [restricted(germ, *map(float, ends)) for ends in cuts.ends]
    count = len(distributions)
    gram = np.zeros((count, count, degree + 1, degree + 1))
    for i, j in combinations(range(count), 2):
        low, high = max(cuts.ends[i, 0], cuts.ends[j, 0]), min(cuts.ends[i, 1], cuts.ends[j, 1])
        if low < high:
            nodes, weights = restricted(germ, float(low), float(high)).gauss(degree + 1)
            one, other = (
                distribution.polynomials(degree, nodes) for distribution in (distributions[i], distributions[j])
            )
            gram[i, j] = (high - low) * (one * weights[:, None]).T @ other
            gram[j, i] = gram[i, j].T
    for i, width in enumerate(cuts.widths):
        gram[i, i] = width * np.eye(degree + 1)
    return gram
