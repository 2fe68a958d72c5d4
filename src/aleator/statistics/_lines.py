"""Lines through the space of normal variables, along which the distribution of an output is integrated.

Probabilities of an output are integrals of a step function, which points alone resolve poorly. Along a line the
integral is that of a function of one variable, exact between the crossings of a threshold, and the average over the
lines is that of a smooth function (Griewank, Kuo, Leövey and Sloan, 2018, High dimensional integration of kinks and
jumps). Every germ variable is a function of a standard normal one, at equal probability. Lines run in the direction in
which the output is smallest at a distance of some standard deviations, so that a single line gives the result for an
output that is nearly linear in the tail. Across it, lines of two or three variables lie on a lattice, whose error falls
exponentially for smooth outputs; where these err, others run along a variable (`KnownDistribution`). Others lie where a
mixture of normal distributions puts them: the given one, two wider ones, and one around each of several such minima;
the ratio of the densities is the weight of a line (importance sampling; Owen and Zhou, 2000, on mixtures that keep the
given distribution).
"""

import math
from dataclasses import replace
from typing import Any, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

from aleator._core.arrays import in_library, jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.expansion import AbstractBasis, Division, PiecewiseBasis, in_each
from aleator.statistics._cubics import END, LAST, TABLED, cubics_through, horner, table_of
from aleator.uncertainty import AbstractGerm, HermiteGerm, SampleGerm

# Lines of one replicate by the distribution that places them: the given one, two wider ones, and one around each
# minimum. All are powers of two: with the replicates, each has a digital net of its own.
_SIZES, MINIMA = (128, 64, 32, 8, 8, 8, 8), 4
REPLICATES = 8

# Distances from the origin, in standard deviations: one tail probability in 4000, in 30 000, and the reach of the two
# wider distributions.
SEARCHED, CENTRE, _REACHES = 3.5, 4.0, (3.0, 5.0)
DESCENTS, _STARTS = 12, 64
APART = 0.7  # cosine between minima that are told apart
# Directions are rounded to this, so that lines rest in the last steps of a search for an optimum, and values follow
# their derivatives there, in which lines rest. A step of the directions changes the error of an integral alone, by
# about a thousandth of itself.
STILL = 2.0**-10

# Cells of a line by the number of variables.
_CELLS, _FEWEST_CELLS = {1: 4096, 2: 150}, 33
# Lines on a lattice by the number of variables; its replicates; of how many lines one is taken for paths; a distance
# that counts as none.
ON_A_LATTICE, _TURNS, _COARSER, _NEAREST = {2: 512, 3: 2048}, 4, 4, 1e-9

# Paths of more entries than this are evaluated by fewer lines, and in part by points.
SINGLE = 4
# Points for the entries of paths, a power of two, and their width: its most, which makes no more of an error at a level
# of 0.9 than the points do, and what it is in proportion to, so that points of one variable are hardly spread out.
_POINTS, _WIDEST, _WIDTH = 512, 0.85, 1.6

# So many points are evaluated at once, for the cache.
_TOGETHER = 2**11


@final
class LineValues(Module):
    """An output along lines that are chosen for its small values.

    - `points`: in the normal variables: where each line passes the origin's plane, shape (variables, lines);
    - `direction`: of all lines; `weights`: of each line, with sum one in each replicate;
    - `cubics`: the output in each cell by powers of the place in it, from 0 to 1.
    """

    points: Float[Array, "variables lines"]
    direction: Float[Array, " variables"]
    weights: Float[Array, "replicates lines_of_one"]
    cubics: Float[Array, "4 lines cells"]


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
    def orders(self) -> int:
        """How many polynomials of one variable there are."""
        return len(self.recurrence)

    @property
    def step(self) -> float:
        """The length of a cell, in standard deviations."""
        return 2 * END / self.cells

    def for_one_of(self, entries: int) -> "Lines":
        """Lines for one of the entries of a path: if there are many, fewer."""
        return self if entries <= SINGLE else self.coarser

    @property
    def coarser(self) -> "Lines":
        """Some replicates of the lines, or a sparser lattice."""
        _, normals = in_library(self.normals)
        if len(normals) > max(ON_A_LATTICE):
            return replace(self, normals=jax_array(normals[:, : REPLICATES // _COARSER]))
        if len(normals) > 1:
            normals = normals[:, 0].reshape(len(normals), _TURNS, -1)
        return replace(self, normals=jax_array(normals), cells=max(self.cells // _COARSER, _FEWEST_CELLS))

    def values(self, coefficients: Float[Array, " terms"], normal: Float[Array, "variables n"]) -> Float[Array, " n"]:
        """The expansion at points of the normal variables."""
        count = normal.shape[1]
        if count <= _TOGETHER:
            return coefficients @ self._terms(normal)
        blocks = -(-count // _TOGETHER)
        filled = jnp.pad(normal, ((0, 0), (0, blocks * _TOGETHER - count)), mode="edge")
        split = jnp.moveaxis(filled.reshape(len(normal), blocks, _TOGETHER), 1, 0)
        return jax.lax.map(lambda some: coefficients @ self._terms(some), split).ravel()[:count]

    def _terms(self, normal: Float[Array, "variables n"]) -> Float[Array, "terms n"]:
        germ = self._germ(normal)

        def following(
            state: tuple[Array, Array], row: Float[Array, "3 variables"]
        ) -> tuple[tuple[Array, Array], Array]:
            previous, current = state
            a, b, after = row[..., None]
            return (current, ((germ - a) * current - b * previous) / after), current

        _, polynomials = jax.lax.scan(following, (jnp.zeros(germ.shape), jnp.ones(germ.shape)), self.recurrence)
        flat = polynomials.reshape(-1, germ.shape[1])
        product = flat[self.factors[0]]
        for others in self.factors[1:]:
            product = product * flat[others]
        return product

    def _germ(self, normal: Float[Array, "variables n"]) -> Float[Array, "variables n"]:
        place = jnp.clip((normal + LAST) * (TABLED / (2 * LAST)), 0.0, float(TABLED))
        cell = jnp.minimum(place.astype(int), TABLED - 1)
        cubic = self.table[jax.lax.broadcasted_iota(int, cell.shape, 0), cell]
        return jnp.where(self.is_normal > 0, normal, horner(jnp.moveaxis(cubic, -1, 0), (place - cell)[None])[0])

    def first_of(self, cell: Int[Any, "*cells"]) -> Float[Any, "*cells"]:
        """Where a cell begins, in standard deviations."""
        return (cell - self.cells / 2) * self.step

    def along(self, coefficients: Float[Array, " terms"]) -> LineValues:
        """An output with mean zero along lines for its small values."""
        minima = jax.lax.stop_gradient(self.minima(coefficients))
        minima = unit(jnp.round(minima / STILL) * STILL)
        direction = minima[:, 0]
        points, weights = placed(self.normals, direction, CENTRE * minima)
        # Slopes at the ends of cells take two more nodes beyond either end.
        places = self.first_of(jnp.arange(-2, self.cells + 3))
        nodes = points[..., None] + direction[:, None, None] * places[None, None]
        values = self.values(coefficients, nodes.reshape(len(points), -1)).reshape(nodes.shape[1:])
        return LineValues(points, direction, weights, cubics_through(values))

    def minima(self, coefficients: Float[Array, " terms"]) -> Float[Array, "variables minima"]:
        """Directions in which the expansion is smallest at some distance, the best one first."""

        def chosen(left: Float[Array, " starts"], _: None) -> tuple[Array, Array]:
            best = self.starts[:, jnp.argmin(left)]
            return jnp.where(best @ self.starts > APART, jnp.inf, left), best

        def heights(at: Float[Array, "variables minima"]) -> tuple[Array, Array]:
            values = self.values(coefficients, SEARCHED * at)
            return jnp.sum(values), values

        def descend(_: int, state: tuple[Array, Array]) -> tuple[Array, Array]:
            slope, values = jax.grad(heights, has_aux=True)(state[0])
            return unit(state[0] - unit(slope)), values

        starts = jax.lax.scan(chosen, coefficients @ self.at_starts, None, MINIMA)[1].T
        minima, values = jax.lax.fori_loop(0, DESCENTS, descend, (starts, jnp.zeros(MINIMA)))
        return minima[:, jnp.argsort(values)]


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
    normals: Float[Any, "variables replicates lines_of_one"],
    direction: Float[Any, " variables"],
    centres: Float[Any, "variables minima"],
) -> tuple[Float[Any, "variables lines"], Float[Any, "replicates lines_of_one"]]:
    """Points of lines in the plane across their direction, and their weights."""
    library, normals, direction, centres = in_library(normals, direction, centres)
    variables, replicates, count = normals.shape
    # Householder's reflection of the last axis to the direction.
    mirror = unit(np.eye(variables)[:, -1:] - direction[:, None])[:, 0]
    flat = normals.reshape(variables, -1)
    flat = flat - 2 * library.outer(mirror, mirror @ flat)
    if variables <= max(ON_A_LATTICE):
        distance = library.maximum(library.sqrt(library.sum(normals**2, axis=0)), _NEAREST)
        even = library.arcsinh(distance)
        weights = library.exp(-(distance**2) / 2) * library.cosh(even) * (distance / even) ** (variables - 2)
        return flat, weights * (replicates / library.sum(weights))
    sizes = np.array(_SIZES)
    spreads = np.array([1.0, *(np.sqrt(1 + reach**2 / variables) for reach in _REACHES), *[1.0] * MINIMA])
    across = centres - library.outer(direction, direction @ centres)
    middles = library.concatenate([library.zeros((variables, 1 + len(_REACHES))), across], axis=1)
    which = np.tile(np.repeat(np.arange(len(sizes)), sizes), replicates)
    points = middles[:, which] + spreads[which][None] * flat
    distances = library.sum((points[:, None] - middles[..., None]) ** 2, axis=0)
    logs = -distances / (2 * spreads[:, None] ** 2) + np.log(sizes / spreads ** (variables - 1))[:, None]
    # The largest first, so that nothing overflows.
    parts = library.exp(logs - logs.max(axis=0, keepdims=True))
    weights = (parts[0] / library.sum(parts, axis=0)).reshape(replicates, count)
    return points, weights * (replicates / library.sum(weights))


def unit(vectors: Float[Any, "variables n"]) -> Float[Any, "variables n"]:
    """Columns of length one; those of no length stay."""
    library, vectors = in_library(vectors)
    length = library.sqrt(library.sum(vectors**2, axis=0, keepdims=True))
    return vectors / library.where(length > 0, length, 1.0)


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
        at_starts=jax_array(_at(basis, active, SEARCHED * starts)),
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
