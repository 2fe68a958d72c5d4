"""Sobol indices: how much of a variance comes from which inputs (Sudret, 2008, Global sensitivity analysis using
polynomial chaos expansions; Sobol, 2001, Global sensitivity indices for nonlinear mathematical models).

Over elements, the conditional mean of the output given some of the variables is a piecewise polynomial of these: in
each element the terms that depend on no others, weighted by the probability of the element's extent in the other
variables. Its variance is a sum over all pairs of elements of integrals over the intersection of their cells, which
factor by variable and are exact by Gauss quadrature.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar, NamedTuple, NoReturn, TypeAlias, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from typing_extensions import override

from aleator._core.arrays import NUMBER, in_library, jax_array, quietly, refuse_beyond_memory
from aleator._core.border import meant
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.expansion import AbstractBasis, Division, PiecewiseBasis, restricted
from aleator.statistics._statistic import AbstractStatistic, varies

# For memory: the product of the variables' contributions to pairs of terms, and one factor of it.
_MATRICES = 2


@final
class Sobol(AbstractStatistic):
    """The Sobol index of a set of germ variables: their share of the variance by interaction, from 0 to 1.

    One name gives the first-order index, two the index of the pair without the parts of each alone. With `total` it is
    the share to which a single variable contributes, alone or together with others. Zero if the output does not vary.
    Names are those of the germ, `basis.names`.
    """

    variables: tuple[str, ...] = eqx.field(static=True)
    total: bool = eqx.field(static=True)

    dimensionless: ClassVar[bool] = True
    needs_no_compiler: ClassVar[bool] = True

    def __init__(self, variables: str | tuple[str, ...], *, total: bool = False):
        names = (variables,) if isinstance(variables, str) else tuple(variables)
        if not names or len(set(names)) < len(names) or not all(isinstance(name, str) for name in names):
            raise ProblemError(f"Sobol: expected one name or several different ones; received {variables!r}.")
        self.variables, self.total = names, total

    @property
    @override
    def preparation(self) -> "Callable[[AbstractBasis], Selection]":
        return Selecting(self.variables, self.total)

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: "Selection") -> Float[Array, "*shape"]:
        return share(coefficients, constants)

    def of_sample(self, values: Float[Array, "samples *shape"]) -> NoReturn:
        """Not to be had from one sample."""
        del values
        raise ProblemError(
            "A Sobol index cannot be estimated from one sample of an output, which does not say which inputs its "
            "values come from: take it from al.expand, or use al.references.sobol_indices."
        )

    @override
    def text(self, inside: str) -> str:
        return f"S{'T' * self.total}({', '.join(self.variables)})[{inside}]"


@final
@dataclass(frozen=True)
class Selecting:
    """Preparation: one for each term that depends on exactly these variables, or on a single one of them, else zero."""

    variables: tuple[str, ...]
    total: bool

    def __call__(self, basis: AbstractBasis) -> "Selection":
        """The selection of a basis. Raises `ProblemError` for a name that it does not have."""
        if not basis.variables:
            return jnp.zeros(basis.terms)  # nothing is uncertain
        places = sorted(place_of(basis, name) for name in self.variables)
        if isinstance(basis, PiecewiseBasis):
            return total_part(basis, *places) if self.total else part_by_interaction(basis, places)
        if self.total:
            return jax_array(basis.indices[:, places[0]] > 0, float)
        chosen = np.zeros(basis.variables, bool)
        chosen[places] = True
        return jax_array(np.all((basis.indices > 0) == chosen, axis=1), float)


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


Selection: TypeAlias = Float[Array, " terms"] | PartOfVariance
"""A part of a variance: that of some terms, which are one, or over elements."""


@quietly
def share(coefficients: Float[Array, "terms *shape"], selected: Selection) -> Float[Array, "*shape"]:
    """The part of the variance in the selected terms; zero, with derivative zero, if there is no variance."""
    library, coefficients, selected, spreads = in_library(coefficients, selected, varies(coefficients))
    squares = coefficients[1:] ** 2
    total = library.sum(squares, axis=0)
    if isinstance(selected, PartOfVariance):
        _, part = in_library(selected.of(coefficients, total))
        part = library.clip(part / library.where(spreads, total, 1.0), 0.0, 1.0)
    else:
        part = library.tensordot(selected[1:], squares, axes=1) / library.where(spreads, total, 1.0)
    return jax_array(library.where(spreads, part, 0.0))


def place_of(basis: AbstractBasis, name: str) -> int:
    """The index of the germ variable with this name. Raises `ProblemError`, with a similar name, if there is none."""
    if name in basis.names:
        return basis.names.index(name)
    hint = meant(name, basis.names) or f" Expected one of {list(basis.names)}."
    raise ProblemError(f"Sobol index: there is no germ variable '{name}'.{hint}")


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
