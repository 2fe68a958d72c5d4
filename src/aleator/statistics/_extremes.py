"""Supremum and infimum of an output over the support (dissertation, equation 88).

On a box a polynomial lies between its smallest and its largest Bernstein coefficient, and the coefficients at the
corners are its values there (Garloff, 1993, The Bernstein algorithm). So the largest coefficient is an upper bound,
which exceeds the maximum by at most a multiple of the square of the box's width. Halving the box with the largest
bound, again and again, brings the bound down to the largest value at a corner.
"""

import math
from collections.abc import Callable, Sequence
from typing import ClassVar, NamedTuple, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from typing_extensions import override

from aleator._core.arrays import in_library, jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.expansion import AbstractBasis, InElements, PiecewiseBasis, in_each
from aleator.statistics._statistic import AbstractStatistic, in_blocks
from aleator.uncertainty import AbstractGerm

# Halving ends at a gap of this part of the range of the Bernstein coefficients, or after this many boxes.
_CLOSE = 1e-4
_MOST_BOXES = 128
_FEWEST_BOXES = 16
_MOST_NUMBERS = 2**23

# The sum of the terms' largest absolute values, times this, amply bounds all rounding errors of the bound.
_ROUNDING = 1e-13

# Entries per block: few in a search, because it goes on until the last of them is done.
_TOGETHER = 16
_EASY_TOGETHER = 64

# An evaluation holds a few tensors of this many numbers.
_MOST_COEFFICIENTS = 2**22


@final
class Enclosure(Module):
    """The Bernstein form of a basis on the box of its germ.

    - `bernstein[i]`: the coefficients of the polynomials of variable `i`, shape (degree + 1, degree + 1), by degree in
      the columns; `halves[i]`: from the coefficients on a box to those on its lower and upper half;
    - `indices`: degrees of each term in each variable that occurs; `place`: of each term in the flat tensor of degrees;
    - `sizes`: a bound on the absolute value of each term.
    """

    bernstein: tuple[Float[Array, "n n"], ...]
    halves: tuple[Float[Array, "2 n n"], ...]
    indices: Int[Array, "terms variables"]
    place: Int[Array, " terms"]
    sizes: Float[Array, " terms"]

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of a tensor of coefficients."""
        return tuple(len(matrix) for matrix in self.bernstein)


Form: TypeAlias = Enclosure | InElements


def enclosure(basis: AbstractBasis) -> Form:
    """Preparation: the Bernstein form of a basis, of a piecewise one that in each element.

    Raises `ProblemError` if the support is unbounded, or if the Bernstein coefficients need too much memory.
    """
    unbounded = [name for name, germ in basis.germs.items() if not np.all(np.isfinite(germ.support()))]
    if unbounded:
        raise ProblemError(
            f"Supremum and infimum: the germ variables {', '.join(map(repr, unbounded))} have no bounds, as those of "
            "unbounded and of correlated distributions; use bounded, independent ones such as Uniform or Beta, or a "
            "quantile (for instance .quantile(0.999)) instead."
        )
    if isinstance(basis, PiecewiseBasis):
        return in_each(enclosure, basis)
    active = [i for i, degree in enumerate(basis.degrees) if degree > 0]
    shape = [basis.degrees[i] + 1 for i in active]
    if math.prod(shape) > _MOST_COEFFICIENTS:
        raise ProblemError(
            f"Supremum and infimum: the Bernstein form in {len(active)} variables has {math.prod(shape)} coefficients, "
            f"more than {_MOST_COEFFICIENTS}. Use a lower order or fewer variables, or a quantile instead."
        )
    germs = list(basis.germs.values())
    bernstein = [_bernstein(germs[i], basis.degrees[i]) for i in active]
    indices = basis.indices[:, active]
    largest = [np.abs(matrix).max(axis=0)[degrees] for matrix, degrees in zip(bernstein, indices.T, strict=True)]
    return Enclosure(
        bernstein=tuple(jax_array(matrix) for matrix in bernstein),
        halves=tuple(jax_array(_halves(basis.degrees[i])) for i in active),
        indices=jax_array(indices),
        place=jax_array(indices @ np.array([math.prod(shape[k + 1 :]) for k in range(len(shape))], dtype=int)),
        sizes=jax_array(np.prod(largest, axis=0) * np.ones(basis.terms)),
    )


def _bernstein(germ: AbstractGerm, degree: int) -> Float[np.ndarray, "n n"]:
    """The Bernstein coefficients of the orthonormal polynomials of a germ on its support, one in each column."""
    low, high = germ.support()
    # At Chebyshev points, which keep the matrix of the Bernstein polynomials well conditioned.
    at = (1 - np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))) / 2
    powers = np.arange(degree + 1)
    choices = np.array([math.comb(degree, k) for k in powers])
    values = choices * at[:, None] ** powers * (1 - at[:, None]) ** (degree - powers)
    return np.linalg.solve(values, germ.polynomials(degree, low + (high - low) * at))


def _halves(degree: int) -> Float[np.ndarray, "2 n n"]:
    """De Casteljau's algorithm at the middle, as matrices: exact, because all entries are binary fractions."""
    lower = np.array([[math.comb(j, k) / 2.0**j for k in range(degree + 1)] for j in range(degree + 1)])
    return np.stack([lower, lower[::-1, ::-1]])


def whole_box(coefficients: Float[Array, " terms"], form: Enclosure) -> Float[Array, "*shape"]:
    """The Bernstein coefficients on the whole support."""
    flat = jnp.zeros(math.prod(form.shape)).at[form.place].set(coefficients)
    return mapped(flat.reshape(form.shape), form.bernstein)


def mapped(tensor: Float[Array, "*shape"], matrices: Sequence[Float[Array, "n n"]]) -> Float[Array, "*shape"]:
    """A tensor with a matrix applied along each of its axes."""
    for axis, matrix in enumerate(matrices):
        shape = tensor.shape
        split = tensor.reshape(math.prod(shape[:axis]), shape[axis], -1)
        # Written out, because calls for products of small matrices cost more than their arithmetic.
        parts = [matrix[None, :, n, None] * split[:, n, None, :] for n in range(len(matrix))]
        tensor = sum(parts[1:], parts[0]).reshape(shape)
    return tensor


def corners(tensor: Float[Array, "*shape"]) -> Float[Array, " corners"]:
    """The coefficients at the corners of the box, which are values of the polynomial."""
    return tensor[tuple(slice(None, None, n - 1) for n in tensor.shape)].ravel()


class _Boxes(NamedTuple):
    """Boxes that cover the support, `number` of them so far.

    - `maps[i]`: from Bernstein coefficients on the support to those on each box, shape (boxes, n, n) for variable `i`;
    - `bounds`: the largest coefficient on each; `bending`: the expected gain of halving each variable;
    - `attained`: the largest value at a corner so far.
    """

    number: Int[Array, ""]
    maps: tuple[Float[Array, "boxes n n"], ...]
    bounds: Float[Array, " boxes"]
    bending: Float[Array, "boxes variables"]
    attained: Float[Array, ""]


def bound(coefficients: Float[Array, "entries terms"], form: Enclosure) -> Float[Array, " entries"]:
    """Upper bounds of the expansions: their largest Bernstein coefficients, plus a margin for rounding."""
    fixed = jax.lax.stop_gradient(coefficients)
    margin = _ROUNDING * jnp.abs(fixed) @ form.sizes
    return jnp.sum(coefficients * reach(fixed.at[:, 0].set(0.0), form), axis=1) + margin


def difficulty(coefficients: Float[Array, "entries terms"], form: Enclosure) -> Float[Array, " entries"]:
    """The gap between bound and attained value before any halving, relative to the range; small gaps close soon."""

    def gap(terms: Float[Array, " terms"]) -> Float[Array, ""]:
        whole = whole_box(terms.at[0].set(0.0), form)
        width = jnp.ptp(whole)
        return (jnp.max(whole) - jnp.max(corners(whole))) / jnp.where(width > 0, width, 1.0)

    return jax.vmap(gap)(coefficients)


def reach(coefficients: Float[Array, "entries terms"], form: Enclosure) -> Float[Array, "entries terms"]:
    """The basis polynomials in the largest Bernstein coefficients of some expansions. Not differentiable.

    They share one loop, because a vectorised loop over each of them would copy all its boxes in every step. The search
    ends when the last expansion has its bound; the bounds of the others get tighter meanwhile.
    """
    whole = jax.vmap(lambda terms: whole_box(terms, form))(coefficients)
    width = jax.vmap(jnp.ptp)(whole)
    # Fewer boxes where their tensors are large.
    limit = max(_FEWEST_BOXES, min(_MOST_BOXES, _MOST_NUMBERS // math.prod(form.shape)))

    def unfinished(boxes: _Boxes) -> Array:
        gap = jnp.max(boxes.bounds, axis=1) - boxes.attained
        return (boxes.number[0] < limit) & jnp.any(gap > _CLOSE * width)

    def halve(boxes: _Boxes) -> _Boxes:
        return jax.vmap(_halve, in_axes=(0, 0, None))(boxes, whole, form.halves)

    first = jax.vmap(_first, in_axes=(0, None))(whole, limit)
    return jax.vmap(_result, in_axes=(0, 0, None))(jax.lax.while_loop(unfinished, halve, first), whole, form)


def _result(boxes: _Boxes, whole: Float[Array, "*shape"], form: Enclosure) -> Float[Array, " terms"]:
    """The largest coefficient of all boxes, as a linear function of the coefficients of the expansion."""
    best = jnp.argmax(boxes.bounds)
    maps = [matrices[best] for matrices in boxes.maps]
    largest = jnp.argmax(mapped(whole, maps).ravel())
    terms = jnp.ones(len(form.indices))
    for i, place in enumerate(jnp.unravel_index(largest, form.shape)):
        terms = terms * (maps[i][place] @ form.bernstein[i])[form.indices[:, i]]
    return terms


def _first(whole: Float[Array, "*shape"], count: int) -> _Boxes:
    """The whole support as the first box."""
    bounds, bending, attained = _facts(whole)
    return _Boxes(
        number=jnp.asarray(1),
        maps=tuple(jnp.tile(jnp.eye(n), (count, 1, 1)) for n in whole.shape),
        bounds=jnp.full(count, -jnp.inf).at[0].set(bounds),
        bending=jnp.zeros((count, whole.ndim)).at[0].set(bending),
        attained=attained,
    )


def _halve(boxes: _Boxes, whole: Float[Array, "*shape"], halves: tuple[Array, ...]) -> _Boxes:
    """Halve the box with the largest bound, in the variable in which its coefficients bend most."""
    parent = jnp.argmax(boxes.bounds)
    variable = jnp.argmax(boxes.bending[parent])
    children = []
    for half in (0, 1):
        maps = [
            jnp.where(variable == i, halves[i][half] @ maps[parent], maps[parent]) for i, maps in enumerate(boxes.maps)
        ]
        children.append((maps, *_facts(mapped(whole, maps))))
    for place, (maps, bound, bending, attained) in zip((parent, boxes.number), children, strict=True):
        boxes = _Boxes(
            number=boxes.number,
            maps=tuple(known.at[place].set(new) for known, new in zip(boxes.maps, maps, strict=True)),
            bounds=boxes.bounds.at[place].set(bound),
            bending=boxes.bending.at[place].set(bending),
            attained=jnp.maximum(attained, boxes.attained),
        )
    return boxes._replace(number=boxes.number + 1)


def _facts(tensor: Float[Array, "*shape"]) -> tuple[Array, Array, Array]:
    """For one box: its bound, the bending in each variable, and the largest value at a corner."""
    bending = jnp.stack([_bending(tensor, axis) for axis in range(tensor.ndim)])
    return jnp.max(tensor), bending, jnp.max(corners(tensor))


def _bending(tensor: Float[Array, "*shape"], axis: int) -> Float[Array, ""]:
    """The largest second difference; zero if the coefficients are monotone, because the extreme is then at an end."""
    first = jnp.diff(tensor, axis=axis)
    second = jnp.diff(first, axis=axis)
    monotone = (jnp.min(first) >= 0) | (jnp.max(first) <= 0)
    return jnp.where(monotone, 0.0, jnp.max(jnp.abs(second), initial=0.0))


class AbstractExtreme(AbstractStatistic):
    """A bound of the expansion on the support of bounded distributions (dissertation, equation 88)."""

    speaks_of_one_system: ClassVar[bool] = True

    @property
    @override
    def preparation(self) -> Callable[..., Form]:
        return enclosure


@final
class Supremum(AbstractExtreme):
    """An upper bound of the expansion on the support of bounded distributions (dissertation, equation 88).

    It bounds the expansion, not the model, whose values may exceed it where the expansion errs. It is never below the
    supremum of the expansion, and above it by at most 1e-4 of the range of the Bernstein coefficients, unless the
    search reaches its limit on boxes. Its derivative is that of the active coefficient.
    """

    symbol: ClassVar[str] = "sup"

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Form) -> Float[Array, "*shape"]:
        """Entries are grouped by difficulty: a group takes as long as its hardest one."""
        if isinstance(constants, InElements):
            elements = constants.division.elements(coefficients)
            return jnp.max(jax.lax.map(lambda pair: self.of(*pair), (elements, constants.each)), axis=0)
        if not constants.shape:
            return coefficients[0]
        flat = coefficients.reshape(len(coefficients), -1)
        if flat.shape[1] <= _TOGETHER:
            return in_blocks(lambda terms: bound(terms, constants), coefficients, _TOGETHER)
        fixed = jax.lax.stop_gradient(flat)
        order = jnp.argsort(in_blocks(lambda terms: difficulty(terms, constants), fixed, _EASY_TOGETHER))
        values = in_blocks(lambda terms: bound(terms, constants), flat[:, order], _TOGETHER)
        return jnp.zeros(len(values)).at[order].set(values).reshape(coefficients.shape[1:])

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        """The largest value of the sample, which is never more than the supremum."""
        library, values = in_library(values)
        return jax_array(library.max(values, axis=0))


@final
class Infimum(AbstractExtreme):
    """A lower bound of the expansion on the support of bounded distributions, as `Supremum` is an upper one."""

    symbol: ClassVar[str] = "inf"

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Form) -> Float[Array, "*shape"]:
        return -Supremum().of(-coefficients, constants)

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        """The smallest value of the sample, which is never less than the infimum."""
        library, values = in_library(values)
        return jax_array(library.min(values, axis=0))
