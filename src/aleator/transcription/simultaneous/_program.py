"""The sparse program that the blocks of a simultaneous transcription make, as solvers see it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int

from aleator._core.dependence import Dependence
from aleator.design import Problem, Value
from aleator.nlp import Evaluation, Hessian, NonlinearProgram, SparseMatrix
from aleator.statistics import Constants
from aleator.transcription._abstract import Remembered
from aleator.transcription._constraints import Sizing, decision_scales, least_objective, row_bounds, spread
from aleator.transcription._discretised import Scenarios
from aleator.transcription.simultaneous._assembly import (
    Curvature,
    Jacobian,
    Pattern,
    Rows,
    rows_of,
    without_affine,
)
from aleator.transcription.simultaneous._blocks import Family
from aleator.transcription.simultaneous._families import EQUATIONS, KNOWN, RATES, families, number_of, objective_of
from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._magnitudes import scales, tie_sizes
from aleator.transcription.simultaneous._tiles import Call, begin, calls_of, results, tile_size, tiles_of

# The families that grow with the mesh.
_MOVING = RATES, EQUATIONS


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
    scheme, count, begun = layout.plan.scheme, len(layout.phases), dict[int, int]()
    meshes = [
        replace(one.mesh, nodes=(*one.pointwise.grid.fractions.tolist(),), scheme=scheme) for one in layout.phases
    ]
    first = replace(layout.plan, meshes=tuple(meshes))
    for mesh, one in zip(meshes, layout.phases, strict=True):
        begun[len(one.recorded)] = len(mesh.fractions if first.is_everywhere else one.recorded)
    sizes = [(len(one.own), begun.get(one.own.shape[1], one.own.shape[1])) for one in every]
    growing = {kind: [number_of(kind, i, count) for i in range(count)] for kind in (KNOWN, *_MOVING)}
    for i, mesh in enumerate(meshes):
        for kind, blocks in ((RATES, mesh.asked), (EQUATIONS, mesh.sides)):
            sizes[growing[kind][i]] = tile_size(sizes[growing[kind][i]][0], len(blocks))
    tiles = [tiles_of(i, one, patterns[i], sizes[i]) for i, one in enumerate(every)]
    rows = [one.rows.size for one in patterns]
    some_moving = [i for kind in _MOVING for i in growing[kind] if rows[i]]
    moving = [calls_of(equations, None, scheme.rate, [(one,) for one in tiles[i]]) for i in some_moving]
    signals = [] if layout.plan.is_affine else [i for i in growing[KNOWN] if rows[i]]
    known = [one for i in signals for one in calls_of(traced, constants, layout.plan, [tuple(tiles[i])])]
    apart = {i for some in growing.values() for i in some}
    rest = [some for i, some in enumerate(tiles) if i not in apart and rows[i] and not patterns[i].affine]
    # Few of them grow with the mesh, where paths are recorded: with more tiles of these the others are repeated.
    count = max(map(len, rest), default=0)
    together = [tuple(some[min(k, len(some) - 1)] for some in rest) for k in range(count)]
    # Numbers by name are those of the problem's own decisions, whose number grows with those of its controls.
    has_names = any(isinstance(leaf, Value) for one in traced.expressions for leaf in one.leaves)
    still = calls_of(traced if has_names else equations, constants, first, together) if together else []
    return [call for some in (*moving, known, still) for call in some]


@final
@dataclass(frozen=True)
class Blocks:
    """All blocks of a program, family by family. `constant`: the rows of those that are not evaluated, else zero."""

    calls: list[Call]
    patterns: list[Pattern]
    constant: Float[np.ndarray, " rows"]

    def __call__(
        self, variables: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " entries"]]:
        """The rows of all blocks, and the entries of their Jacobians."""
        values, rows = _together([one.rows.shape for one in self.patterns])
        slopes, entries = _together([one.slopes_shape for one in self.patterns])
        for tile, (value, slope) in results(self.calls, variables):
            tile.write(value, values[tile.form.family])
            tile.write(slope, slopes[tile.form.family])
        return rows + self.constant, entries

    def curved(
        self, variables: Float[np.ndarray, " n"], weights: Float[np.ndarray, " rows"]
    ) -> Float[np.ndarray, " entries"]:
        """The entries of the Hessians of all blocks, their rows weighted: lower triangles, row by row."""
        bends, entries = _together([one.bends_shape for one in self.patterns])
        for tile, bend in results(self._curved, variables, weights):
            tile.write(bend, bends[tile.form.family])
        return entries

    def rates(
        self, number: int, family: Family, variables: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "outer inner rates"]:
        """The rates of other blocks, whose family holds the numbers of their variables, by the same compiled code.

        - `number`: of the family of the rates of the same phase.
        """
        shape = *family.own.shape[:2], self.patterns[number].rows.shape[2]
        pattern = replace(self.patterns[number], columns=family.own, rows=np.arange(math.prod(shape)).reshape(shape))
        own, rates = [one for one in self.calls if one.tiles[0].form.family == number], np.zeros(shape)
        tiles = tiles_of(number, family, pattern, own[0].tiles[0].form.rows[:2]) if own else []
        for tile, (value, _) in results([Call((one,), own[0].evaluate, own[0].curve) for one in tiles], variables):
            tile.write(value, rates)
        return rates

    def begin(self, variables: Float[np.ndarray, " n"], rows: int) -> None:
        """Begin to compile the second derivatives, of so many rows in all."""
        begin(self._curved, variables, np.zeros(rows))

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
    - `affine`: how variables act on the rows of blocks beside these entries; `gradient`: on the objective;
    - `objective`: its row and its entries among those of all blocks, and the variables of these; `rates`: the rows of
      the rates of each phase at the points where the scheme asks for them; `dependences`: of each family's blocks.
    """

    rows: Rows
    affine: SparseMatrix
    gradient: Float[np.ndarray, " variables"]
    evaluated: Blocks
    blocks: Remembered[tuple[np.ndarray, np.ndarray]]
    jacobian: Jacobian
    curvature: Curvature
    objective: tuple[int, slice, np.ndarray]
    rates: tuple[Int[np.ndarray, "realisations _ _"], ...]
    dependences: list[Dependence]

    @classmethod
    def of(
        cls,
        layout: Layout,
        traced: Problem,
        equations: Problem,
        constants: Constants,
        points: Float[np.ndarray, "realisations germs"],
        fit: Float[np.ndarray, "terms points"],
        signals: Sequence[tuple[Float[np.ndarray, " known"], SparseMatrix]],
        before: "Assembled | None",
    ) -> "Assembled":
        """That of a problem.

        - `equations`: a problem with the same rates and outputs, of which these are compiled;
        - `signals`: see `affine_signals`, of each phase; none where they are evaluated;
        - `before`: that of a problem with the same equations on another mesh.
        """
        every = families(layout, traced, constants, points, layout.numbers).every
        known = [None] * len(every) if before is None else before.dependences
        first, patterns, dependences = 0, [], []
        for i, (one, depends) in enumerate(zip(every, known, strict=True)):
            # All but the signals have the same blocks on every mesh.
            is_known = depends is not None and i >= len(layout.phases) and depends.first.shape[1] == one.width
            dependences.append(depends if is_known else one.dependence)
            patterns.append(Pattern.of(one, dependences[-1], first))
            first += patterns[-1].rows.size
        constant, affine, patterns = without_affine(layout, every, patterns, signals)
        rows = rows_of(layout, [one.rows for one in patterns], fit, affine)
        evaluated = Blocks(_calls(traced, equations, constants, layout, every, patterns), patterns, constant)
        evaluated.begin(np.zeros(layout.count), first)
        count = len(layout.phases)
        number = objective_of(count)
        objective = patterns[number]
        return cls(
            rows,
            affine,
            affine[[objective.rows.item()]].toarray()[0],
            evaluated,
            Remembered(evaluated),
            Jacobian.of(rows.linear, rows.combined, patterns),
            Curvature.of(patterns, layout.count),
            (int(objective.rows.item()), _entries_of(patterns, number), objective.entries[1]),
            tuple(patterns[number_of(RATES, i, count)].rows for i in range(count)),
            dependences,
        )

    def known(self, variables: Float[np.ndarray, " n"]) -> Float[np.ndarray, " known"]:
        """What is `Layout.known`, as it follows from the decisions."""
        count = sum(one.rows.size for one in self.evaluated.patterns[: len(self.rates)])
        return self.blocks(variables)[0][:count] + self.affine[:count] @ variables

    def rate_slopes(
        self, variables: Float[np.ndarray, " n"], phase: int, sides: Int[np.ndarray, "asked seen"]
    ) -> Float[np.ndarray, "realisations asked rates columns"]:
        """The derivatives of the rates of a phase by what each block of them depends on: the states come last.

        Algebraic variables are eliminated by the derivatives of their equations at the `sides` where rates are asked.
        """
        numbers = (number_of(kind, phase, len(self.rates)) for kind in (RATES, EQUATIONS))
        slopes, equations = (self._slopes(variables, number) for number in numbers)
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
        gradient = self.gradient.copy()
        value = values[row] + gradient @ variables
        np.add.at(gradient, columns, entries[where])
        return Evaluation(float(value), gradient, self.constraints(variables), self.jacobian.at(entries))

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


def _determined(
    assembled: Assembled, start: Float[np.ndarray, " variables"], is_fixed: Bool[np.ndarray, " variables"]
) -> tuple[Bool[np.ndarray, " ties"], Float[np.ndarray, " variables"]]:
    """Whether a variable follows from fixed ones alone, by its tie and others; and a point where these hold."""
    ties, point, is_fixed = assembled.rows.ties, start.copy(), is_fixed.copy()
    entries = assembled.jacobian.sparsity.astype(bool)[ties.rows].astype(int)
    own = np.ravel(assembled.rows.linear[ties.rows, ties.variables]) == 1
    while (following := own & (entries @ ~is_fixed == 1) & ~is_fixed[ties.variables]).any():
        which = ties.variables[following]
        point[which] -= np.nan_to_num(assembled.constraints(point)[ties.rows[following]])
        is_fixed[which] = True
    return is_fixed[ties.variables], point


def program_of(
    problem: Problem,
    scenarios: Scenarios | None,
    layout: Layout,
    assembled: Assembled,
    start: Float[np.ndarray, " variables"],
) -> tuple[NonlinearProgram, tuple[float, ...]]:
    """The program, and the sizes of each of the problem's constraints at its start."""
    rows, evaluation = assembled.rows, assembled(start)
    typical = decision_scales(*(problem.placements.vector(name) for name in ("initial", "lower", "upper")))
    away, spreads, numbers = len(rows.own) * [0.0], len(rows.own) * [np.inf], layout.numbers

    def judged(
        point: Float[np.ndarray, " variables"], evaluation: Evaluation
    ) -> tuple[Float[np.ndarray, " variables"], list[float], Float[np.ndarray, " m"]]:
        """The magnitudes of variables, of the problem's constraints, and of all rows, at a point."""
        scale = scales(layout, rows.ties, point, evaluation, typical)
        values, slopes = ([part[one] for one in rows.own] for part in (evaluation.constraints, evaluation.jacobian))
        sizes = Sizing(problem.constraints, rows.own, scale, away, spreads).each(point, values, slopes)
        return scale, sizes, np.append(spread(rows.own, sizes), tie_sizes(layout, rows.ties, evaluation, scale))

    scale, sizes, every = judged(start, evaluation)
    lowest, highest = np.full(layout.count, -np.inf), np.full(layout.count, np.inf)
    lowest[numbers.decisions], highest[numbers.decisions] = map(problem.placements.vector, ("lower", "upper"))
    lowest[layout.fixed] = highest[layout.fixed] = start[layout.fixed]
    for phase, own in zip(layout.phases, numbers.phases, strict=True):
        if phase.pointwise.is_open:
            lowest[own.duration], highest[own.duration] = 0.0, float(phase.pointwise.grid.duration)
    own_lower, own_upper = row_bounds(problem.constraints, rows.own, scenarios, sizes)
    # A spread of zero whatever is decided, such as that of a certain start, has no derivative: it is no variable.
    is_certain, certain = _determined(assembled, start, lowest == highest)
    is_certain &= np.isin(rows.ties.variables, [i for one in numbers.coefficients for i in one[1:].flat])
    which, tied = rows.ties.variables[is_certain], np.where(is_certain, np.inf, 0.0)
    start = start.copy()
    start[which] = lowest[which] = highest[which] = certain[which]
    program = NonlinearProgram(
        evaluate=assembled,
        start=start,
        lower=lowest,
        upper=highest,
        constraint_lower=np.append(own_lower, -tied),
        constraint_upper=np.append(own_upper, tied),
        constraint_scale=every,
        variable_scale=scale,
        sparsity=assembled.jacobian.sparsity,
        hessian=assembled.hessian,
        sizes=lambda point, evaluation: judged(point, evaluation)[2],
        least=least_objective(problem),
        breadth=max(own.states.shape[2] for own in numbers.phases),
    )
    return program, tuple(sizes)
