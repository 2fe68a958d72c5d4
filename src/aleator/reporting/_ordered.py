"""Fronts by their bounds, for figures: a line joins neighbours, in whatever order points were asked for and solved."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Int

from aleator.sweep import Front


def ordered(front: Front) -> Front:
    """The front by its bounds, unless these rise or fall throughout."""
    return _arranged(front, _order(front))


def in_order(fronts: Mapping[str, Front]) -> dict[str, tuple[Front, list[int]]]:
    """Each front by its bounds, and the places of its points among those of all as they were given, by which a page
    links them with their designs.
    """
    found, before = {}, 0
    for name, front in fronts.items():
        order = _order(front)
        found[name] = _arranged(front, order), (before + order).tolist()
        before += len(order)
    return found


def _arranged(front: Front, order: Int[np.ndarray, " points"]) -> Front:
    return replace(front, values=front.values[order], points=tuple(front.points[i] for i in order))


def _order(front: Front) -> Int[np.ndarray, " points"]:
    changes = np.diff(front.values)
    is_in_order = bool(np.all(changes >= 0) or np.all(changes <= 0))
    return np.arange(len(front.values)) if is_in_order else np.argsort(front.values, kind="stable")
