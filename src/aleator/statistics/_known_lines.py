"""An expansion with known coefficients at points of the normal variables, by NumPy, as `Lines` has it for programs."""

import math

import numpy as np
from jaxtyping import Float

from aleator.statistics._cubics import LAST, TABLED, horner
from aleator.statistics._lines import APART, DESCENTS, MINIMA, ON_A_LATTICE, SEARCHED, Lines, unit

# Points are evaluated for so many at once, for the cache.
_TOGETHER = 2**11
# The step of derivatives by imaginary parts, which lose no digits.
_IMAGINARY = 1e-30


def terms_at(lines: Lines, normal: Float[np.ndarray, "variables n"]) -> Float[np.ndarray, "terms n"]:
    """The terms of a basis at points of the normal variables, which may have imaginary parts."""
    flat = _polynomials(lines, normal)
    product = flat[lines.factors[0]]
    for others in lines.factors[1:]:
        product *= flat[others]
    return product


def _polynomials(lines: Lines, normal: Float[np.ndarray, "variables n"]) -> Float[np.ndarray, "polynomials n"]:
    """The polynomials of each variable by degree, the constant first."""
    germ = _germ(lines, normal)
    every, previous, current = [], np.zeros(germ.shape), np.ones(germ.shape, germ.dtype)
    for a, b, after in lines.recurrence[..., None]:
        every.append(current)
        previous, current = current, ((germ - a) * current - b * previous) / after
    return np.concatenate(every)


def values_at(
    lines: Lines, coefficients: Float[np.ndarray, " terms"], normal: Float[np.ndarray, "variables n"]
) -> Float[np.ndarray, " n"]:
    """The expansion at points: products are needed of terms in several variables alone."""
    flat, factors = _polynomials(lines, normal), lines.factors
    is_product = (factors > 0).sum(axis=0) > 1
    single = np.bincount(factors[:, ~is_product].max(axis=0, initial=0), coefficients[~is_product], len(flat))
    value = single @ flat
    if is_product.any():
        first, *others = factors[:, is_product]
        product = flat[first]
        for other in others:
            product *= flat[other]
        value += coefficients[is_product] @ product
    return value


def _germ(lines: Lines, normal: Float[np.ndarray, "variables n"]) -> Float[np.ndarray, "variables n"]:
    if np.all(lines.is_normal > 0):
        return normal
    place = (normal + LAST) * (TABLED / (2 * LAST))
    clipped = np.clip(place.real, 0.0, float(TABLED))
    cell = np.minimum(clipped.astype(int), TABLED - 1)
    cubic = np.asarray(lines.table)[np.arange(len(cell))[:, None], cell]
    inside = clipped - cell + (place - place.real)
    return np.where(lines.is_normal > 0, normal, horner(np.moveaxis(cubic, -1, 0), inside[None])[0])


def minima_of(lines: Lines, coefficients: Float[np.ndarray, " terms"]) -> Float[np.ndarray, "variables minima"]:
    """As `Lines.minima`."""
    left, chosen = coefficients @ lines.at_starts, []
    for _ in range(MINIMA):
        chosen.append(lines.starts[:, np.argmin(left)])
        left = np.where(chosen[-1] @ lines.starts > APART, np.inf, left)
    minima, values = np.stack(chosen, axis=1), np.zeros(MINIMA)
    variables = len(minima)
    steps = 1j * _IMAGINARY * np.eye(variables)[..., None]
    for _ in range(DESCENTS):
        moved = (SEARCHED * (minima[:, None] + steps)).reshape(variables, -1)
        heights = (coefficients @ terms_at(lines, moved)).reshape(variables, MINIMA)
        minima, values = unit(minima - unit(np.imag(heights) / _IMAGINARY)), np.real(heights[0])
    return minima[:, np.argsort(values, kind="stable")]


def is_whole_lattice(lines: Lines) -> bool:
    """Whether these are lines of few variables, for one output: all of a lattice."""
    variables, *count = lines.normals.shape
    return ON_A_LATTICE.get(variables) == math.prod(count)


def axis_of(lines: Lines, coefficients: Float[np.ndarray, " terms"]) -> Float[np.ndarray, "variables 1"]:
    """The axis of the variable in which the expansion has the largest linear part, in the sense in which it falls."""
    variables = len(lines.table)
    # Places of factors begin with those of degree zero, which count nothing, then come the linear ones.
    place = lines.factors.sum(axis=0)
    linear = np.bincount(place, coefficients, 2 * variables)[variables : 2 * variables]
    axis = np.argmax(np.abs(linear))
    return np.where(linear[axis] > 0, -1.0, 1.0) * np.eye(variables)[:, [axis]]


def blocks(count: int) -> list[slice]:
    """Which of so many points are evaluated at once."""
    return [slice(first, first + _TOGETHER) for first in range(0, count, _TOGETHER)]
