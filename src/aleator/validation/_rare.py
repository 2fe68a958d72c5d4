"""`rare_violation`: the probability of violations too rare to be counted, by importance sampling.

The proposal distribution is found by the cross-entropy method. Every germ variable is a function of a standard normal
one, at equal probability. In the space of these normals the proposal is a mixture of normal distributions: one for each
limit, moved to where the limit is broken, the given distribution itself, and a wide one, so that no weight exceeds ten.
Sources: Rubinstein and Kroese, The Cross-Entropy Method (2004); Papaioannou, Geyer and Straub, Reliability Engineering
& System Safety 191 (2019); Owen and Zhou, Journal of the American Statistical Association 95 (2000), on mixtures that
keep the given distribution.
"""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from aleator._core.border import Progress, check_progress, one_of, refusal, silent, whole
from aleator._core.errors import ProblemError
from aleator._core.journalled import call_by_call, journalled, parts_so_far
from aleator.ensemble import Part, at_levels, each, parts
from aleator.solution import Solution
from aleator.statistics import Proposal, levels_of
from aleator.validation._shares import Share, WeightedProportion, check_counted, is_counted
from aleator.validation._systems import Systems
from aleator.validation._validate import validate

Scores: TypeAlias = Callable[[Float[np.ndarray, "systems variables"]], Float[np.ndarray, "limits systems"]]
"""The excess over each limit of systems at given normals: positive where they break it."""

_PLAIN, _WIDE = 0.1, 0.2  # shares of the given and of the wide distribution in every proposal
_MOST_LEVELS = 12
_STALLED = 0.01  # least progress of a level, as a fraction of the first distance to a limit


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


def _mixture(variables: int, reach: float, fitted: list[tuple[np.ndarray, np.ndarray]]) -> Proposal:
    """The given distribution, a wide one that covers all directions, and those fitted to the limits."""
    middle, one = np.zeros(variables), np.eye(variables)
    wide = middle, np.sqrt(1 + reach**2 / variables) * one
    shares = np.array([_PLAIN, _WIDE, *((1 - _PLAIN - _WIDE) / len(fitted) for _ in fitted)])
    return Proposal(((middle, one), wide, *fitted), shares / shares.sum())


def _elite(
    beyond: Float[np.ndarray, " systems"], weights: Float[np.ndarray, " systems"], enough: int
) -> Int[np.ndarray, " elite"]:
    """The fewest worst systems with the required effective number; all that break the limit where these suffice."""
    order = np.argsort(-beyond, kind="stable")
    sums, squares = np.cumsum(weights[order]), np.cumsum(weights[order] ** 2)
    suffice = np.flatnonzero(sums**2 >= enough * squares)
    count = int(suffice[0]) + 1 if len(suffice) else len(order)
    return order[: max(count, int(np.sum(beyond > 0)))]


def _fitted(
    points: Float[np.ndarray, "elite variables"], weights: Float[np.ndarray, " elite"]
) -> tuple[np.ndarray, np.ndarray]:
    """The normal distribution of the weighted points, its covariance shrunk towards that of the given distribution.

    The fewer points there are for its entries, the more it is shrunk, and always a little: a proposal that is too
    narrow gives large weights just outside it.
    """
    variables, total = points.shape[1], weights.sum()
    mean = weights @ points / total
    covariance = (weights * (points - mean).T) @ (points - mean) / total
    drawn = max(0.1, variables / (variables + total**2 / np.sum(weights**2)))
    return mean, np.linalg.cholesky((1 - drawn) * covariance + drawn * np.eye(variables))


# With a smaller effective sample size an estimate is no better than a count, and its interval is unreliable.
_ENOUGH = 100
# The search for violations starts at this many standard deviations; one system in ten thousand lies beyond.
_REACH = 3.7


def rare_violation(
    solution: Solution,
    names: str | Sequence[str] | None = None,
    samples: int = 20_000,
    *,
    seed: int = 0,
    batch: int = 250,
    progress: Progress = silent,
) -> Share:
    """Estimate how often systems of a design break any of the limits called `names` (default: all), if rarely.

    First, separate simulations search level by level for systems that break each limit (the cross-entropy method). Then
    `samples` fresh systems are drawn where these were found, and weighted by their likelihood ratios. The estimate is
    unbiased whatever was found. It needs some thousand samples where a count needs a hundred divided by the
    probability. It works for any distributions, correlated ones too; beyond some twenty uncertain numbers the weights
    degenerate.

    Where the effective sample size is below a hundred, the result is a plain count of `samples` systems instead: a
    `Proportion`. No sampling method can account for a way of breaking a limit that it never met; the fewer uncertain
    numbers, the less likely that is. Where much depends on it, count with `al.validate`.

    Within `al.journal(folder)` what takes long is kept part by part, every few seconds: after a crash the same call
    goes on from there.

    Raises `ProblemError` as `al.validate` does, and for names against which no system is counted.
    """
    one_of("rare_violation", solution, Solution, "that of al.solve")
    least = {"samples": (samples, 2), "batch": (batch, 1), "seed": (seed, 0)}
    samples, batch, seed = (whole(f"rare_violation: {name}", one, least=n) for name, (one, n) in least.items())
    check_progress("rare_violation", progress)
    if not isinstance(names, str | Sequence | None):
        raise refusal("rare_violation: names", "names of constraints", names)
    systems, batch = Systems(solution, "rare_violation"), min(batch, samples)
    if not systems.germs:
        raise ProblemError("rare_violation: nothing in this problem is uncertain, so there is nothing to sample.")
    limits = [(i, one) for i, one in enumerate(systems.problem.constraints) if is_counted(systems.problem, one)]
    counted = tuple(dict.fromkeys(one.name for _, one in limits))
    names = counted if names is None else (names,) if isinstance(names, str) else tuple(names)
    check_counted("rare_violation", names, counted)
    rows = [i for i, one in limits if one.name in names]

    def beyond(normals: Float[np.ndarray, "systems variables"]) -> Float[np.ndarray, "limits systems"]:
        def simulated(part: Part) -> Float[np.ndarray, "limits some"]:
            return systems.simulate(part.points, batch).excess[rows]

        every = parts(at_levels(systems.germs, levels_of(normals)), batch)
        return np.concatenate([some for _, some in each(simulated, every)], axis=1)

    def tell(done: int) -> None:
        progress("rare violations", done, samples)

    def estimated() -> Share:
        tell(0)
        systems.prepare(batch)
        generator, scores = np.random.default_rng(seed), call_by_call(beyond, parts_so_far())
        proposal = adapted(scores, len(systems.germs), _REACH, max(1000, samples // 10), generator)
        share = weighted(scores, proposal, samples, batch, generator, tell)
        tell(samples)
        if share.effective >= _ENOUGH:
            return share
        # A separate random stream, so that the count is independent of the search.
        fresh = int(np.random.SeedSequence([seed, 1]).generate_state(1)[0])
        return validate(solution, samples, seed=fresh, batch=batch, keep=0).violation(*names)

    given = {"solution": solution, "how": (names, samples, seed, batch)}
    return journalled("rare_violation", given, estimated)
