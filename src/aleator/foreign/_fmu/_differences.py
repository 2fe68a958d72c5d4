"""Derivatives by differences, for what offers none: four points about the place, of fourth order."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Relative to a number's scale. The error of the formula, of the fourth order of the step, is about 1e-12 of a smooth
# function; noise of a solver is magnified by about a thousand only.
STEP = 1e-3
# After the place: coefficients of a difference over so many steps.
_FORWARD = {0: -25 / 12, 1: 48 / 12, 2: -36 / 12, 3: 16 / 12, 4: -3 / 12}


class Slope(NamedTuple):
    """A derivative, and how much the differences over one step and over two disagree: much if noise or jumps do."""

    value: np.ndarray
    disagreement: np.ndarray


def scales(values: Float[np.ndarray, " n"], nominals: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """By how much a change of each number is large: its size, or what is usual where it is about zero."""
    return np.where(np.abs(values) > 1e-6 * nominals, np.abs(values), nominals)


def slope(along: Callable[[float], np.ndarray], step: float) -> Slope:
    """The derivative at zero of `along`, a function of a number."""
    once = (along(step) - along(-step)) / (2 * step)
    twice = (along(2 * step) - along(-2 * step)) / (4 * step)
    return Slope((4 * once - twice) / 3, np.abs(once - twice))


def forward_slope(along: Callable[[float], np.ndarray], step: float) -> np.ndarray:
    """The same, asking for positive numbers alone."""
    return np.sum([weight * along(count * step) for count, weight in _FORWARD.items()], axis=0) / step


def jacobian(
    function: Callable[[np.ndarray], np.ndarray], at: Float[np.ndarray, " n"], steps: Float[np.ndarray, " n"]
) -> Slope:
    """The derivatives of an array by each number of `at`, on a last axis."""
    if not len(at):
        nothing = np.zeros((*np.shape(function(at)), 0))
        return Slope(nothing, nothing)
    units = np.eye(len(at))
    columns = [
        slope(lambda a, unit=unit: function(at + a * unit), step) for unit, step in zip(units, steps, strict=True)
    ]
    return Slope(*(np.stack(parts, axis=-1) for parts in zip(*columns, strict=True)))
