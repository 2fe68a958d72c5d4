"""Importance sampling of rare violations: the proposal distribution, found by the cross-entropy method.

Every germ variable is a function of a standard normal one, at equal probability. In the space of these normals the
proposal is a mixture of normal distributions: one for each limit, moved to where the limit is broken, the given
distribution itself, and a wide one, so that no weight exceeds ten. Sources: Rubinstein and Kroese, The Cross-Entropy
Method (2004); Papaioannou, Geyer and Straub, Reliability Engineering & System Safety 191 (2019); Owen and Zhou, Journal
of the American Statistical Association 95 (2000), on mixtures that keep the given distribution.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
import scipy
from jaxtyping import Float, Int

from aleator.validation._weighted import WeightedProportion

Scores: TypeAlias = Callable[[Float[np.ndarray, "systems variables"]], Float[np.ndarray, "limits systems"]]
"""The excess over each limit of systems at given normals: positive where they break it."""

_PLAIN, _WIDE = 0.1, 0.2  # shares of the given and of the wide distribution in every proposal
_MOST_LEVELS = 12
_STALLED = 0.01  # least progress of a level, as a fraction of the first distance to a limit


class Component(NamedTuple):
    """One normal distribution: its mean, shape (variables,), and the Cholesky factor of its covariance."""

    mean: Float[np.ndarray, " variables"]
    factor: Float[np.ndarray, "variables variables"]

    def log_density(self, points: Float[np.ndarray, "systems variables"]) -> Float[np.ndarray, " systems"]:
        """Logarithm of the density, up to the constant that all normal distributions share."""
        standard = scipy.linalg.solve_triangular(self.factor, (points - self.mean).T, lower=True)
        return -np.sum(standard**2, axis=0) / 2 - np.sum(np.log(np.diag(self.factor)))


class Proposal(NamedTuple):
    """A mixture of normal distributions, of which the first is the given one, standard normal."""

    components: tuple[Component, ...]
    shares: Float[np.ndarray, " components"]

    def draw(self, count: int, generator: np.random.Generator) -> Float[np.ndarray, "count variables"]:
        """Independent points."""
        chosen = generator.choice(len(self.shares), count, p=self.shares)
        standard = generator.standard_normal((count, len(self.components[0].mean)))
        points = np.empty_like(standard)
        for k, one in enumerate(self.components):
            points[chosen == k] = one.mean + standard[chosen == k] @ one.factor.T
        return points

    def weights(self, points: Float[np.ndarray, "systems variables"]) -> Float[np.ndarray, " systems"]:
        """The exact ratio of the given density to the proposal's, at most the reciprocal of the given one's share."""
        logs = np.stack([one.log_density(points) for one in self.components])
        return np.exp(logs[0] - np.logaddexp.reduce(logs + np.log(self.shares)[:, None], axis=0))


def adapted(scores: Scores, variables: int, reach: float, samples: int, generator: np.random.Generator) -> Proposal:
    """A proposal whose systems often break each limit.

    Level by level, each limit's component is fitted to the fewest worst systems that suffice for a fit, until those
    that break the limit suffice; the component of a limit that cannot be broken stays at its worst systems. `reach` is
    the distance from the origin, in standard deviations, at which such systems are expected; `samples` the number of
    systems per level.
    """
    enough = max(100, 5 * variables)
    proposal = _mixture(variables, reach, [])
    gaps: list[Float[np.ndarray, " limits"]] = []
    for level in range(_MOST_LEVELS):
        points = proposal.draw(samples, generator)
        weights, beyond = proposal.weights(points), scores(points)
        elites = [_elite(one, weights, enough) for one in beyond]
        fitted = [_fitted(points[elite], weights[elite]) for elite in elites]
        proposal = _mixture(variables, reach, fitted)
        gaps.append(np.array([max(-one[elite].min(), 0.0) for one, elite in zip(beyond, elites, strict=True)]))
        gained = gaps[-2] - gaps[-1] if level else np.full(len(gaps[0]), np.inf)
        if np.all((gaps[-1] == 0) | (gained < _STALLED * gaps[0])):
            break
    return proposal


def weighted(
    scores: Scores,
    proposal: Proposal,
    samples: int,
    batch: int,
    generator: np.random.Generator,
    tell: Callable[[int], None],
) -> WeightedProportion:
    """How often any limit is broken, from fresh samples of a proposal. `tell` is called with the number done."""
    found = []
    for done in range(0, samples, batch):
        tell(done)
        points = proposal.draw(min(batch, samples - done), generator)
        found.append(np.where(np.any(scores(points) > 0, axis=0), proposal.weights(points), 0.0))
    return WeightedProportion.of(np.concatenate(found))


def _mixture(variables: int, reach: float, fitted: list[Component]) -> Proposal:
    """The given distribution, a wide one that covers all directions, and those fitted to the limits."""
    middle, one = np.zeros(variables), np.eye(variables)
    wide = Component(middle, np.sqrt(1 + reach**2 / variables) * one)
    shares = np.array([_PLAIN, _WIDE, *((1 - _PLAIN - _WIDE) / len(fitted) for _ in fitted)])
    return Proposal((Component(middle, one), wide, *fitted), shares / shares.sum())


def _elite(
    beyond: Float[np.ndarray, " systems"], weights: Float[np.ndarray, " systems"], enough: int
) -> Int[np.ndarray, " elite"]:
    """The fewest worst systems with the required effective number; all that break the limit where these suffice."""
    order = np.argsort(-beyond, kind="stable")
    sums, squares = np.cumsum(weights[order]), np.cumsum(weights[order] ** 2)
    suffice = np.flatnonzero(sums**2 >= enough * squares)
    count = int(suffice[0]) + 1 if len(suffice) else len(order)
    return order[: max(count, int(np.sum(beyond > 0)))]


def _fitted(points: Float[np.ndarray, "elite variables"], weights: Float[np.ndarray, " elite"]) -> Component:
    """The normal distribution of the weighted points, its covariance shrunk towards that of the given distribution.

    The fewer points there are for its entries, the more it is shrunk, and always a little: a proposal that is too
    narrow gives large weights just outside it.
    """
    variables, total = points.shape[1], weights.sum()
    mean = weights @ points / total
    covariance = (weights * (points - mean).T) @ (points - mean) / total
    drawn = max(0.1, variables / (variables + total**2 / np.sum(weights**2)))
    return Component(mean, np.linalg.cholesky((1 - drawn) * covariance + drawn * np.eye(variables)))
