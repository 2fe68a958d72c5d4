"""Supremum and infimum of an output over the support (dissertation, equation 88).

On a box a polynomial lies between its smallest and its largest Bernstein coefficient, and the coefficients at the
corners are its values there (Garloff, 1993, The Bernstein algorithm). So the largest coefficient is an upper bound,
which exceeds the maximum by at most a multiple of the square of the box's width. Halving the box with the largest
bound, again and again, brings the bound down to it; a local search shows how tight it is.
"""

import math
from collections.abc import Callable, Sequence
from typing import ClassVar, NamedTuple, final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int
from typing_extensions import override

from aleator.expansion import InElements
from aleator.statistics._bernstein import Enclosure, Form, enclosure
from aleator.statistics._roots import extrema, horner
from aleator.statistics._statistic import AbstractStatistic, in_blocks

# Halving ends at a gap of this part of the range of the Bernstein coefficients, or after this many boxes.
_CLOSE = 1e-4
_MOST_BOXES = 128
_FEWEST_BOXES = 16
_MOST_NUMBERS = 2**23

# The sum of the terms' largest absolute values, times this, amply bounds all rounding errors of the bound.
_ROUNDING = 1e-13

_SWEEPS = 20  # over the variables

# Entries per block: few in a search, because it goes on until the last of them is done.
_TOGETHER = 16
_EASY_TOGETHER = 64


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


class Reach(NamedTuple):
    """The result of the search for the largest value.

    - `terms`: the basis polynomials in the largest Bernstein coefficient: the bound is their sum with the coefficients;
    - `corner`: the point with the largest value among all corners of boxes, from 0 to 1 in each variable.
    """

    terms: Float[Array, " terms"]
    corner: Float[Array, " variables"]


class _Boxes(NamedTuple):
    """Boxes that cover the support, `number` of them so far.

    - `maps[i]`: from Bernstein coefficients on the support to those on each box, shape (boxes, n, n) for variable `i`;
    - `ends`: lower and upper end, from 0 to 1, shape (boxes, variables, 2);
    - `bounds`: the largest coefficient on each; `bending`: the expected gain of halving each variable;
    - `attained`, `corner`: the largest value at a corner so far, and where.
    """

    number: Int[Array, ""]
    maps: tuple[Float[Array, "boxes n n"], ...]
    ends: Float[Array, "boxes variables 2"]
    bounds: Float[Array, " boxes"]
    bending: Float[Array, "boxes variables"]
    attained: Float[Array, ""]
    corner: Float[Array, " variables"]


def bound(coefficients: Float[Array, "entries terms"], form: Enclosure) -> Float[Array, " entries"]:
    """Upper bounds of the expansions: their largest Bernstein coefficients, plus a margin for rounding."""
    fixed = jax.lax.stop_gradient(coefficients)
    margin = _ROUNDING * jnp.abs(fixed) @ form.sizes
    return jnp.sum(coefficients * reach(fixed.at[:, 0].set(0.0), form).terms, axis=1) + margin


def difficulty(coefficients: Float[Array, "entries terms"], form: Enclosure) -> Float[Array, " entries"]:
    """The gap between bound and attained value before any halving, relative to the range; small gaps close soon."""

    def gap(terms: Float[Array, " terms"]) -> Float[Array, ""]:
        whole = whole_box(terms.at[0].set(0.0), form)
        width = jnp.ptp(whole)
        return (jnp.max(whole) - jnp.max(corners(whole))) / jnp.where(width > 0, width, 1.0)

    return jax.vmap(gap)(coefficients)


def reach(coefficients: Float[Array, "entries terms"], form: Enclosure) -> Reach:
    """Search for the largest values of some expansions together. Not differentiable.

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


def _result(boxes: _Boxes, whole: Float[Array, "*shape"], form: Enclosure) -> Reach:
    """The largest coefficient of all boxes, as a linear function of the coefficients of the expansion."""
    best = jnp.argmax(boxes.bounds)
    maps = [matrices[best] for matrices in boxes.maps]
    largest = jnp.argmax(mapped(whole, maps).ravel())
    terms = jnp.ones(len(form.indices))
    for i, place in enumerate(jnp.unravel_index(largest, form.shape)):
        terms = terms * (maps[i][place] @ form.bernstein[i])[form.indices[:, i]]
    return Reach(terms, boxes.corner)


def _first(whole: Float[Array, "*shape"], count: int) -> _Boxes:
    """The whole support as the first box."""
    ends = jnp.tile(jnp.array([0.0, 1.0]), (count, whole.ndim, 1))
    bounds, bending, attained, corner = _facts(whole, ends[0])
    return _Boxes(
        number=jnp.asarray(1),
        maps=tuple(jnp.tile(jnp.eye(n), (count, 1, 1)) for n in whole.shape),
        ends=ends,
        bounds=jnp.full(count, -jnp.inf).at[0].set(bounds),
        bending=jnp.zeros((count, whole.ndim)).at[0].set(bending),
        attained=attained,
        corner=corner,
    )


def _halve(boxes: _Boxes, whole: Float[Array, "*shape"], halves: tuple[Array, ...]) -> _Boxes:
    """Halve the box with the largest bound, in the variable in which its coefficients bend most."""
    parent = jnp.argmax(boxes.bounds)
    variable = jnp.argmax(boxes.bending[parent])
    middle = jnp.mean(boxes.ends[parent, variable])
    children = []
    for half in (0, 1):
        maps = [
            jnp.where(variable == i, halves[i][half] @ maps[parent], maps[parent]) for i, maps in enumerate(boxes.maps)
        ]
        ends = boxes.ends[parent].at[variable, 1 - half].set(middle)
        children.append((maps, ends, *_facts(mapped(whole, maps), ends)))
    for place, (maps, ends, bound, bending, attained, corner) in zip((parent, boxes.number), children, strict=True):
        better = attained > boxes.attained
        boxes = _Boxes(
            number=boxes.number,
            maps=tuple(known.at[place].set(new) for known, new in zip(boxes.maps, maps, strict=True)),
            ends=boxes.ends.at[place].set(ends),
            bounds=boxes.bounds.at[place].set(bound),
            bending=boxes.bending.at[place].set(bending),
            attained=jnp.where(better, attained, boxes.attained),
            corner=jnp.where(better, corner, boxes.corner),
        )
    return boxes._replace(number=boxes.number + 1)


def _facts(tensor: Float[Array, "*shape"], ends: Float[Array, "variables 2"]) -> tuple[Array, ...]:
    """For one box: its bound, the bending in each variable, the largest value at a corner, and that corner."""
    at_corners = corners(tensor)
    best = jnp.argmax(at_corners)
    sides = jnp.stack(jnp.unravel_index(best, (2,) * tensor.ndim))
    bending = jnp.stack([_bending(tensor, axis) for axis in range(tensor.ndim)])
    return jnp.max(tensor), bending, at_corners[best], ends[jnp.arange(tensor.ndim), sides]


def _bending(tensor: Float[Array, "*shape"], axis: int) -> Float[Array, ""]:
    """The largest second difference; zero if the coefficients are monotone, because the extreme is then at an end."""
    first = jnp.diff(tensor, axis=axis)
    second = jnp.diff(first, axis=axis)
    monotone = (jnp.min(first) >= 0) | (jnp.max(first) <= 0)
    return jnp.where(monotone, 0.0, jnp.max(jnp.abs(second), initial=0.0))


def climbed(coefficients: Float[Array, "entries terms"], form: Enclosure) -> Float[Array, " entries"]:
    """Large values of the expansions: maximised along each variable in turn, from the best corner."""
    corners = reach(jax.lax.stop_gradient(coefficients).at[:, 0].set(0.0), form).corner
    return jax.vmap(_climb, in_axes=(0, 0, None))(coefficients, corners, form)


def _climb(
    coefficients: Float[Array, " terms"], start: Float[Array, " variables"], form: Enclosure
) -> Float[Array, ""]:
    fixed = jax.lax.stop_gradient(coefficients)
    variables = len(form.shape)

    def move(step: int, at: Float[Array, " variables"]) -> Float[Array, " variables"]:
        variable = step % variables
        along = _along(fixed, form, at, variable)[:, None]
        candidates = jnp.append(extrema(along)[:, 0], at[variable] * 2 - 1)
        best = candidates[jnp.argmax(horner(along, candidates[:, None])[:, 0])]
        return at.at[variable].set((1 + best) / 2)

    at = jax.lax.fori_loop(0, _SWEEPS * variables, move, start)
    return horner(_along(coefficients, form, at, 0)[:, None], at[None, :1] * 2 - 1)[0, 0]


def _along(
    coefficients: Float[Array, " terms"], form: Enclosure, at: Float[Array, " variables"], variable: int | Array
) -> Float[Array, " orders"]:
    """The expansion along one variable through a point, by powers of that variable scaled to [-1, 1]."""
    orders = jnp.arange(form.powers.shape[1])
    monomials = (at[:, None] * 2 - 1) ** orders[None]
    values = jnp.einsum("vm,vmk->vk", monomials, form.powers)
    variables = jnp.arange(len(at))[None]
    factors = jnp.where(variables == variable, 1.0, values[variables, form.indices])
    terms = coefficients * jnp.prod(factors, axis=1)
    of_degree = form.indices[:, variable][None] == orders[:, None]
    return form.powers[variable] @ jnp.sum(jnp.where(of_degree, terms[None], 0.0), axis=1)


@final
class Supremum(AbstractStatistic):
    """An upper bound of the expansion on the support of bounded distributions (dissertation, equation 88).

    It bounds the expansion, not the model, whose values may exceed it where the expansion errs. It is never below the
    supremum of the expansion, and above it by at most 1e-4 of the range of the Bernstein coefficients, unless the
    search reaches its limit on boxes; `attained` tells the gap. Its derivative is that of the active coefficient.
    """

    symbol: ClassVar[str] = "sup"
    speaks_of_one_system: ClassVar[bool] = True

    @property
    @override
    def preparation(self) -> Callable[..., Form]:
        return enclosure

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Form) -> Float[Array, "*shape"]:
        return _searched(bound, coefficients, constants)

    def attained(self, coefficients: Float[Array, "terms *shape"], constants: Form) -> Float[Array, "*shape"]:
        """A value of the expansion, found by local search: the supremum lies between it and the bound."""
        return _searched(climbed, coefficients, constants)

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        """The largest value of the sample, which is never more than the supremum."""
        return jnp.max(values, axis=0)


@final
class Infimum(AbstractStatistic):
    """A lower bound of the expansion on the support of bounded distributions, as `Supremum` is an upper one."""

    symbol: ClassVar[str] = "inf"
    speaks_of_one_system: ClassVar[bool] = True

    @property
    @override
    def preparation(self) -> Callable[..., Form]:
        return enclosure

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Form) -> Float[Array, "*shape"]:
        return -Supremum().of(-coefficients, constants)

    def attained(self, coefficients: Float[Array, "terms *shape"], constants: Form) -> Float[Array, "*shape"]:
        """The infimum lies between the bound and this value."""
        return -Supremum().attained(-coefficients, constants)

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        """The smallest value of the sample, which is never less than the infimum."""
        return jnp.min(values, axis=0)


def _searched(
    search: Callable[[Array, Enclosure], Array],
    coefficients: Float[Array, "terms *shape"],
    form: Form,
) -> Float[Array, "*shape"]:
    """Search for all entries, grouped by difficulty: a group takes as long as its hardest entry."""
    if isinstance(form, InElements):
        elements = form.division.elements(coefficients)
        return jnp.max(jax.lax.map(lambda pair: _searched(search, *pair), (elements, form.each)), axis=0)
    if not form.shape:
        return coefficients[0]
    flat = coefficients.reshape(len(coefficients), -1)
    if flat.shape[1] <= _TOGETHER:
        return in_blocks(lambda terms: search(terms, form), coefficients, _TOGETHER)
    fixed = jax.lax.stop_gradient(flat)
    order = jnp.argsort(in_blocks(lambda terms: difficulty(terms, form), fixed, _EASY_TOGETHER))
    values = in_blocks(lambda terms: search(terms, form), flat[:, order], _TOGETHER)
    return jnp.zeros(len(values)).at[order].set(values).reshape(coefficients.shape[1:])
