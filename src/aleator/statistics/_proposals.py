"""Mixtures of normal distributions that draw systems from tails, with weights for what they stand for.

Every germ variable is a function of a standard normal one, at equal probability, and points are those of the normals.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

from aleator._core.arrays import jax_array
from aleator.expansion import AbstractBasis
from aleator.statistics._lines import AnyLines, Lines

# Of a proposal for one tail: the share of the given distribution, and the least and the greatest distance of the others
# from the origin, in standard deviations.
_PLAIN, _NEAREST, _FURTHEST = 0.25, 0.5, 7.0
# Centres of a proposal for one tail, and the points among which those of a piecewise expansion are sought.
_MINIMA, _SOUGHT = 4, 2**13


class Proposal(NamedTuple):
    """A mixture of normal distributions, of which the first is the given one, standard normal.

    - `components`: of each distribution its mean, shape (variables,), and the Cholesky factor of its covariance.
    """

    components: tuple[tuple[np.ndarray, np.ndarray], ...]
    shares: Float[np.ndarray, " components"]

    def draw(self, count: int, generator: np.random.Generator) -> Float[np.ndarray, "count variables"]:
        """Independent points."""
        return self.points(generator.choice(len(self.shares), count, p=self.shares), generator)

    def points(
        self, chosen: Int[np.ndarray, " count"], generator: np.random.Generator
    ) -> Float[np.ndarray, "count variables"]:
        """Independent points of the components that are chosen for them."""
        points = generator.standard_normal((len(chosen), len(self.components[0][0])))
        for k, (mean, factor) in enumerate(self.components):
            points[chosen == k] = mean + points[chosen == k] @ factor.T
        return points

    def weights(self, points: Float[np.ndarray, "systems variables"]) -> Float[np.ndarray, " systems"]:
        """The exact ratio of the given density to the proposal's, at most the reciprocal of the given one's share."""
        logs = []
        for mean, factor in self.components:
            standard = scipy.linalg.solve_triangular(factor, (points - mean).T, lower=True)
            logs.append(-np.sum(standard**2, axis=0) / 2 - np.sum(np.log(np.diag(factor))))
        return np.exp(logs[0] - scipy.special.logsumexp(logs, axis=0, b=self.shares[:, None]))


def levels_of(normals: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """The probability levels of normal variables, never 0 or 1, where unbounded distributions are infinite."""
    return np.clip(scipy.special.ndtr(normals), np.finfo(float).tiny, 1 - np.finfo(float).epsneg)


def tail_proposal(
    basis: AbstractBasis, lines: AnyLines, coefficients: Float[np.ndarray, " terms"], chance: float, *, lower: bool
) -> Proposal:
    """The given distribution, and others around the minima (or maxima) of an expansion.

    These are as far away as what has the probability `chance` in one normal variable; those of a piecewise expansion,
    whose tails may lie anywhere, are the likeliest of many points there.
    """
    signed = (1.0 if lower else -1.0) * np.where(np.arange(len(coefficients)) > 0, coefficients, 0.0)
    distance = np.clip(-scipy.special.ndtri(chance), _NEAREST, _FURTHEST)
    if isinstance(lines, Lines):
        minima = np.zeros((_MINIMA, basis.variables))
        minima[:, list(lines.active)] = lines.minima(signed).T
        minima *= distance
    else:
        minima = _likeliest(basis, signed, chance, distance)
    centres = np.concatenate([np.zeros((1, basis.variables)), minima])
    shares = np.array([_PLAIN, *[(1 - _PLAIN) / len(minima)] * len(minima)])
    return Proposal(tuple((centre, np.eye(basis.variables)) for centre in centres), shares)


def _likeliest(
    basis: AbstractBasis, signed: Float[np.ndarray, " terms"], chance: float, distance: float
) -> Float[np.ndarray, "minima variables"]:
    """Points in the lower tail of an expansion, the likeliest first, each away from those before it."""
    spread = np.sqrt(1 + distance**2)
    points = spread * np.random.default_rng(4).standard_normal((_SOUGHT, basis.variables))
    values = np.asarray(basis.values(basis.map_to_germ(levels_of(points)), jax_array(signed)))
    squares = np.sum(points**2, axis=1)
    weights = np.exp(-squares * (1 - spread**-2) / 2)
    order = np.argsort(values)
    reached = np.cumsum(weights[order]) / np.sum(weights)
    left = order[: max(int(np.searchsorted(reached, chance)), _MINIMA)]
    chosen: list[int] = []
    while len(chosen) < _MINIMA:
        best = left[np.argmin(squares[left])]
        chosen.append(int(best))
        far = left[np.sum((points[left] - points[best]) ** 2, axis=1) > 1.0]
        left = far if len(far) else left
    return points[chosen]


def points_in_tail(
    proposal: Proposal, basis: AbstractBasis, count: int, seed: int
) -> tuple[Float[np.ndarray, "count variables"], Float[np.ndarray, " count"]]:
    """Random germ points of a proposal, as many of each component as its share, and their weights."""
    chosen = np.searchsorted(np.cumsum(proposal.shares), (np.arange(count) + 0.5) / count)
    normals = proposal.points(chosen, np.random.default_rng([3, seed]))
    return basis.map_to_germ(levels_of(normals)), proposal.weights(normals)
