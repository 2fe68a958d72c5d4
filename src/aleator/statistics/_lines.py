"""Lines through the germ space, along which an expansion is a polynomial of one variable.

Probabilities of an output are integrals of a step function, which points alone resolve poorly. Along a line the
integral between the crossings of a threshold is exact, and the average over the lines is that of a smooth function
(Griewank, Kuo, Leövey and Sloan, 2018, High dimensional integration of kinks and jumps). Lines run along each variable
in turn. Standard normal variables may be rotated: their lines run along the direction in which the output varies most,
so that every single line gives the exact result for an output that is linear in normal variables.
"""

from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

from aleator._core.arrays import jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.expansion import Basis
from aleator.statistics._statistic import root
from aleator.uncertainty import AbstractGerm, HermiteGerm, LegendreGerm, SampleGerm

# Lines for a single number; many numbers at once share fewer, see `_output_distribution`.
_LINES = 2**14

# How much lines through normal variables are preferred to others of the same share: they determine the tails.
_NORMAL_PREFERENCE = 10.0

# The higher this is, the less weight lines have along which the output hardly varies.
_SHARPNESS = 3

_CELLS = 2048
_POWER = 4  # two square roots, see `LineDistribution`

# Unbounded distributions are cut where double precision cannot tell the distribution function from 0 or 1.
_LEAST_LEVEL = 2.0**-53

# Keeps the derivative of the root finite at the ends, where it is not used.
_LEAST_DISTANCE = 1e-60


@final
class LineDistribution(Module):
    """The distributions of several variables, each scaled to [-1, 1], with `orders` polynomials of each.

    A germ has its distribution function in NumPy only. Here it is tabulated on an interval, `x` from -1 to 1, together
    with the partial moments `G_k(x)`, the integrals of the orthonormal polynomials `p_k` over the probability up to `x`
    (`G_0` is the distribution function). Tables are cubic splines in the fourth root of the distance from the nearer
    end, in which distributions with a singular density at an end (Beta, Gamma) are smooth. Their error is below 1e-9.

    - `table`: of the partial moments, shape (variables, 2 ends, cells, 4, orders);
    - `monomials[v, k, m]`: the coefficient of `x^m` in `p_k`;
    - `from_powers[v, m, k]`: powers of the germ variable itself as sums of `p_k`.
    """

    table: Float[Array, "variables 2 cells 4 orders"]
    monomials: Float[Array, "variables orders orders"]
    from_powers: Float[Array, "variables orders orders"]

    def partial_moments(self, x: Float[Array, "*points variables lines"], orders: int) -> Float[Array, "..."]:
        """`G_k(x)` for the first `orders` polynomials, along a new last axis. Not differentiable."""
        cubic, within, _ = self._spline(x, orders)
        return _value(jnp.moveaxis(cubic, -2, 0), within[..., None])

    def level_and_density(self, x: Float[Array, "*points variables lines"]) -> tuple[Array, Array]:
        """The distribution function, and the probability density with respect to the scaled variable `x`."""
        cubic, within, root = self._spline(x, 1)
        cubic = jnp.moveaxis(cubic[..., 0], -1, 0)
        by_root = (3 * cubic[0] * within + 2 * cubic[1]) * within + cubic[2]
        density = -jnp.where(x > 0, 1.0, -1.0) * by_root * _CELLS / (_POWER * root ** (_POWER - 1))
        return _value(cubic, within), density

    def _spline(self, x: Array, orders: int) -> tuple[Array, Array, Array]:
        """For each point: the cubic's coefficients in its cell, its place in the cell, and the root of its distance."""
        root = jnp.sqrt(jnp.sqrt(jnp.maximum(1 - jnp.abs(x), _LEAST_DISTANCE)))
        cell = jnp.clip((root * _CELLS).astype(int), 0, _CELLS - 1)
        variable = jax.lax.broadcasted_iota(int, x.shape, x.ndim - 2)
        return self.table[variable, (x > 0).astype(int), cell, :, :orders], root * _CELLS - cell, root


def _value(cubic: Float[Array, "4 ..."], within: Array) -> Array:
    return ((cubic[0] * within + cubic[1]) * within + cubic[2]) * within + cubic[3]


def line_distribution(germs: list[AbstractGerm], orders: int) -> LineDistribution:
    """Tabulate the distributions of some germ variables."""
    ends = [finite_ends(germ) for germ in germs]
    both = list(zip(germs, ends, strict=True))
    monomials = [_monomials(germ, *end, orders) for germ, end in both]
    powers = [np.linalg.inv(_monomials(germ, -1.0, 1.0, orders)) for germ in germs]
    table = [_table(germ, *end, orders) for germ, end in both]
    return LineDistribution(*(jax_array(np.stack(parts)) for parts in (table, monomials, powers)))


def finite_ends(germ: AbstractGerm) -> tuple[float, float]:
    """The support of a germ; an unbounded one is cut at a level of 1e-16."""
    low, high = germ.support()
    if np.isinf(low):
        low = float(germ.quantile(np.array(_LEAST_LEVEL)))
    if np.isinf(high):
        high = float(germ.quantile(np.array(1 - _LEAST_LEVEL)))
    return low, high


def _monomials(germ: AbstractGerm, low: float, high: float, orders: int) -> Float[np.ndarray, "orders orders"]:
    """The coefficients of the orthonormal polynomials by powers of `x`, where `low` is -1 and `high` is 1."""
    a, b = germ.recurrence(orders)
    middle, half = (low + high) / 2, (high - low) / 2
    rows = np.zeros((orders + 1, orders))
    rows[0, 0] = 1.0
    for n in range(orders - 1):
        times_x = np.concatenate([[0.0], rows[n, :-1]])
        rows[n + 1] = (half * times_x + (middle - a[n]) * rows[n] - b[n] * rows[n - 1]) / b[n + 1]
    return rows[:orders]


def _table(germ: AbstractGerm, low: float, high: float, orders: int) -> Float[np.ndarray, "2 cells 4 orders"]:
    """Splines of the partial moments from either end to the middle, by the root of the distance from that end.

    By parts, `G_k = p_k F - integral of F p_k'` for the distribution function `F`, and so for `1 - F` from above. The
    integral is taken by Gauss quadrature in each cell.
    """
    roots = np.linspace(0.0, 1.0, _CELLS + 1)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    inner = (roots[:-1, None] + (nodes + 1) / (2 * _CELLS)).ravel()
    half = (high - low) / 2
    splines = []
    for end, sign in ((low, 1.0), (high, -1.0)):
        at, between = (end + sign * half * root**_POWER for root in (roots, inner))
        steps = half * _POWER * inner ** (_POWER - 1) * np.tile(weights, _CELLS) / (2 * _CELLS)
        beyond = _beyond(germ, at, sign)[:, None] * _with_slopes(germ, at, orders)[0]
        parts = (steps * _beyond(germ, between, sign))[:, None] * _with_slopes(germ, between, orders)[1]
        sums = np.concatenate([np.zeros((1, orders)), parts.reshape(_CELLS, 4, orders).sum(axis=1).cumsum(axis=0)])
        moments = beyond - sign * sums
        total = (np.arange(orders) == 0).astype(float)
        values = moments if sign > 0 else total - moments
        # The unit of length is a cell, not the whole interval.
        scale = float(_CELLS) ** -np.arange(3, -1, -1)
        splines.append(np.moveaxis(scipy.interpolate.CubicSpline(roots, values).c * scale[:, None, None], 0, 1))
    return np.stack(splines)


def _beyond(germ: AbstractGerm, at: Float[np.ndarray, " n"], sign: float) -> Float[np.ndarray, " n"]:
    """The probability between an end of the support and some germ values."""
    level = germ.cumulative(at)
    return level if sign > 0 else 1 - level


def _with_slopes(germ: AbstractGerm, at: Float[np.ndarray, " n"], orders: int) -> tuple[np.ndarray, np.ndarray]:
    """The orthonormal polynomials and their derivatives, each of shape (n, orders)."""
    a, b = germ.recurrence(orders)
    values = germ.polynomials(orders - 1, at)
    slopes = np.zeros(values.shape)
    for n in range(orders - 1):
        slopes[:, n + 1] = (values[:, n] + (at - a[n]) * slopes[:, n] - b[n] * slopes[:, n - 1]) / b[n + 1]
    return values, slopes


@final
class Rotation(Module):
    """Lines through the standard normal variables along a direction that depends on the coefficients.

    Derivatives of an expansion in Hermite polynomials are expansions in the same polynomials. So the Taylor series
    along a line follows from the values of the polynomials at one point of it.

    - `points`: normal variables of a point on each line; `matrix`: the basis polynomials there;
    - `raised`, `factors`: the derivative by variable `i` has the coefficients `factors[i] * c[raised[i]]`;
    - `linear`, `contributing`: one where a term is variable `i` itself, or depends on it.
    """

    points: Float[Array, "lines normals"]
    matrix: Float[Array, "lines terms"]
    raised: Int[Array, "normals terms"]
    factors: Float[Array, "normals terms"]
    linear: Float[Array, "normals terms"]
    contributing: Float[Array, "normals terms"]

    def direction(self, coefficients: Float[Array, " terms"]) -> Float[Array, " normals"]:
        """The mean gradient; nonlinear variables weigh more, so that they count even if their mean slope is zero."""
        gradient = self.linear @ coefficients
        variance = self.contributing @ coefficients**2
        std = root(jnp.sum(coefficients[1:] ** 2))
        raw = gradient + (variance - gradient**2) / jnp.where(std > 0, std, 1.0)
        length = root(jnp.sum(raw**2))
        first = jnp.zeros(len(raw)).at[0].set(1.0)
        return jnp.where(length > 0, raw / jnp.where(length > 0, length, 1.0), first)

    def powers(self, coefficients: Float[Array, " terms"], degree: int, lines: int) -> Float[Array, "orders lines"]:
        """The expansion along each line, by powers of the standard normal variable along it."""
        # The derivatives have more terms than the expansion where the basis lacks divisors of its terms.
        coefficients = jnp.pad(coefficients, (0, self.matrix.shape[1] - len(coefficients)))
        direction = self.direction(coefficients)
        taylor = [coefficients]
        for order in range(1, degree + 1):
            slopes = self.factors * taylor[-1][self.raised]
            taylor.append(direction @ slopes / order)
        rows = list(jnp.stack(taylor) @ self.matrix[:lines].T)
        # Shift the powers: from the distance from the point to the distance from the foot of the origin.
        at = self.points[:lines] @ direction
        for done in range(degree):
            for order in range(degree - 1, done - 1, -1):
                rows[order] = rows[order] - at * rows[order + 1]
        return jnp.stack(rows)


@final
class Lines(Module):
    """Lines along some directions: one for each non-normal variable, and one for all normal variables together.

    - `others`: the basis polynomials without the factor of the line's own variable, shape (variables, lines, terms);
    - `degrees`: one where a term has degree `k` in that variable, shape (variables, orders, terms);
    - `rotation`: the lines through the normal variables, the last direction; None if there are none;
    - `contributing`: one where a term varies along a direction; `preference`: of each direction;
    - `distribution`: of the variable along each direction.
    """

    others: Float[Array, "variables lines terms"]
    degrees: Float[Array, "variables orders terms"]
    rotation: Rotation | None
    contributing: Float[Array, "directions terms"]
    preference: Float[Array, " directions"]
    distribution: LineDistribution

    def weights(self, coefficients: Float[Array, " terms"]) -> Float[Array, " directions"]:
        """The weight of each direction: they add up to one, and are zero for lines along which nothing varies."""
        shares = self.contributing @ coefficients**2 * self.preference
        largest = jnp.max(shares)
        raw = (shares / jnp.where(largest > 0, largest, 1.0)) ** _SHARPNESS
        total = jnp.sum(raw)
        return jnp.where(total > 0, raw / jnp.where(total > 0, total, 1.0), 1 / len(raw))

    def polynomials(self, coefficients: Float[Array, " terms"], lines: int) -> Float[Array, "orders directions lines"]:
        """The expansion along the first `lines` lines of each direction, in their orthonormal polynomials."""
        orders = self.distribution.monomials.shape[1]
        by_degree = self.degrees * coefficients[None, None]
        along = jnp.einsum("vkt,vnt->kvn", by_degree, self.others[:, :lines])
        if self.rotation is None:
            return along
        powers = self.rotation.powers(coefficients, orders - 1, lines)
        rotated = jnp.einsum("mk,mn->kn", self.distribution.from_powers[-1], powers)
        return jnp.concatenate([along, rotated[:, None]], axis=1)

    @property
    def count(self) -> int:
        """How many lines there are along each direction."""
        return self.others.shape[1] if self.rotation is None else len(self.rotation.points)


def refuse_steps(basis: Basis) -> None:
    """Raise `ProblemError` if a germ variable takes discrete values only, with none in between."""
    steps = [name for name, germ in basis.germs.items() if isinstance(germ, SampleGerm)]
    if steps:
        raise ProblemError(
            f"Quantiles, probabilities and their like of an expansion need distributions with a density; received a "
            f"sample of data for '{steps[0]}', which takes single values. Fit a distribution, give an al.Density, or "
            "take al.references.monte_carlo and al.validate."
        )


def lines_through(basis: Basis) -> Lines:
    """Preparation: lines through the germ of a basis, for the distribution of an output."""
    refuse_steps(basis)
    active = [i for i, degree in enumerate(basis.degrees) if degree > 0]
    if not active:
        return _nowhere()
    germs = list(basis.germs.values())
    normal = [i for i in active if isinstance(germs[i], HermiteGerm)]
    single = [i for i in active if i not in normal]
    directions = [[i] for i in single] + ([normal] if normal else [])
    orders = 1 + max(int(basis.indices[:, group].sum(axis=1).max()) for group in directions)
    # Each direction has its own points: their errors then average out.
    points = [_points(basis, active, len(directions), seed) for seed in range(len(directions))]
    without = [_without(basis, i, at) for i, at in zip(single, points, strict=False)]
    by_degree = [basis.indices[:, i] == np.arange(orders)[:, None] for i in single]
    terms = basis.terms
    return Lines(
        others=jax_array(np.reshape(without, (len(single), len(points[0]), terms))),
        degrees=jax_array(np.reshape(by_degree, (len(single), orders, terms)), float),
        rotation=_rotation(basis, normal, points[-1]) if normal else None,
        contributing=jax_array([np.any(basis.indices[:, group] > 0, axis=1) for group in directions], float),
        preference=jax_array([1.0] * len(single) + [_NORMAL_PREFERENCE] * bool(normal)),
        distribution=line_distribution([germs[group[0]] for group in directions], orders),
    )


def _nowhere() -> Lines:
    """For constant outputs: one line along which nothing varies."""
    ones = jnp.ones((1, 1, 1))
    return Lines(ones, ones, None, jnp.zeros((1, 1)), jnp.ones(1), line_distribution([LegendreGerm()], 1))


def _points(basis: Basis, active: list[int], directions: int, seed: int) -> Float[np.ndarray, "lines variables"]:
    """A point on each line: a scrambled Sobol net (Owen, 1995) in the active variables, the middle in the others."""
    levels = np.full((1, basis.variables), 0.5)
    if len(active) > 1:
        size = int(np.log2(_LINES / directions))
        net = scipy.stats.qmc.Sobol(len(active), bits=30, rng=np.random.default_rng(seed)).random_base2(size)
        levels = np.full((len(net), basis.variables), 0.5)
        # Scrambled points are multiples of 2^-30, 0 among them.
        levels[:, active] = net + 2.0**-31
    return basis.map_to_germ(levels)


def _without(basis: Basis, variable: int, points: np.ndarray) -> Float[np.ndarray, "lines terms"]:
    """The basis polynomials without the factor of one variable."""
    indices = basis.indices.copy()
    indices[:, variable] = 0
    return Basis(basis.germs, indices).matrix(points)


def _rotation(basis: Basis, normal: list[int], points: np.ndarray) -> Rotation:
    """The derivatives of each term by the normal variables, `p_n' = sqrt(n) p_{n-1}`, as maps of coefficients."""
    closed = Basis(basis.germs, _with_divisors(basis.indices, normal))
    place = {tuple(row): t for t, row in enumerate(closed.indices.tolist())}
    raised = np.zeros((len(normal), closed.terms), dtype=int)
    factors = np.zeros((len(normal), closed.terms))
    for row, variable in enumerate(normal):
        higher = closed.indices.copy()
        higher[:, variable] += 1
        at = np.array([place.get(tuple(term), -1) for term in higher.tolist()])
        raised[row], factors[row] = np.maximum(at, 0), np.where(at >= 0, np.sqrt(higher[:, variable]), 0.0)
    varies = closed.indices[:, normal].T > 0
    linear = varies & (closed.indices.sum(axis=1) == 1)
    columns = (points[:, normal], closed.matrix(points), raised, factors, linear.astype(float), varies.astype(float))
    return Rotation(*map(jax_array, columns))


def _with_divisors(
    indices: Int[np.ndarray, "terms variables"], variables: list[int]
) -> Int[np.ndarray, "more variables"]:
    """The terms, followed by missing ones that arise when a degree of these variables is lowered."""
    known = dict.fromkeys(map(tuple, indices.tolist()))
    waiting = list(known)
    while waiting:
        term = waiting.pop()
        lower = [(*term[:i], term[i] - 1, *term[i + 1 :]) for i in variables if term[i] > 0]
        new = [divisor for divisor in lower if divisor not in known]
        known.update(dict.fromkeys(new))
        waiting += new
    return np.array(list(known), dtype=int).reshape(len(known), indices.shape[1])
