"""Local maxima of functions over a box, by a search without derivatives: where a statistic or a limit is worst."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import scipy
from jaxtyping import Float

Points: TypeAlias = Float[np.ndarray, "points variables"]
"""Points of the box, scaled to between 0 and 1 in each variable."""

# From how many points the search continues for each limit, and their least distance.
_STARTS, _APART = 3, 0.15
# The first and the last step, the number of points in other directions than the axes, and the most axes tried.
_FIRST_STEP, _LAST_STEP, _BESIDE, _MOST_AXES = 0.5, 1e-5, 6, 12
_MOST_SWEEPS = 60
# The most corners of a box, and the most points inside, from which a search begins.
_MOST_CORNERS, _MOST_INSIDE = 128, 128


def corners_of(variables: int, most: int, generator: np.random.Generator) -> Points:
    """All corners of the unit box, or as many random ones if there are more than `most`."""
    if 2**variables <= most:
        return np.indices((2,) * variables).reshape(variables, -1).T.astype(float)
    return generator.integers(0, 2, (most, variables)).astype(float)


def spread_over(variables: int, seed: int) -> Points:
    """Points of the unit box to begin a search with: corners, the middle, the middles of all faces, some inside."""
    generator = np.random.default_rng(seed)
    middle = np.full((1, variables), 0.5)
    faces = middle + np.kron(np.eye(variables), [[-0.5], [0.5]])
    inside = scipy.stats.qmc.Sobol(variables, rng=generator).random(min(2 ** (4 + variables), _MOST_INSIDE))
    return np.concatenate([corners_of(variables, _MOST_CORNERS, generator), middle, faces, inside])


def search(
    excess_at: Callable[[Points], np.ndarray], tried: Points, beyond: Float[np.ndarray, "points limits"], seed: int
) -> list[tuple[Float[np.ndarray, "_ variables"], Float[np.ndarray, " _"]]]:
    """Search from the worst of the points tried to a local worst point near each: for every limit, the worst first, and
    their excess over it.

    It tries points along the axes and in random directions, with steps that shrink if nothing worse is found. It needs
    no derivatives, tolerates kinks, and stops at faces and corners of the box.

    `excess_at`: gives the model's excess over each limit, shape (points, limits), NaN where it has no value.
    """
    generator = np.random.default_rng(seed)
    starts = [_apart(tried, column) for column in np.nan_to_num(beyond, nan=np.inf).T]
    limit, which = np.repeat(np.arange(len(starts)), list(map(len, starts))), np.concatenate(starts)
    at, best = tried[which], np.nan_to_num(beyond[which, limit], nan=np.inf)
    step = np.full(len(at), _FIRST_STEP)

    def values_at(places: np.ndarray, going: np.ndarray) -> np.ndarray:
        """The excess of each start's points over its own limit; infinite where there is no value."""
        excess = excess_at(places.reshape(-1, places.shape[-1])).reshape(*places.shape[:2], -1)
        return np.nan_to_num(np.take_along_axis(excess, limit[going, None, None], axis=2)[..., 0], nan=np.inf)

    for _ in range(_MOST_SWEEPS):
        going = np.flatnonzero((step > _LAST_STEP) & np.isfinite(best))
        if not going.size:
            break
        axes = generator.permutation(at.shape[1])[:_MOST_AXES]
        places = _beside(at[going], step[going], axes, generator)
        values = values_at(places, going)
        leap = _leaps(at[going], step[going], best[going], axes, places, values)[:, None]
        places = np.concatenate([places, leap], axis=1)
        values = np.concatenate([values, values_at(leap, going)], axis=1)
        k = np.argmax(values, axis=1)
        reached, where = values[np.arange(len(going)), k], places[np.arange(len(going)), k]
        better = reached > best[going]
        moved = np.max(np.abs(where - at[going]), axis=1)
        # If the worse point was close, the maximum is presumed near; if it was far, possibly far.
        step[going] = np.where(better, np.clip(2 * moved, step[going] / 8, step[going]), step[going] / 4)
        at[going] = np.where(better[:, None], where, at[going])
        best[going] = np.maximum(best[going], reached)
    order = [np.flatnonzero(limit == i)[np.argsort(-best[limit == i])] for i in range(len(starts))]
    return [(at[one], best[one]) for one in order]


def _apart(points: Points, beyond: Float[np.ndarray, " points"]) -> np.ndarray:
    """The indices of the worst points that are not close to a worse one."""
    chosen: list[int] = []
    for i in np.argsort(-beyond, kind="stable"):
        if all(np.max(np.abs(points[i] - points[j])) >= _APART for j in chosen):
            chosen.append(int(i))
        if len(chosen) == _STARTS:
            break
    return np.array(chosen)


def _beside(at: Points, step: np.ndarray, axes: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Points near each: one step up and one down along some axes, one after the other, and some in other directions."""
    starts, variables = at.shape
    along = np.kron(np.eye(variables)[axes], [[1.0], [-1.0]])
    if variables > 1:
        others = generator.normal(size=(starts, _BESIDE, variables)) / np.sqrt(variables)
    else:
        others = np.repeat(np.linspace(-0.75, 0.75, _BESIDE)[None, :, None], starts, axis=0)
    moves = np.concatenate([np.repeat(along[None], starts, axis=0), others], axis=1)
    return np.clip(at[:, None] + step[:, None, None] * moves, 0.0, 1.0)


def _leaps(
    at: Points, step: np.ndarray, best: np.ndarray, axes: np.ndarray, places: np.ndarray, values: np.ndarray
) -> Float[np.ndarray, "starts variables"]:
    """Leaps to the vertices of the parabolas along all axes at once; a full step uphill along straight ones."""
    up, down = (np.arange(first, 2 * len(axes), 2) for first in (0, 1))
    a, b = places[:, up, axes] - at[:, axes], at[:, axes] - places[:, down, axes]
    rise, fall = values[:, up] - best[:, None], values[:, down] - best[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        bend, slope = (rise / a + fall / b) / (a + b), (rise * b / a - fall * a / b) / (a + b)
        vertex = np.clip(-slope / (2 * bend), -2 * step[:, None], 2 * step[:, None])
    uphill = np.where(np.maximum(rise, fall) > 0, np.where(rise >= fall, a, -b), 0.0)
    leap = np.where((a > 0) & (b > 0) & (bend < 0), vertex, uphill)
    there = at.copy()
    there[:, axes] += np.where(np.isfinite(rise) & np.isfinite(fall), leap, 0.0)
    return np.clip(there, 0.0, 1.0)
