"""Cubics in the cells of lines, and the normal variable along them, by NumPy."""

import math
from typing import Any

import numpy as np
import scipy
from jaxtyping import Bool, Float

from aleator._core.arrays import quietly
from aleator.uncertainty import AbstractGerm

END = 7.0
"""How far lines count, in standard deviations. Beyond it lies 3e-12."""

# Beyond this, double precision cannot tell a distribution function from 0 or 1. Cells of the table of a germ.
LAST, TABLED = 8.2, 1024
# A table that is off by this part of a germ variable's spread does not tell where an output crosses a threshold.
_OFF = 1e-3
# In so many cells on either side what a spline swings by, a quarter in each of what it was in the last, is rounding.
_SWINGING = 24

# Gauss's rule from 0 to 1.
_NODES, _WEIGHTS = (np.asarray(each) / 2 for each in np.polynomial.legendre.leggauss(3))
_NODES = _NODES + 0.5

# Newton's method within a bracket, bisection where a step leaves it. It ends when the last root moves by no more than
# this, after which the error of a simple root, which a step squares, is rounding.
_MOST_ITERATIONS, _AT_REST = 30, 1e-9
# At a root, rounding may put a value and a step on different sides. A step that leaves the bracket by less than this
# part of it, or by rounding, ends at its edge: bisection would lose the digits found so far.
_AT_THE_EDGE, _ROUNDING = 1e-6, 1e-14


def cubics_through(values: Float[np.ndarray, "lines nodes"]) -> Float[np.ndarray, "4 lines cells"]:
    """Hermite's cubics between nodes, with slopes by differences of fourth order; constant term first."""
    slopes = (8 * (values[:, 3:-1] - values[:, 1:-3]) - (values[:, 4:] - values[:, :-4])) / 12
    values = values[:, 2:-2]
    first, last, rise = slopes[:, :-1], slopes[:, 1:], np.diff(values, axis=1)
    return np.stack([values[:, :-1], first, 3 * rise - 2 * first - last, first + last - 2 * rise])


def horner(
    powers: Float[np.ndarray, "orders *lines"], x: Float[np.ndarray, "points *lines"]
) -> Float[np.ndarray, "points *lines"]:
    """The values of polynomials, each at its own points."""
    value = np.broadcast_to(powers[-1][None], x.shape)
    for coefficient in powers[-2::-1]:
        value = value * x + coefficient[None]
    return value


def with_slope(powers: Float[np.ndarray, "orders *lines"], x: Float[np.ndarray, "points *lines"]) -> tuple[Any, Any]:
    """The values and first derivatives of polynomials, each at its own points."""
    value, slope = np.broadcast_to(powers[-1][None], x.shape), np.zeros(x.shape)
    for coefficient in powers[-2::-1]:
        slope = slope * x + value
        value = value * x + coefficient[None]
    return value, slope


def root_within(
    powers: Float[np.ndarray, "4 n"],
    low: Float[np.ndarray, " n"],
    high: Float[np.ndarray, " n"],
    rising: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """The root of each polynomial between two places, from one to the other of which its sign changes."""
    x = (low + high) / 2
    for _ in range(_MOST_ITERATIONS):
        value, slope = (one[0] for one in with_slope(powers, x[None]))
        below = (value < 0) == rising
        low, high = np.where(below, x, low), np.where(below, high, x)
        newton = x - value / np.where(slope == 0, 1.0, slope)
        edge = _AT_THE_EDGE * (high - low) + _ROUNDING
        usable = (newton >= low - edge) & (newton <= high + edge) & (slope != 0)
        closer = np.where(usable, np.clip(newton, low, high), (low + high) / 2)
        moved, x = np.abs(closer - x).max(initial=0.0), closer
        if not moved > _AT_REST:
            break
    return x


@quietly
def extremum_within(
    slope: Float[np.ndarray, "*n"], bend: Float[np.ndarray, "*n"], rest: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Where a cubic whose slopes at 0 and 1 have different signs has its extremum, by its higher powers."""
    radicand = np.sqrt(np.maximum(bend**2 - 3 * rest * slope, 0.0))
    larger = -(bend + np.where(bend < 0, -1.0, 1.0) * radicand)
    near, far = _ratio(slope, larger), _ratio(larger, 3 * rest)
    return np.clip(np.where((near > 0) & (near < 1), near, far), 0.0, 1.0)


def _ratio(above: Any, below: Any) -> Any:
    return np.where(below == 0, 2.0, above / np.where(below == 0, 1.0, below))


def density_of(at: Any) -> Any:
    """The density of a standard normal variable."""
    return np.exp(-(at**2) / 2) / math.sqrt(2 * math.pi)


def beyond(at: Any) -> Any:
    """The probability of a normal variable beyond a number, where lines have their small values, as far as lines go."""
    outside = math.erfc(END / math.sqrt(2)) / 2
    return (scipy.special.erfc(at / math.sqrt(2)) / 2 - outside) / (1 - 2 * outside)


def integrals_of_powers(
    start: Float[np.ndarray, "*parts"],
    length: Float[np.ndarray, "*parts"],
    first: Float[np.ndarray, "*cells"],
    step: float,
) -> Float[np.ndarray, "4 *parts"]:
    """The integrals of the powers of the place over parts of cells, by Gauss's rule; the first is the probability."""
    total = np.zeros((4, *start.shape))
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        place = start + node * length
        density = weight * length * step * density_of(first + place * step)
        total += density * place ** np.arange(4).reshape(-1, *[1] * place.ndim)
    return total


def by_values(by_cubics: Float[np.ndarray, "4 lines cells"]) -> Float[np.ndarray, "lines nodes"]:
    """Derivatives by the values at nodes from those by the cubics through them: the transpose of `cubics_through`."""
    constant, linear, square, cube = by_cubics
    rise, first, last = 3 * square - 2 * cube, linear - 2 * square + cube, cube - square
    lines, cells = constant.shape
    values, slopes = np.zeros((lines, cells + 5)), np.zeros((lines, cells + 1))
    values[:, 2:-3] += constant - rise
    values[:, 3:-2] += rise
    slopes[:, :-1] += first
    slopes[:, 1:] += last
    for shift, factor in ((3, 8), (1, -8), (4, -1), (0, 1)):
        values[:, shift : shift + cells + 1] += factor / 12 * slopes
    return values


def table_of(germ: AbstractGerm) -> tuple[Float[np.ndarray, "cells 4"], Float[np.ndarray, " cells"]]:
    """A germ variable by a standard normal one of the same level: cubics by powers of the place in a cell, and cells in
    the middle of which these are off. Around those a spline would swing: cubics there rise throughout.
    """
    normal, nodes = np.linspace(-LAST, LAST, 2 * TABLED + 1), np.arange(TABLED + 1.0)
    values = germ.quantile(scipy.special.ndtr(normal))
    kinds = scipy.interpolate.CubicSpline, scipy.interpolate.PchipInterpolator
    spline, rising = (kind(nodes, values[::2]) for kind in kinds)
    limit = _OFF * germ.recurrence(2)[1][1]
    swings, is_steep = (np.abs(one(nodes[:-1] + 0.5) - values[1::2]) > limit for one in (spline, rising))
    around = np.convolve(swings, np.ones(2 * _SWINGING + 1), "same") > 0
    return np.where(around[:, None], rising.c[::-1].T, spline.c[::-1].T), (is_steep & around).astype(float)
