"""The blocks of a simultaneous program, and the sparse program that they make."""

import math
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import final

import numpy as np
from jaxtyping import Float, Int

from aleator.design import Problem
from aleator.nlp import Evaluation, Hessian, SparseMatrix
from aleator.statistics import Constants
from aleator.transcription._abstract import Remembered
from aleator.transcription.simultaneous._assembly import Curvature, Jacobian, Pattern
from aleator.transcription.simultaneous._blocks import Family
from aleator.transcription.simultaneous._families import EQUATIONS, KNOWN, OBJECTIVE, PATHS, RATES, families
from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._rows import Given, Rows, rows_of
from aleator.transcription.simultaneous._signals import constant_slopes
from aleator.transcription.simultaneous._tiles import Call, begin, calls_of, results, tile_size, tiles_of

# The families that grow with the mesh.
_MOVING = RATES, EQUATIONS, PATHS


def _calls(
    traced: Problem,
    equations: Problem,
    constants: Constants,
    layout: Layout,
    every: tuple[Family, ...],
    patterns: list[Pattern],
) -> list[Call]:
    """The calls that evaluate all families: those that grow with the mesh are in tiles, and what is compiled of them
    serves every mesh; but signals, which differ at each of their points.
    """
    nodes, scheme = tuple(layout.asked.grid.fractions.tolist()), layout.plan.scheme
    first = replace(layout.plan, mesh=replace(layout.plan.mesh, nodes=nodes, scheme=scheme))
    sizes = [(len(one.own), one.own.shape[1]) for one in every]
    sizes[RATES] = tile_size(sizes[RATES][0], len(first.mesh.asked))
    sizes[EQUATIONS] = tile_size(sizes[EQUATIONS][0], len(first.mesh.sides))
    sizes[PATHS] = tile_size(*sizes[PATHS])
    tiles = [tiles_of(i, one, patterns[i], sizes[i]) for i, one in enumerate(every)]
    rows = [one.rows.size for one in patterns]
    moving = [calls_of(equations, None, scheme.rate, [(one,) for one in tiles[i]]) for i in _MOVING if rows[i]]
    known = calls_of(traced, constants, layout.plan, [tuple(tiles[KNOWN])])
    rest = [some[0] for i, some in enumerate(tiles) if i not in (KNOWN, *_MOVING) and rows[i]]
    still = calls_of(traced, constants, first, [tuple(rest)])
    return [call for some in (*moving, known, still) for call in some]


@final
@dataclass(frozen=True)
class Blocks:
    """All blocks of a program, family by family."""

    calls: list[Call]
    patterns: list[Pattern]

    def __call__(
        self, variables: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " entries"]]:
        """The rows of all blocks, and the entries of their Jacobians."""
        values, rows = _together([one.rows.shape for one in self.patterns])
        slopes, entries = _together([one.slopes_shape for one in self.patterns])
        for tile, (value, slope) in results([call.evaluation(variables) for call in self.calls]):
            tile.write(value, values)
            tile.write(slope, slopes)
        return rows, entries

    def curved(
        self, variables: Float[np.ndarray, " n"], weights: Float[np.ndarray, " rows"]
    ) -> Float[np.ndarray, " entries"]:
        """The entries of the Hessians of all blocks, their rows weighted: lower triangles, row by row."""
        bends, entries = _together([one.bends_shape for one in self.patterns])
        for tile, bend in results([call.curvature(variables, weights) for call in self._curved]):
            tile.write(bend, bends)
        return entries

    def begin(self, variables: Float[np.ndarray, " n"], rows: int) -> None:
        """Begin to compile the second derivatives, of so many rows in all."""
        begin([call.curvature(variables, np.zeros(rows)) for call in self._curved])

    @property
    def _curved(self) -> list[Call]:
        return [call for call in self.calls if any(one.form.bends for one in call.tiles)]


def _together(shapes: list[tuple[int, ...]]) -> tuple[list[np.ndarray], np.ndarray]:
    """Arrays of some shapes, zero, and all their numbers side by side, which they share."""
    ends = list(accumulate(map(math.prod, shapes), initial=0))
    every = np.zeros(ends[-1])
    return [every[first:last].reshape(shape) for first, last, shape in zip(ends, ends[1:], shapes, strict=False)], every


def _entries_of(patterns: list[Pattern], family: int) -> slice:
    """Where the entries of a family's Jacobians stand among those of all."""
    first, last = (sum(math.prod(one.slopes_shape) for one in patterns[:end]) for end in (family, family + 1))
    return slice(first, last)


@final
@dataclass(frozen=True)
class Assembled:
    """Evaluates a program: its blocks by compiled functions, its matrices by assembly.

    - `blocks`: gives the rows of all blocks, and the entries of their Jacobians;
    - `slopes`: how the decisions act on signals and duration, where that is constant, shape (known, decisions);
    - `objective`: its row and its entries among those of all blocks, and the variables of these; `rates`: the rows of
      the rates at the points where the scheme asks for them.
    """

    rows: Rows
    slopes: SparseMatrix
    evaluated: Blocks
    blocks: Remembered[tuple[np.ndarray, np.ndarray]]
    jacobian: Jacobian
    curvature: Curvature
    objective: tuple[int, slice, np.ndarray]
    rates: Int[np.ndarray, "realisations asked rates"]

    @classmethod
    def of(
        cls,
        layout: Layout,
        traced: Problem,
        equations: Problem,
        constants: Constants,
        points: Float[np.ndarray, "realisations germs"],
        fit: Float[np.ndarray, "terms points"],
        given: Given,
    ) -> "Assembled":
        """That of a problem.

        - `equations`: a problem with the same rates and outputs, of which these are compiled.
        """
        every = families(layout, traced, constants, points, layout.numbers).every
        first, patterns = 0, []
        for one in every:
            patterns.append(Pattern.of(one, first))
            first += patterns[-1].rows.size
        slopes = constant_slopes(traced, layout)
        rows = rows_of(layout, [one.rows for one in patterns], fit, slopes, given)
        evaluated = Blocks(_calls(traced, equations, constants, layout, every, patterns), patterns)
        evaluated.begin(np.zeros(layout.count), first)
        objective = patterns[OBJECTIVE]
        return cls(
            rows,
            slopes,
            evaluated,
            Remembered(evaluated),
            Jacobian.of(rows.linear, rows.combined, patterns),
            Curvature.of(patterns, layout.count),
            (int(objective.rows.item()), _entries_of(patterns, OBJECTIVE), objective.entries[1]),
            patterns[RATES].rows,
        )

    def known(self, variables: Float[np.ndarray, " n"]) -> Float[np.ndarray, " known"]:
        """The signals at all mesh points, then the duration, as they follow from the decisions."""
        count, decisions = self.slopes.shape
        return self.blocks(variables)[0][:count] + self.slopes @ variables[:decisions]

    def rate_slopes(
        self, variables: Float[np.ndarray, " n"], sides: Int[np.ndarray, "asked seen"]
    ) -> Float[np.ndarray, "realisations asked rates columns"]:
        """The derivatives of the rates by what each block of them depends on: the signals and the states come last.

        Algebraic variables are eliminated by the derivatives of their equations at the `sides` where rates are asked.
        """
        slopes, equations = self._slopes(variables, RATES), self._slopes(variables, EQUATIONS)
        count = equations.shape[2]
        if not count:
            return slopes
        equations = equations[:, sides[:, 0]]
        following = np.linalg.solve(equations[..., -count:], equations[..., :-count])
        return slopes[..., :-count] - slopes[..., -count:] @ following

    def _slopes(
        self, variables: Float[np.ndarray, " n"], family: int
    ) -> Float[np.ndarray, "realisations places rows columns"]:
        patterns = self.evaluated.patterns
        return patterns[family].full(self.blocks(variables)[1][_entries_of(patterns, family)])

    def constraints(self, variables: Float[np.ndarray, " n"]) -> Float[np.ndarray, " rows"]:
        """The rows of the program."""
        return self.rows.linear @ variables + self.rows.combined @ self.blocks(variables)[0]

    def __call__(self, variables: Float[np.ndarray, " n"]) -> Evaluation:
        """The program at a point."""
        values, entries = self.blocks(variables)
        row, where, columns = self.objective
        gradient = np.zeros(variables.size)
        np.add.at(gradient, columns, entries[where])
        constraints = self.rows.linear @ variables + self.rows.combined @ values
        return Evaluation(float(values[row]), gradient, constraints, self.jacobian.at(entries))

    @property
    def hessian(self) -> Hessian:
        """The second derivatives of its Lagrangian."""
        row, *_ = self.objective
        back = self.rows.combined.T.tocsr()

        def evaluate(variables: np.ndarray, weight: float, multipliers: np.ndarray) -> SparseMatrix:
            weights = back @ multipliers
            weights[row] += weight
            return self.curvature.at(self.evaluated.curved(variables, weights))

        return Hessian(evaluate, self.curvature.sparsity)
