"""Lines through the germ space, along which an expansion is a polynomial of one variable.

Probabilities of an output are integrals of a step function, which points alone resolve poorly. Along a line the
integral between the crossings of a threshold is exact, and the average over the lines is that of a smooth function
(Griewank, Kuo, Leövey and Sloan, 2018, High dimensional integration of kinks and jumps). Lines run along each variable
in turn. Standard normal variables may be rotated: their lines run along the direction in which the output varies most,
so that every single line gives the exact result for an output that is linear in normal variables.
"""

from typing import final

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

from aleator._core.arrays import jax_array
from aleator._core.errors import ProblemError
from aleator._core.module import Module
from aleator.expansion import Basis
from aleator.statistics._line_distribution import LineDistribution, line_distribution
from aleator.statistics._moments import root
from aleator.uncertainty import HermiteGerm, LegendreGerm, SampleGerm

# Lines for a single number; many numbers at once share fewer, see `_output_distribution`.
_LINES = 2**14

# How much lines through normal variables are preferred to others of the same share: they determine the tails.
_NORMAL_PREFERENCE = 10.0

# The higher this is, the less weight lines have along which the output hardly varies.
_SHARPNESS = 3


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
    one = jnp.ones((1, 1, 1))
    return Lines(one, one, None, jnp.zeros((1, 1)), jnp.ones(1), line_distribution([LegendreGerm()], 1))


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
        at = np.array([place.get(tuple(one), -1) for one in higher.tolist()])
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
        new = [one for one in lower if one not in known]
        known.update(dict.fromkeys(new))
        waiting += new
    return np.array(list(known), dtype=int).reshape(len(known), indices.shape[1])
