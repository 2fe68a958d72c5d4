"""Derivative-free search for the worst realisations of a model in the box of its germ, many at once."""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
import scipy
from jaxtyping import Float

Points: TypeAlias = Float[np.ndarray, "points variables"]
"""Points of the box, scaled to between 0 and 1 in each variable."""

Ask: TypeAlias = Callable[[Points], Float[np.ndarray, "points limits"]]
"""The model's excess over each limit at some points; NaN where it has no value."""

# Points spread over the box in each search, and the most corners that are tried.
_SPREAD, _MOST_CORNERS = 128, 128
# From how many points the search continues for each limit, and their least distance.
_STARTS, _APART = 3, 0.15
# The first and the last step, the number of points in other directions than the axes, and the most axes tried.
_FIRST_STEP, _LAST_STEP, _BESIDE, _MOST_AXES = 0.5, 1e-5, 6, 12
_MOST_SWEEPS = 60


class Found(NamedTuple):
    """The worst points of each limit, the worst first, and their excess over it: one array per limit."""

    points: tuple[Points, ...]
    beyond: tuple[Float[np.ndarray, " points"], ...]


def candidates(variables: int, seed: int, rank: Callable[[Points], np.ndarray]) -> Points:
    """Initial points of the search: the middle, corners, ends of each variable, and some points inside.

    - `rank`: gives the indices of the worst of many points by a cheap model, the expansion.
    """
    generator = np.random.default_rng(seed)
    middle = np.full((1, variables), 0.5)
    ends = np.repeat(middle, 2 * variables, axis=0)
    ends[np.arange(2 * variables), np.repeat(np.arange(variables), 2)] = np.tile([0.0, 1.0], variables)
    if 2**variables <= _MOST_CORNERS:
        corners = np.indices((2,) * variables).reshape(variables, -1).T.astype(float)
    else:
        corners = generator.integers(0, 2, (_MOST_CORNERS, variables)).astype(float)
    inside = scipy.stats.qmc.Sobol(variables, rng=generator).random(16 * _SPREAD)
    many = np.concatenate([inside, np.round(inside), np.round(generator.random(inside.shape))])
    return np.concatenate([middle, ends, corners, inside[:_SPREAD], many[rank(many)]])


def search(ask: Ask, tried: Points, beyond: Float[np.ndarray, "points limits"], seed: int) -> Found:
    """Search from the worst of the points tried to a local worst point near each, for every limit.

    It tries points along the axes and in random directions, with steps that shrink if nothing worse is found. It needs
    no derivatives, tolerates kinks, and stops at faces and corners of the box.
    """
    generator = np.random.default_rng(seed)
    starts = [_apart(tried, column) for column in np.nan_to_num(beyond, nan=np.inf).T]
    limit = np.repeat(np.arange(len(starts)), [len(one) for one in starts])
    which = np.concatenate(starts)
    at, best = tried[which], np.nan_to_num(beyond[which, limit], nan=np.inf)
    step = np.full(len(at), _FIRST_STEP)
    for _ in range(_MOST_SWEEPS):
        going = np.flatnonzero((step > _LAST_STEP) & np.isfinite(best))
        if not going.size:
            break
        places = _beside(at[going], step[going], generator)
        values = _values(ask, places, limit[going])
        leap = _leaps(at[going], step[going], best[going], places, values)
        places = np.concatenate([places, leap[:, None]], axis=1)
        values = np.concatenate([values, _values(ask, leap[:, None], limit[going])], axis=1)
        k = np.argmax(values, axis=1)
        reached, where = values[np.arange(len(going)), k], places[np.arange(len(going)), k]
        better = reached > best[going]
        moved = np.max(np.abs(where - at[going]), axis=1)
        # If the worse point was close, the maximum is presumed near; if it was far, possibly far.
        step[going] = np.where(better, np.clip(2 * moved, step[going] / 8, step[going]), step[going] / 4)
        at[going] = np.where(better[:, None], where, at[going])
        best[going] = np.maximum(best[going], reached)
    order = [np.flatnonzero(limit == i)[np.argsort(-best[limit == i])] for i in range(len(starts))]
    return Found(tuple(at[one] for one in order), tuple(best[one] for one in order))


def _apart(points: Points, beyond: Float[np.ndarray, " points"]) -> np.ndarray:
    """The indices of the worst points that are not close to a worse one."""
    chosen: list[int] = []
    for i in np.argsort(-beyond, kind="stable"):
        if all(np.max(np.abs(points[i] - points[j])) >= _APART for j in chosen):
            chosen.append(int(i))
        if len(chosen) == _STARTS:
            break
    return np.array(chosen)


def _beside(at: Points, step: Float[np.ndarray, " starts"], generator: np.random.Generator) -> np.ndarray:
    """Points near each: one step up and down along (some of) the axes, and some in other directions."""
    starts, variables = at.shape
    axes = generator.permutation(variables)[:_MOST_AXES]
    moves = np.zeros((starts, 2 * len(axes) + _BESIDE, variables))
    for i, axis in enumerate(axes):
        moves[:, 2 * i, axis], moves[:, 2 * i + 1, axis] = 1.0, -1.0
    if variables > 1:
        moves[:, 2 * len(axes) :] = generator.normal(size=(starts, _BESIDE, variables)) / np.sqrt(variables)
    else:
        moves[:, 2:, 0] = np.linspace(-0.75, 0.75, _BESIDE)
    return np.clip(at[:, None] + step[:, None, None] * moves, 0.0, 1.0)


def _values(ask: Ask, places: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """The excess of each start's points over its own limit; infinite where there is no value."""
    found = ask(places.reshape(-1, places.shape[-1])).reshape(*places.shape[:2], -1)
    own = np.take_along_axis(found, limit[:, None, None], axis=2)[..., 0]
    return np.nan_to_num(own, nan=np.inf)


def _leaps(
    at: Points, step: np.ndarray, best: np.ndarray, places: np.ndarray, values: np.ndarray
) -> Float[np.ndarray, "starts variables"]:
    """Leaps to the vertices of the parabolas along all axes at once; a full step uphill along straight ones."""
    leap = at.copy()
    for start in range(len(at)):
        for i in range(0, places.shape[1] - _BESIDE, 2):
            up, down = places[start, i], places[start, i + 1]
            axis = int(np.argmax(np.abs(up - at[start]) + np.abs(down - at[start])))
            a, b = up[axis] - at[start, axis], at[start, axis] - down[axis]
            rise, fall = values[start, i] - best[start], values[start, i + 1] - best[start]
            if not (np.isfinite(rise) and np.isfinite(fall)):
                continue
            if a > 0 and b > 0 and (rise / a + fall / b) < 0:
                bend, slope = (rise / a + fall / b) / (a + b), (rise * b / a - fall * a / b) / (a + b)
                leap[start, axis] += np.clip(-slope / (2 * bend), -2 * step[start], 2 * step[start])
            elif max(rise, fall) > 0:
                leap[start, axis] = up[axis] if rise >= fall else down[axis]
    return np.clip(leap, 0.0, 1.0)
