"""Gauss points with quadrature weights: full grids and sparse grids."""

from math import comb
from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Int
from typing_extensions import override

from aleator._core import border
from aleator._core.arrays import NUMBER, refuse_beyond_memory
from aleator._core.errors import ProblemError
from aleator.expansion._basis import AbstractBasis, Basis, TotalDegree
from aleator.expansion._points import AbstractPoints, Nodes, count_given
from aleator.uncertainty import AbstractGerm

# Larger grids are presumed to be a mistake.
_MOST_POINTS = 1_000_000

# Roots closer than this part of their range are equal up to rounding.
_SAME = 1e-10


def _level_given(level: int | None) -> int | None:
    return None if level is None else border.whole("SmolyakPoints: the level", level)


@final
class GaussPoints(AbstractPoints):
    """The full grid of Gauss points: `count` roots for each variable, by default one more than its highest degree.

    The rule is exact to degree `2 count - 1` in each variable, so that by default it integrates all products of two
    polynomials of the basis. It has `count^n_p` points and so suits few variables.
    """

    count: int | None = eqx.field(static=True, default=None, converter=count_given)

    @override
    def nodes(self, basis: AbstractBasis, usual: int) -> Nodes:
        """Raises `ProblemError` if the grid has more than a million points."""
        del usual
        counts = [self.count or degree + 1 for degree in basis.degrees]
        if np.prod([float(count) for count in counts]) > _MOST_POINTS:
            raise ProblemError(
                f"GaussPoints: a grid of {' x '.join(map(str, counts))} roots has more than {_MOST_POINTS} points. "
                "Take al.points.SmolyakPoints(), or least squares."
            )
        _refuse_large_rule(max(counts))
        rules = [germ.gauss(count) for germ, count in zip(basis.germs.values(), counts, strict=True)]
        rows = _grid([len(roots) for roots, _ in rules])
        points = np.column_stack([roots[row] for (roots, _), row in zip(rules, rows.T, strict=True)])
        weights = np.prod([weight[row] for (_, weight), row in zip(rules, rows.T, strict=True)], axis=0)
        return Nodes(points, weights / weights.sum())


@final
class SmolyakPoints(AbstractPoints):
    """The sparse grid of Gauss points of a level, by default the order of the basis; its weights have both signs.

    Rules of `l + 1` roots in each variable are combined over `sum of l <= level`. It is exact to total degree
    `2 level + 1`: a level of the basis's order integrates all products of two polynomials up to that total degree.
    Source: Smolyak (1963); combination by Wasilkowski and Woźniakowski (1995).
    """

    level: int | None = eqx.field(static=True, default=None, converter=_level_given)

    @override
    def nodes(self, basis: Basis, usual: int) -> Nodes:
        """Raises `ProblemError` if the grid has more than a million points."""
        del usual
        level = self.level or basis.order
        levels = TotalDegree().indices(basis.names, level)
        _refuse_large_rule(level + 1)
        rules = [_Rules(germ, level) for germ in basis.germs.values()]
        missing = level - levels.sum(axis=1)
        used = missing < basis.variables
        parts = []
        for row, lack in zip(levels[used], missing[used].tolist(), strict=True):
            grid = _grid((row + 1).tolist())
            chosen = list(zip(rules, row.tolist(), grid.T, strict=True))
            places = np.column_stack([rule.places[size][k] for rule, size, k in chosen])
            factors = [rule.weights[size][k] for rule, size, k in chosen]
            parts.append((places, (-1) ** lack * comb(basis.variables - 1, lack) * np.prod(factors, axis=0)))
            if sum(len(places) for places, _ in parts) > 10 * _MOST_POINTS:
                raise ProblemError(
                    f"SmolyakPoints: level {level} in {basis.variables} variables has too many points to combine. "
                    "Lower the order, or take least squares."
                )
        places, which = np.unique(np.concatenate([places for places, _ in parts]), axis=0, return_inverse=True)
        weights = np.bincount(which.ravel(), np.concatenate([factors for _, factors in parts]))
        points = np.column_stack([rule.roots[column] for rule, column in zip(rules, places.T, strict=True)])
        return Nodes(points, weights / weights.sum())


@final
class _Rules:
    """The Gauss rules of 1 to `level + 1` roots in one variable, whose common roots are stored once.

    `roots`: the distinct ones; `places[l]`: their indices in the rule of level l; `weights[l]`: its weights.
    """

    def __init__(self, germ: AbstractGerm, level: int):
        rules = [germ.gauss(count + 1) for count in range(level + 1)]
        self.weights = [weights for _, weights in rules]
        every = np.concatenate([roots for roots, _ in rules])
        ordered = np.sort(every)
        new = np.append(True, np.diff(ordered) > _SAME * max(np.ptp(ordered), 1.0))
        self.roots = ordered[new]
        number = np.empty(len(every), dtype=int)
        number[np.argsort(every)] = np.cumsum(new) - 1
        self.places = np.split(number, np.cumsum([len(roots) for roots, _ in rules])[:-1])


def _refuse_large_rule(count: int) -> None:
    """Refuse a Gauss rule if the eigenvectors of its tridiagonal matrix would not fit into memory."""
    advice = "Take fewer roots, or least squares."
    refuse_beyond_memory(f"A Gauss rule of {count} roots", 5 * NUMBER * count**2, advice)


def _grid(counts: list[int]) -> Int[np.ndarray, "points variables"]:
    """Every combination of the numbers below each count."""
    return np.indices(counts).reshape(len(counts), -1).T
