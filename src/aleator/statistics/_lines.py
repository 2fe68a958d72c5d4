"""Lines through the space of normal variables, along which the distribution of an output is integrated.

Probabilities of an output are integrals of a step function, which points alone resolve poorly. Along a line the
integral is that of a function of one variable, exact between the crossings of a threshold, and the average over the
lines is that of a smooth function (Griewank, Kuo, Leövey and Sloan, 2018, High dimensional integration of kinks and
jumps). Every germ variable is a function of a standard normal one, at equal probability. Lines run in the direction in
which the output is smallest at a distance of some standard deviations, so that a single line gives the result for an
output that is nearly linear in the tail. Across it, lines of two or three variables lie on a lattice, whose error falls
exponentially for smooth outputs; where these err, others run along a variable (`DistributionByLines`). Others lie where
a mixture of normal distributions puts them: the given one, two wider ones, and one around each of several such minima;
the ratio of the densities is the weight of a line (importance sampling; Owen and Zhou, 2000, on mixtures that keep the
given distribution).
"""

import math
from dataclasses import replace
from typing import Any, TypeAlias, final

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

from aleator._core.arrays import alike, in_library, jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.expansion import AbstractBasis, Division, PiecewiseBasis, in_each
from aleator.statistics._cubics import END, LAST, TABLED, horner, table_of
from aleator.uncertainty import AbstractGerm, HermiteGerm, SampleGerm

# Lines of one replicate by the distribution that places them: the given one, two wider ones, and one around each
# minimum. All are powers of two: with the replicates, each has a digital net of its own.
_SIZES, MINIMA = (128, 64, 32, 8, 8, 8, 8), 4
REPLICATES = 8

# Distances from the origin, in standard deviations: one tail probability in 4000, in 30 000, and the reach of the two
# wider distributions.
_SEARCHED, CENTRE, _REACHES = 3.5, 4.0, (3.0, 5.0)
_DESCENTS, _STARTS = 12, 64
_APART = 0.7  # cosine between minima that are told apart
# The step of derivatives by imaginary parts, which lose no digits.
_IMAGINARY = 1e-30
# Terms below this part of an output's spread are the rounding of its coefficients; values that differ by less than this
# part of it are equal.
_NO_PART, _EQUAL = 1e-12, 1e-6
# Directions are rounded to this, so that lines rest in the last steps of a search for an optimum, and values follow
# their derivatives there, in which lines rest. A step of the directions changes the error of an integral alone, by
# about a thousandth of itself.
STILL = 2.0**-10

# Cells of a line by the number of variables.
_CELLS, _FEWEST_CELLS = {1: 4096, 2: 150}, 33
# Lines on a lattice by the number of variables; its replicates; of how many lines one is taken for paths; a distance
# that counts as none.
ON_A_LATTICE, _TURNS, _COARSER, _NEAREST = {2: 512, 3: 2048}, 4, 4, 1e-9

# Points for the entries of paths, a power of two, and their width: its most, which makes no more of an error at a level
# of 0.9 than the points do, and what it is in proportion to, so that points of one variable are hardly spread out.
_POINTS, _WIDEST, _WIDTH = 512, 0.85, 1.6

# Paths of more entries than this are evaluated by fewer lines, and in part by points.
SINGLE = 4


@final
class Cloud(Module):
    """Points by the distribution of the germ, at which the terms of a basis are known.

    - `width`: over how many standard deviations of an output on either side each of its values is spread out.
    """

    terms: Float[Array, "terms points"]
    width: float = eqx.field(static=True)


@final
class Lines(Module):
    """What lines through the normal variables need of a basis, in the variables that it contains.

    - `table`: the germ variables as cubic splines of the normal ones; `is_steep`: cells in which these miss them, as
      between two modes of a density; `is_normal`: those that are normal themselves;
    - `recurrence`: the coefficients `a[n]`, `b[n]` and `b[n + 1]` of their polynomials, shape (orders, 3, variables);
    - `factors`: of each term, by degree and variable, filled up with the constant polynomial;
    - `normals`: the lines' points by a standard normal distribution; `starts`: directions at
      which a search begins; `at_starts`: the terms there;
    - `cloud`: points for the entries of paths;
    - `active`: the variables among those of the basis; `cells`: along each line.
    """

    table: Float[Array, "variables cells 4"]
    is_steep: Float[Array, "variables cells"]
    is_normal: Float[Array, "variables 1"]
    recurrence: Float[Array, "orders 3 variables"]
    factors: Int[Array, "factors terms"]
    normals: Float[Array, "variables replicates lines_of_one"]
    starts: Float[Array, "variables starts"]
    at_starts: Float[Array, "terms starts"]
    cloud: Cloud
    active: tuple[int, ...] = eqx.field(static=True)
    cells: int = eqx.field(static=True)

    @property
    def step(self) -> float:
        """The length of a cell, in standard deviations."""
        return 2 * END / self.cells

    @property
    def is_whole_lattice(self) -> bool:
        """Whether these are lines of few variables, for one output: all of a lattice."""
        variables, *count = self.normals.shape
        return ON_A_LATTICE.get(variables) == math.prod(count)

    def for_one_of(self, entries: int) -> "Lines":
        """Lines for one of the entries of a path: if there are many, fewer."""
        return self if entries <= SINGLE else self.coarser

    @property
    def coarser(self) -> "Lines":
        """Some replicates of the lines, or a sparser lattice."""
        _, normals = in_library(self.normals)
        if len(normals) > max(ON_A_LATTICE):
            return replace(self, normals=alike(normals[:, : REPLICATES // _COARSER], self.normals))
        if len(normals) > 1:
            normals = normals[:, 0].reshape(len(normals), _TURNS, -1)
        return replace(self, normals=alike(normals, self.normals), cells=max(self.cells // _COARSER, _FEWEST_CELLS))

    def first_of(self, cell: Int[Any, "*cells"]) -> Float[Any, "*cells"]:
        """Where a cell begins, in standard deviations."""
        return (cell - self.cells / 2) * self.step

    def terms(self, normal: Float[np.ndarray, "variables n"]) -> Float[np.ndarray, "terms n"]:
        """The terms of the basis at points of the normal variables, which may have imaginary parts."""
        return _products(self._polynomials(normal), np.asarray(self.factors))

    def values(
        self, coefficients: Float[np.ndarray, " terms"], normal: Float[np.ndarray, "variables n"]
    ) -> Float[np.ndarray, " n"]:
        """The expansion at points: products are needed of terms in several variables alone, that count."""
        flat, factors = self._polynomials(normal), np.asarray(self.factors)
        is_product = (factors > 0).sum(axis=0) > 1
        single = np.bincount(factors[:, ~is_product].max(axis=0, initial=0), coefficients[~is_product], len(flat))
        value = single @ flat
        counts = is_product & (np.abs(coefficients) > _NO_PART * np.linalg.norm(coefficients))
        if counts.any():
            value += coefficients[counts] @ _products(flat, factors[:, counts])
        return value

    def _polynomials(self, normal: Float[np.ndarray, "variables n"]) -> Float[np.ndarray, "polynomials n"]:
        """The polynomials of each variable by degree, the constant first."""
        germ, recurrence = self._germ(normal), np.asarray(self.recurrence)[..., None]
        every = np.ones((len(recurrence), *germ.shape), germ.dtype)
        for degree, (a, b, after) in enumerate(recurrence[:-1]):
            current = np.multiply(germ - a, every[degree], out=every[degree + 1])
            if degree:
                current -= b * every[degree - 1]
            current /= after
        return every.reshape(-1, germ.shape[1])

    def _germ(self, normal: Float[np.ndarray, "variables n"]) -> Float[np.ndarray, "variables n"]:
        others, germ = np.flatnonzero(np.asarray(self.is_normal) == 0), normal.copy()
        place = (normal[others] + LAST) * (TABLED / (2 * LAST))
        clipped = np.clip(place.real, 0.0, float(TABLED))
        cell = np.minimum(clipped.astype(int), TABLED - 1)
        cubic = np.asarray(self.table)[others[:, None], cell]
        germ[others] = horner(np.moveaxis(cubic, -1, 0), (clipped - cell + (place - place.real))[None])[0]
        return germ

    def minima(self, coefficients: Float[np.ndarray, " terms"]) -> Float[np.ndarray, "variables minima"]:
        """Directions in which the expansion is smallest at some distance, the best one first."""
        starts = np.asarray(self.starts)
        # Of equal values rounding would choose one, and jump from one design to the next.
        size = _EQUAL * np.linalg.norm(coefficients) or 1.0
        left, chosen = np.round(coefficients @ np.asarray(self.at_starts) / size), []
        for _ in range(MINIMA):
            chosen.append(starts[:, np.argmin(left)])
            left = np.where(chosen[-1] @ starts > _APART, np.inf, left)
        minima, values = np.stack(chosen, axis=1), np.zeros(MINIMA)
        variables = len(minima)
        steps = 1j * _IMAGINARY * np.eye(variables)[..., None]
        for _ in range(_DESCENTS):
            moved = (_SEARCHED * (minima[:, None] + steps)).reshape(variables, -1)
            heights = (coefficients @ self.terms(moved)).reshape(variables, MINIMA)
            minima, values = unit(minima - unit(np.imag(heights) / _IMAGINARY)), np.real(heights[0])
        return minima[:, np.argsort(np.round(values / size), kind="stable")]

    def axis(self, coefficients: Float[np.ndarray, " terms"]) -> Float[np.ndarray, "variables 1"]:
        """That of the variable in which the expansion has the largest linear part, in the sense in which it falls."""
        variables = len(self.table)
        # Places of factors begin with those of degree zero, which count nothing, then come the linear ones.
        place = np.asarray(self.factors).sum(axis=0)
        linear = np.bincount(place, coefficients, 2 * variables)[variables : 2 * variables]
        axis = np.argmax(np.abs(linear))
        return np.where(linear[axis] > 0, -1.0, 1.0) * np.eye(variables)[:, [axis]]


@final
class LinesInElements(Module):
    """Lines through each element of a piecewise basis, in normal variables of its own.

    `lines`: stacked, as coarse as those of paths; `cloud`: of the whole basis.
    """

    lines: Lines
    division: Division
    cloud: Cloud

    def for_one_of(self, entries: int) -> "LinesInElements":
        """The same for paths."""
        del entries
        return self


AnyLines: TypeAlias = Lines | LinesInElements


def placed(
    normals: Float[np.ndarray, "variables replicates lines_of_one"],
    direction: Float[np.ndarray, " variables"],
    centres: Float[np.ndarray, "variables minima"],
) -> tuple[Float[np.ndarray, "variables lines"], Float[np.ndarray, "replicates lines_of_one"]]:
    """Points of lines in the plane across their direction, and their weights."""
    variables, replicates, count = normals.shape
    # Householder's reflection of the last axis to the direction.
    mirror = unit(np.eye(variables)[:, -1:] - direction[:, None])[:, 0]
    flat = normals.reshape(variables, -1)
    flat = flat - 2 * np.outer(mirror, mirror @ flat)
    if variables <= max(ON_A_LATTICE):
        distance = np.maximum(np.sqrt(np.sum(normals**2, axis=0)), _NEAREST)
        even = np.arcsinh(distance)
        weights = np.exp(-(distance**2) / 2) * np.cosh(even) * (distance / even) ** (variables - 2)
        return flat, weights * (replicates / np.sum(weights))
    sizes = np.array(_SIZES)
    spreads = np.array([1.0, *(np.sqrt(1 + reach**2 / variables) for reach in _REACHES), *[1.0] * MINIMA])
    across = centres - np.outer(direction, direction @ centres)
    middles = np.concatenate([np.zeros((variables, 1 + len(_REACHES))), across], axis=1)
    which = np.tile(np.repeat(np.arange(len(sizes)), sizes), replicates)
    points = middles[:, which] + spreads[which][None] * flat
    distances = np.sum((points[:, None] - middles[..., None]) ** 2, axis=0)
    logs = -distances / (2 * spreads[:, None] ** 2) + np.log(sizes / spreads ** (variables - 1))[:, None]
    # The largest first, so that nothing overflows.
    parts = np.exp(logs - logs.max(axis=0, keepdims=True))
    weights = (parts[0] / np.sum(parts, axis=0)).reshape(replicates, count)
    return points, weights * (replicates / np.sum(weights))


def _products(
    flat: Float[np.ndarray, "polynomials n"], factors: Int[np.ndarray, "factors terms"]
) -> Float[np.ndarray, "terms n"]:
    """The products of some terms' factors."""
    product = flat[factors[0]]
    for others in factors[1:]:
        product *= flat[others]
    return product


def unit(vectors: Float[np.ndarray, "variables n"]) -> Float[np.ndarray, "variables n"]:
    """Columns of length one; those of no length stay."""
    length = np.sqrt(np.sum(vectors**2, axis=0, keepdims=True))
    return vectors / np.where(length > 0, length, 1.0)


def refuse_steps(basis: AbstractBasis) -> None:
    """Raise `ProblemError` if a germ variable takes discrete values only, with none in between."""
    steps = [name for name, germ in basis.germs.items() if isinstance(germ, SampleGerm)]
    if steps:
        raise ProblemError(
            f"Quantiles, probabilities and their like of an expansion need distributions with a density; received a "
            f"sample of data for '{steps[0]}', which takes single values. Fit a distribution, give an al.Density, or "
            "take al.references.monte_carlo and al.validate."
        )


def lines_through(basis: AbstractBasis) -> AnyLines:
    """Preparation: lines through the normal variables of a basis, for the distribution of an output."""
    refuse_steps(basis)
    if isinstance(basis, PiecewiseBasis):
        division, lines = in_each(lambda piece: _lines(piece).coarser, basis)
        return LinesInElements(lines, division, _cloud_of(basis, list(range(basis.variables))))
    return _lines(basis)


def _lines(basis: AbstractBasis) -> Lines:
    # A constant output needs a variable too.
    active = [i for i, degree in enumerate(basis.degrees) if degree > 0] or [0][: basis.variables]
    germs: list[AbstractGerm] = [list(basis.germs.values())[i] for i in active] or [HermiteGerm()]
    indices = basis.indices[:, active] if active else np.zeros((basis.terms, 1), dtype=int)
    orders = int(indices.max(initial=0)) + 1
    starts, recurrences = _starts(len(germs)), [germ.recurrence(orders) for germ in germs]
    tables, steep = zip(*map(table_of, germs), strict=True)
    return Lines(
        table=jax_array(np.stack(tables)),
        is_steep=jax_array(np.stack(steep)),
        is_normal=jax_array([[float(isinstance(germ, HermiteGerm))] for germ in germs]),
        recurrence=jax_array(np.stack([[a[:-1], b[:-1], b[1:]] for a, b in recurrences], axis=-1).swapaxes(0, 1)),
        factors=jax_array(_factors(indices)),
        normals=jax_array(_normals(len(germs))),
        starts=jax_array(starts),
        at_starts=jax_array(_at(basis, active, _SEARCHED * starts)),
        cloud=_cloud_of(basis, active),
        active=tuple(active),
        cells=_CELLS.get(len(germs), _FEWEST_CELLS),
    )


def _cloud_of(basis: AbstractBasis, active: list[int]) -> Cloud:
    """Points of the germ variables, as even as can be."""
    variables = max(len(active), 1)
    if variables == 1:
        levels = (np.arange(_POINTS)[:, None] + 0.5) / _POINTS
    else:
        levels = scipy.stats.qmc.Sobol(variables, bits=30, rng=np.random.default_rng(len(_SIZES))).random(_POINTS)
    terms = _at(basis, active, scipy.special.ndtri(levels + 2.0**-31).T)
    return Cloud(jax_array(terms), width=min(_WIDEST, _WIDTH * _POINTS ** (-0.5 / variables)))


def _at(
    basis: AbstractBasis, active: list[int], normal: Float[np.ndarray, "variables n"]
) -> Float[np.ndarray, "terms n"]:
    """The terms of a basis at points of the active normal variables, the middle of the others."""
    levels = np.full((normal.shape[1], basis.variables), 0.5)
    levels[:, active] = scipy.special.ndtr(normal).T[:, : len(active)]
    return basis.matrix(basis.map_to_germ(levels)).T


def _factors(indices: Int[np.ndarray, "terms variables"]) -> Int[np.ndarray, "factors terms"]:
    """The places of each term's factors among the polynomials by degree and variable; 0 is a constant."""
    variables = indices.shape[1]
    most = max(int((indices > 0).sum(axis=1).max(initial=0)), 1)
    places = np.zeros((most, len(indices)), dtype=int)
    for term, degrees in enumerate(indices):
        own = [int(degree) * variables + i for i, degree in enumerate(degrees) if degree > 0]
        places[: len(own), term] = own
    return places


def _normals(variables: int) -> Float[np.ndarray, "variables replicates lines_of_one"]:
    """Scrambled Sobol nets (Owen, 1995), of which each replicate is a part, or a lattice, across the last axis."""
    if variables == 1:
        return np.zeros((1, 1, 1))
    if variables in ON_A_LATTICE:
        across = _lattice(variables - 1, ON_A_LATTICE[variables])
    else:
        parts = []
        for seed, size in enumerate(_SIZES):
            net = scipy.stats.qmc.Sobol(variables - 1, bits=30, rng=np.random.default_rng(seed))
            # Scrambled points are multiples of 2^-30, 0 among them.
            levels = net.random_base2(int(np.log2(REPLICATES * size))) + 2.0**-31
            parts.append(scipy.special.ndtri(levels).T.reshape(variables - 1, REPLICATES, size))
        across = np.concatenate(parts, axis=2)
    return np.concatenate([across, np.zeros((1, *across.shape[1:]))])


def _lattice(axes: int, lines: int) -> Float[np.ndarray, "axes turns lines_of_one"]:
    """A lattice of one or two axes for the trapezoidal rule, stretched so that it is denser around the origin.

    Its projection onto either axis is even (Frolov, 1976). Each turn is a sparser lattice, and so is a quarter of one.
    """
    apart = round(_TURNS ** (1 / axes))
    reach, golden = math.isqrt(lines) if axes == 2 else lines, (math.sqrt(5) - 1) / 2
    index = np.indices([2 * reach] * axes).reshape(axes, -1) - reach
    points = np.array([[1.0, -golden], [golden, 1.0]])[:axes, :axes] @ index
    nearest = np.argsort(np.linalg.norm(points, axis=0), kind="stable")
    index, points = index[:, nearest], points[:, nearest]
    part = np.ravel_multi_index((*(index % apart), *(index // apart % apart)), [apart] * 2 * axes)
    parts = [points[:, part == k][:, : lines // _TURNS**2] for k in range(_TURNS**2)]
    points = np.concatenate(parts, axis=1)
    distance = np.maximum(np.linalg.norm(points, axis=0), _NEAREST)
    even = distance * (math.asinh(END) / distance.max())
    return (points * np.sinh(even) / distance).reshape(axes, _TURNS, -1)


def _starts(variables: int) -> Float[np.ndarray, "variables starts"]:
    """Directions along each variable, and some between them."""
    between = np.random.default_rng(0).standard_normal((variables, _STARTS))
    axes = np.eye(variables)
    every = np.concatenate([axes, -axes, between], axis=1)
    return every / np.linalg.norm(every, axis=0)
