"""How far an expansion can reach: bounds from its Bernstein form, tightened by branch and bound.

The largest Bernstein coefficient is a guaranteed upper bound, which exceeds the maximum by at most a multiple of the
square of the box's width. Halving the box with the largest bound, again and again, brings the bound down to it.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from aleator.statistics._enclosure import Enclosure, corners, mapped, whole_box

# Halving ends at a gap of this part of the range of the Bernstein coefficients, or after this many boxes.
_CLOSE = 1e-4
_MOST_BOXES = 128
_FEWEST_BOXES = 16
_MOST_NUMBERS = 2**23

# The sum of the terms' largest absolute values, times this, amply bounds all rounding errors of the bound.
_ROUNDING = 1e-13


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
    maps = [one[best] for one in boxes.maps]
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
            maps=tuple(all_.at[place].set(one) for all_, one in zip(boxes.maps, maps, strict=True)),
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
