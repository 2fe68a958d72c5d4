"""Parts of the variance of a piecewise expansion: Sobol indices over elements.

Given some of the variables, the conditional mean of the output is a piecewise polynomial of these: in each element the
terms that depend on no others, weighted by the probability of the element's extent in the other variables. Its variance
is a sum over all pairs of elements of integrals over the intersection of their cells, which factor by variable and are
exact by Gauss quadrature. Definitions: Sobol (2001), Global sensitivity indices for nonlinear mathematical models.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.arrays import NUMBER, in_library, jax_array, refuse_beyond_memory
from aleator._core.leaves import Module
from aleator.expansion import Division, PiecewiseBasis, restricted

# For memory: the product of the variables' contributions to pairs of terms, and one factor of it.
_MATRICES = 2


class _Explained(NamedTuple):
    """A quadratic form in the `chosen` terms of all elements."""

    chosen: Int[Array, " chosen"]
    form: Float[Array, "size size"]


@final
class PartOfVariance(Module):
    """A sum of quadratic forms in the coefficients of all elements, or the variance without it."""

    division: Division
    parts: tuple[_Explained, ...]
    is_rest: bool = eqx.field(static=True)

    def of(
        self, coefficients: Float[Array, "terms *shape"], variance: Float[Array, "*shape"]
    ) -> Float[Array, "*shape"]:
        """The part of a variance."""
        library, known, parts = in_library(coefficients, self.parts)
        away = library.concatenate([0 * known[:1], known[1:]])
        _, away = in_library(self.division.elements(away))
        total = library.zeros(variance.shape)
        for chosen, form in parts:
            own = away[:, chosen].reshape(len(form), *away.shape[2:])
            total = total + library.sum(own * library.tensordot(form, own, axes=1), axis=0)
        return variance - total if self.is_rest else total


def part_by_interaction(basis: PiecewiseBasis, places: Sequence[int]) -> PartOfVariance:
    """The part of the variance by the interaction of all these variables, without those of fewer of them.

    Raises `ProblemError` if all pairs of elements would not fit into memory.
    """
    parts = [
        _explained(basis, (-1.0) ** (len(places) - size), known)
        for size in range(1, len(places) + 1)
        for known in combinations(places, size)
    ]
    return PartOfVariance(basis.division, tuple(parts), is_rest=False)


def total_part(basis: PiecewiseBasis, place: int) -> PartOfVariance:
    """The part of the variance to which a variable contributes. Raises `ProblemError` as above."""
    others = [i for i in range(basis.variables) if i != place]
    return PartOfVariance(basis.division, (_explained(basis, 1.0, others),), is_rest=True)


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


def _explained(basis: PiecewiseBasis, sign: float, known: Sequence[int]) -> _Explained:
    """The variance of the mean given the known variables: a quadratic form in the terms that depend on these alone."""
    indices = basis.pieces[0].indices
    unknown = [i for i in range(indices.shape[1]) if i not in known]
    chosen = np.flatnonzero((indices[:, unknown] == 0).all(axis=1))
    degrees = indices[chosen]
    size = len(basis.cells) * len(chosen)
    refuse_beyond_memory(
        f"Sobol index: all pairs of {len(chosen)} terms in {len(basis.cells)} elements",
        NUMBER * _MATRICES * size**2,
        "Lower the budget of al.MultiElement, or take al.references.sobol_indices.",
    )
    cuts = [_cuts(basis, i) for i in range(indices.shape[1])]
    weights = np.prod([cuts[i].widths[cuts[i].owner] for i in unknown], axis=0) * np.ones(len(basis.cells))
    rows = np.repeat(weights, len(chosen))
    form = rows[:, None] * rows[None]
    for i in known:
        gram = _gram(basis, i, cuts[i], int(degrees[:, i].max()))
        of_rows = np.repeat(cuts[i].owner, len(chosen)), np.tile(degrees[:, i], len(basis.cells))
        form *= gram[of_rows[0][:, None], of_rows[0][None], of_rows[1][:, None], of_rows[1][None]]

    return _Explained(jax_array(chosen), jax_array(sign * form))


def _cuts(basis: PiecewiseBasis, variable: int) -> _Cuts:
    ends = np.array([(cell.low[variable], cell.high[variable]) for cell in basis.cells])
    different, owner = np.unique(ends, axis=0, return_inverse=True)
    return _Cuts(different, owner.ravel())


def _gram(
    basis: PiecewiseBasis, variable: int, cuts: _Cuts, degree: int
) -> Float[np.ndarray, "intervals intervals degrees degrees"]:
    """`E[1 p_a 1' p_b']` for the polynomials of any two intervals, each zero outside its own."""
    germ = list(basis.germs.values())[variable]
    distributions = [restricted(germ, *map(float, ends)) for ends in cuts.ends]
    count = len(distributions)
    gram = np.zeros((count, count, degree + 1, degree + 1))
    for i, j in combinations(range(count), 2):
        low, high = max(cuts.ends[i, 0], cuts.ends[j, 0]), min(cuts.ends[i, 1], cuts.ends[j, 1])
        if low < high:
            nodes, weights = restricted(germ, float(low), float(high)).gauss(degree + 1)
            first, second = (
                distribution.polynomials(degree, nodes) for distribution in (distributions[i], distributions[j])
            )
            gram[i, j] = (high - low) * (first * weights[:, None]).T @ second
            gram[j, i] = gram[i, j].T
    for i, width in enumerate(cuts.widths):
        gram[i, i] = width * np.eye(degree + 1)
    return gram
