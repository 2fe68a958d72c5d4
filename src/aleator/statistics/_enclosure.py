"""How far an expansion can reach: bounds from its Bernstein form, tightened by branch and bound.

In Bernstein polynomials on a box a polynomial lies between its smallest and its largest coefficient, and the
coefficients at the corners are values that it takes there (Garloff, 1993, The Bernstein algorithm). The largest
coefficient is therefore a guaranteed upper bound; it exceeds the maximum by at most a multiple of the square of the
box's width. Halving the box with the largest bound, again and again, brings the bound down on the maximum.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.errors import ProblemError
from aleator.collocation import Basis
from aleator.statistics._crossings import extrema, horner
from aleator.uncertainty import AbstractGerm

# An evaluation works on a few tensors of that many numbers.
_MOST_COEFFICIENTS = 2**22

# Where halving ends: at this part of the range of the Bernstein coefficients, or after so many boxes.
_CLOSE = 1e-4
_MOST_BOXES = 128
_FEWEST_BOXES = 16
_MOST_NUMBERS = 2**23

# Sweeps over the variables in a local search.
_SWEEPS = 20

# The sum of the terms' largest absolute values, times this, bounds all rounding errors of the bound many times over.
_ROUNDING = 1e-13


@final
class Enclosure(eqx.Module):
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
        return tuple(len(one) for one in self.bernstein)

    @property
    def boxes(self) -> int:
        """How many boxes there are at the end: fewer where their tensors are large."""
        return max(_FEWEST_BOXES, min(_MOST_BOXES, _MOST_NUMBERS // math.prod(self.shape)))


class Reach(NamedTuple):
    """What the search for the largest value found.

    - `terms`: the basis polynomials in the largest Bernstein coefficient: the bound is their sum with the coefficients;
    - `corner`: the point with the largest value among all corners of boxes, from 0 to 1 in each variable.
    """

    terms: Float[Array, " terms"]
    corner: Float[Array, " variables"]


class _Boxes(NamedTuple):
    """Boxes that cover the support, `count` of them so far.

    - `maps[i]`: from Bernstein coefficients on the support to those on each box, shape (boxes, n, n) for variable `i`;
    - `ends`: lower and upper end, from 0 to 1, shape (boxes, variables, 2);
    - `bounds`: the largest coefficient on each; `bending`: what a halving of each variable promises;
    - `attained`, `corner`: the largest value at a corner so far, and where.
    """

    count: Int[Array, ""]
    maps: tuple[Float[Array, "boxes n n"], ...]
    ends: Float[Array, "boxes variables 2"]
    bounds: Float[Array, " boxes"]
    bending: Float[Array, "boxes variables"]
    attained: Float[Array, ""]
    corner: Float[Array, " variables"]


def enclosure(basis: Basis) -> Enclosure:
    """Preparation: the Bernstein form of a basis.

    Raises `ProblemError` if the support is unbounded, or for more Bernstein coefficients than the memory should hold.
    """
    unbounded = [name for name, germ in basis.germs.items() if not np.all(np.isfinite(germ.support()))]
    if unbounded:
        raise ProblemError(
            f"Supremum and infimum: {', '.join(map(repr, unbounded))} can take values without bound, and so can the "
            "output; use bounded laws such as Uniform or Beta, or a quantile (for instance .quantile(0.999)) instead."
        )
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
        bernstein=tuple(jnp.asarray(matrix) for matrix in bernstein),
        halves=tuple(jnp.asarray(_halves(basis.degrees[i])) for i in active),
        indices=jnp.asarray(indices),
        place=jnp.asarray(indices @ np.array([math.prod(shape[k + 1 :]) for k in range(len(shape))], dtype=int)),
        sizes=jnp.asarray(np.prod(largest, axis=0) * np.ones(basis.terms)),
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
    """De Casteljau's algorithm at the middle, as matrices: exact, for all entries are binary fractions."""
    lower = np.array([[math.comb(j, k) / 2.0**j for k in range(degree + 1)] for j in range(degree + 1)])
    return np.stack([lower, lower[::-1, ::-1]])


def reach(coefficients: Float[Array, "entries terms"], form: Enclosure) -> Reach:
    """Search for the largest values of some expansions together; nothing of it is to be differentiated.

    Together, for a loop over each by itself would copy all its boxes in every step when it is vectorised. The search
    goes on until the last has its bound; the others get tighter ones on the way.
    """
    whole = jax.vmap(lambda terms: _whole(terms, form))(coefficients)
    width = jax.vmap(jnp.ptp)(whole)

    def unfinished(boxes: _Boxes) -> Array:
        gap = jnp.max(boxes.bounds, axis=1) - boxes.attained
        return (boxes.count[0] < form.boxes) & jnp.any(gap > _CLOSE * width)

    def halve(boxes: _Boxes) -> _Boxes:
        return jax.vmap(_halve, in_axes=(0, 0, None))(boxes, whole, form.halves)

    first = jax.vmap(_first, in_axes=(0, None))(whole, form.boxes)
    return jax.vmap(_result, in_axes=(0, 0, None))(jax.lax.while_loop(unfinished, halve, first), whole, form)


def _whole(coefficients: Float[Array, " terms"], form: Enclosure) -> Float[Array, "*shape"]:
    """The Bernstein coefficients on the whole support."""
    flat = jnp.zeros(math.prod(form.shape)).at[form.place].set(coefficients)
    return _mapped(flat.reshape(form.shape), form.bernstein)


def _result(boxes: _Boxes, whole: Float[Array, "*shape"], form: Enclosure) -> Reach:
    """The largest coefficient of all boxes, as a linear function of the coefficients of the expansion."""
    best = jnp.argmax(boxes.bounds)
    maps = [one[best] for one in boxes.maps]
    largest = jnp.argmax(_mapped(whole, maps).ravel())
    terms = jnp.ones(len(form.indices))
    for i, place in enumerate(jnp.unravel_index(largest, form.shape)):
        terms = terms * (maps[i][place] @ form.bernstein[i])[form.indices[:, i]]
    return Reach(terms, boxes.corner)


def _first(whole: Float[Array, "*shape"], count: int) -> _Boxes:
    """The whole support as the first box."""
    ends = jnp.tile(jnp.array([0.0, 1.0]), (count, whole.ndim, 1))
    bounds, bending, attained, corner = _facts(whole, ends[0])
    return _Boxes(
        count=jnp.asarray(1),
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
        children.append((maps, ends, *_facts(_mapped(whole, maps), ends)))
    for place, (maps, ends, bound, bending, attained, corner) in zip(
        (parent, boxes.count), children, strict=True
    ):
        better = attained > boxes.attained
        boxes = _Boxes(
            count=boxes.count,
            maps=tuple(all_.at[place].set(one) for all_, one in zip(boxes.maps, maps, strict=True)),
            ends=boxes.ends.at[place].set(ends),
            bounds=boxes.bounds.at[place].set(bound),
            bending=boxes.bending.at[place].set(bending),
            attained=jnp.where(better, attained, boxes.attained),
            corner=jnp.where(better, corner, boxes.corner),
        )
    return boxes._replace(count=boxes.count + 1)


def _facts(tensor: Float[Array, "*shape"], ends: Float[Array, "variables 2"]) -> tuple[Array, ...]:
    """Of one box: its bound, the bending in each variable, the largest value at a corner and the corner."""
    corners = _corners(tensor)
    best = jnp.argmax(corners)
    sides = jnp.stack(jnp.unravel_index(best, (2,) * tensor.ndim))
    bending = jnp.stack([_bending(tensor, axis) for axis in range(tensor.ndim)])
    return jnp.max(tensor), bending, corners[best], ends[jnp.arange(tensor.ndim), sides]


def _corners(tensor: Float[Array, "*shape"]) -> Float[Array, " corners"]:
    """The coefficients at the corners of the box, which are values of the polynomial."""
    return tensor[tuple(slice(None, None, n - 1) for n in tensor.shape)].ravel()


def _bending(tensor: Float[Array, "*shape"], axis: int) -> Float[Array, ""]:
    """The largest second difference; zero where all coefficients rise or all fall, for then an end is the extreme."""
    first = jnp.diff(tensor, axis=axis)
    second = jnp.diff(first, axis=axis)
    monotone = (jnp.min(first) >= 0) | (jnp.max(first) <= 0)
    return jnp.where(monotone, 0.0, jnp.max(jnp.abs(second), initial=0.0))


def _mapped(tensor: Float[Array, "*shape"], matrices: Sequence[Float[Array, "n n"]]) -> Float[Array, "*shape"]:
    """A tensor with a matrix applied along each of its axes."""
    for axis, matrix in enumerate(matrices):
        shape = tensor.shape
        split = tensor.reshape(math.prod(shape[:axis]), shape[axis], -1)
        # Written out: a product of small matrices for each entry costs more in calls than in arithmetic.
        parts = [matrix[None, :, n, None] * split[:, n, None, :] for n in range(len(matrix))]
        tensor = sum(parts[1:], parts[0]).reshape(shape)
    return tensor


def bound(coefficients: Float[Array, "entries terms"], form: Enclosure) -> Float[Array, " entries"]:
    """Numbers that the expansions do not exceed: their largest Bernstein coefficients, and a margin for rounding."""
    fixed = jax.lax.stop_gradient(coefficients)
    margin = _ROUNDING * jnp.abs(fixed) @ form.sizes
    return jnp.sum(coefficients * reach(fixed.at[:, 0].set(0.0), form).terms, axis=1) + margin


def difficulty(coefficients: Float[Array, "entries terms"], form: Enclosure) -> Float[Array, " entries"]:
    """The gap between bound and attained value before any halving, relative to the range: where it is small, it ends."""

    def gap(terms: Float[Array, " terms"]) -> Float[Array, ""]:
        whole = _whole(terms.at[0].set(0.0), form)
        width = jnp.ptp(whole)
        return (jnp.max(whole) - jnp.max(_corners(whole))) / jnp.where(width > 0, width, 1.0)

    return jax.vmap(gap)(coefficients)


def climbed(coefficients: Float[Array, "entries terms"], form: Enclosure) -> Float[Array, " entries"]:
    """Large values that the expansions take: from the best corner, to the maximum along each variable in turn."""
    corners = reach(jax.lax.stop_gradient(coefficients).at[:, 0].set(0.0), form).corner
    return jax.vmap(_climb, in_axes=(0, 0, None))(coefficients, corners, form)


def _climb(coefficients: Float[Array, " terms"], start: Float[Array, " variables"], form: Enclosure) -> Float[Array, ""]:
    powers = [_to_powers(len(one) - 1) @ one for one in form.bernstein]
    fixed = jax.lax.stop_gradient(coefficients)

    def sweep(_: int, at: Float[Array, " variables"]) -> Float[Array, " variables"]:
        for i in range(len(powers)):
            along = _along(fixed, powers, form, at, i)[:, None]
            candidates = jnp.append(extrema(along)[:, 0], at[i] * 2 - 1)
            at = at.at[i].set((1 + candidates[jnp.argmax(horner(along, candidates[:, None])[:, 0])]) / 2)
        return at

    at = jax.lax.fori_loop(0, _SWEEPS, sweep, start)
    return horner(_along(coefficients, powers, form, at, 0)[:, None], at[None, :1] * 2 - 1)[0, 0]


def _along(
    coefficients: Float[Array, " terms"], powers: list[Array], form: Enclosure, at: Array, variable: int
) -> Float[Array, " orders"]:
    """The expansion along one variable through a point, by powers of that variable scaled to [-1, 1]."""
    terms = coefficients
    for i, matrix in enumerate(powers):
        if i != variable:
            values = (at[i] * 2 - 1) ** jnp.arange(len(matrix)) @ matrix
            terms = terms * values[form.indices[:, i]]
    degrees = jnp.arange(len(powers[variable]))
    return powers[variable] @ jnp.sum(jnp.where(form.indices[None, :, variable] == degrees[:, None], terms[None], 0.0), axis=1)


def _to_powers(degree: int) -> Float[np.ndarray, "n n"]:
    """From Bernstein coefficients to those of the powers of `x`, which is -1 and 1 at the ends."""
    x = np.polynomial.Polynomial([0.0, 1.0])
    columns = [math.comb(degree, k) * ((1 + x) / 2) ** k * ((1 - x) / 2) ** (degree - k) for k in range(degree + 1)]
    return np.stack([column.coef for column in columns], axis=1)
