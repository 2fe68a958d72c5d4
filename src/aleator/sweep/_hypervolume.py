"""Efficient points and the volume that they dominate."""

import numpy as np
from jaxtyping import Bool, Float


def efficient(points: Float[np.ndarray, "n wishes"], tolerance: Float[np.ndarray, " wishes"]) -> Bool[np.ndarray, " n"]:
    """Which points no other one dominates: is as good in every wish, and better in one by more than its tolerance.

    As good is what is worse by at most a tenth of the tolerance, so that steep ends of a front are kept.
    """
    kept = np.ones(len(points), dtype=bool)
    for i, point in enumerate(points):
        others = points[kept & (np.arange(len(points)) != i)]
        as_good = (others <= point + 0.1 * tolerance).all(axis=1)
        better = (others < point - tolerance).any(axis=1)
        kept[i] = not (as_good & better).any()
    return kept


def hypervolume(points: Float[np.ndarray, "n wishes"], reference: Float[np.ndarray, " wishes"]) -> float:
    """The volume of what some point is better than, up to a reference that is worse than all of them.

    By slices along the last wish (Zitzler 1999); points beyond the reference add nothing.
    """
    inside = points[(points < reference).all(axis=1)]
    if not len(inside):
        return 0.0
    if inside.shape[1] == 1:
        return float(reference[0] - inside.min())
    inside = inside[np.argsort(inside[:, -1], kind="stable")]
    depths = np.append(inside[1:, -1], reference[-1]) - inside[:, -1]
    return sum(
        hypervolume(inside[: i + 1, :-1], reference[:-1]) * float(depth) for i, depth in enumerate(depths) if depth > 0
    )
