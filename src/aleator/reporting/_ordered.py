"""Fronts by their bounds, for figures: a line joins neighbours, in whatever order points were asked for and solved."""

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Int

from aleator.sweep import Front


def ordered(front: Front) -> Front:
    """The front by its bounds, unless these rise or fall throughout."""
    order = _order(front)
    return replace(front, values=front.values[order], points=tuple(front.points[i] for i in order))


def in_order(fronts: Mapping[str, Front]) -> dict[str, tuple[Front, list[int]]]:
    """Each front by its bounds, and the places of its points among those of all as they were given, by which a page
    links them with their designs.
    """
    counted = itertools.count()
    places = {name: np.array(list(itertools.islice(counted, len(one.points)))) for name, one in fronts.items()}
    return {name: (ordered(one), places[name][_order(one)].tolist()) for name, one in fronts.items()}


def _order(front: Front) -> Int[np.ndarray, " points"]:
    changes = np.diff(front.values)
    is_in_order = bool(np.all(changes >= 0) or np.all(changes <= 0))
    return np.arange(len(front.values)) if is_in_order else np.argsort(front.values, kind="stable")
