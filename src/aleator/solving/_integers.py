"""Branch and bound (Land and Doig 1960): the best integers and rows of tables, over solves in which they are relaxed.

A node leaves some rows of each table. Its relaxation is the same program with the box around these rows as bounds, so
that nothing is compiled anew, and starts from the node above. The node of the lowest optimum is looked at first: where
that lies on rows, these are decided and the problem is solved as any other, with all stages and the certificate; else
the node is divided at the value of a column. Where there are few combinations, each is a node from the beginning.
"""

import heapq
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import Any, NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from aleator._core.errors import ProblemError
from aleator.design import Problem, in_quantiles, with_simulation
from aleator.ensemble import listed
from aleator.nlp import AbstractLocalSolver, AbstractSolver, Outcome, Status
from aleator.solution import Branching, Solution
from aleator.transcription import AbstractTranscribed, AbstractTranscription, transcribe
from aleator.uncertainty import tables_of, with_decisions

Full = Callable[[Problem, Mapping[str, Any]], Solution]
Rows = tuple[int, ...]
Left = tuple[Int[np.ndarray, "..."], ...]  # of each table, rows of different numbers

# Combinations that are solved one by one: no relaxation is needed, whose optimum may be anywhere.
_LISTED = 30
# The most nodes that are solved.
_MOST = 2000
# The most iterations of one: a node that takes more, as impossible ones may, is divided or solved in full.
_ITERATIONS = 100
# How near a relaxed number is to one of a table, as a part of the table's range, to be that, and a part of an objective
# by which another one must be better.
_SAME = 1e-6


class Node(NamedTuple):
    """Rows that are left of each table, and the optimum over the box around them."""

    bound: float
    size: int
    number: int
    left: Left
    point: Float[np.ndarray, " variables"]


@final
@dataclass
class Tree:
    """The nodes of one search.

    - `problem`: as it was declared; `transcribed`: as it is searched;
    - `full`: the complete solution of a problem whose integers and choices have one value, from a start by name;
    - `nodes`: the outcomes of all nodes; `open`: nodes to look at; `tried`: rows that were solved in full;
    - `answer`: the best solution so far; `passed`: those that are none or were refused, though a node met the limits,
      with the optimum of their nodes and the rows.
    """

    problem: Problem
    transcribed: AbstractTranscribed
    solver: AbstractSolver
    full: Full
    nodes: list[Outcome] = field(default_factory=list)
    open: list[Node] = field(default_factory=list)
    tried: set[Rows] = field(default_factory=set)
    answer: Solution | None = None
    passed: list[tuple[float, Rows, Solution | ProblemError]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.places = self.transcribed.places
        self.tables = tables_of(self.places)
        self.every: Left = tuple(np.arange(len(table.rows)) for table in self.tables)
        self.combinations = math.prod(map(len, self.every))

    def grow(self, left: Left, start: np.ndarray, bound: float = -np.inf) -> None:
        """Solve a node, and keep it open unless its limits cannot be met. Its optimum is not below its parent's."""
        lower, upper = self.transcribed.program.lower.copy(), self.transcribed.program.upper.copy()
        for table, rows in zip(self.tables, left, strict=True):
            where = self.transcribed.decided[table.where]
            lower[where], upper[where] = table.rows[rows].min(axis=0), table.rows[rows].max(axis=0)
        program = replace(self.transcribed.program, lower=lower, upper=upper)
        outcome = self.solver.solve(program, start=np.clip(start, lower, upper))
        self.nodes.append(outcome)
        if outcome.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if outcome.status is not Status.INFEASIBLE:
            own = outcome.evaluation.objective if outcome.ok else -np.inf  # a search that failed says nothing
            node = Node(max(own, bound), math.prod(map(len, left)), len(self.nodes), left, outcome.point)
            heapq.heappush(self.open, node)

    def distances(self, left: Left, point: np.ndarray) -> list[Float[np.ndarray, "..."]]:
        """How far the numbers at a point are from each row that is left, as parts of the ranges."""
        numbers, each = self.transcribed.decisions(point), zip(self.tables, left, strict=True)
        return [np.abs(table.rows[rows] - numbers[table.where]) / table.spans for table, rows in each]

    def nearest_rows(self, left: Left, point: np.ndarray) -> tuple[Rows, float]:
        """The rows that are nearest to the numbers at a point, and how far they are."""
        away = [one.max(axis=1) for one in self.distances(left, point)]
        rows = tuple(int(of_table[np.argmin(one)]) for of_table, one in zip(left, away, strict=True))
        return rows, max(float(one.min()) for one in away)

    def divide(self, node: Node) -> None:
        """Solve both parts of a node: where its numbers are furthest from any row, else in the longest table."""
        away = self.distances(node.left, node.point)
        free = [i for i, rows in enumerate(node.left) if len(rows) > 1]
        i = max(free, key=lambda i: (round(float(away[i].max(axis=1).min()), 6), len(node.left[i])))
        table, rows = self.tables[i], self.tables[i].rows[node.left[i]]
        column = int(np.argmax(np.where(np.ptp(rows, axis=0) > 0, 1.0 + away[i].min(axis=0), 0.0)))
        values, number = rows[:, column], self.transcribed.decisions(node.point)[table.where[column]]
        below = values <= number + _SAME * table.spans[column]
        below = values < values.max() if below.all() else below
        for part in (below, ~below):
            left = (*node.left[:i], node.left[i][part], *node.left[i + 1 :])
            self.grow(left, node.point, node.bound)

    def numbers(self, rows: Rows, vector: np.ndarray) -> dict[str, Any]:
        """The decisions by name: some rows, and the other numbers of a vector."""
        vector = vector.copy()
        for table, row in zip(self.tables, rows, strict=True):
            vector[table.where] = table.rows[row]
        return self.places.named(np.clip(vector, self.places.vector("lower"), self.places.vector("upper")))

    def decided(self, rows: Rows, point: np.ndarray) -> Solution:
        """The complete solution with some rows, from the other numbers of a point."""
        values = self.numbers(rows, self.transcribed.decisions(point))

        def held(name: str, one: Any) -> Any:
            ends = (float(values[name]),) * 3 if one.values is not None else (one.initial, one.lower, one.upper)
            return eqx.tree_at(lambda leaf: (leaf.initial, leaf.lower, leaf.upper), one, ends)

        return self.full(_with_decisions(self.problem, held), values)

    def complete(self, rows: Rows, node: Node) -> float:
        """Solve with some rows in full, from a node. Returns the objective; infinite where that is no answer."""
        self.tried.add(rows)
        try:
            solution = self.decided(rows, node.point)
        except ProblemError as error:
            self.passed.append((node.bound, rows, error))
            return np.inf
        if solution.ok:
            self.answer = min((one for one in (self.answer, solution) if one), key=lambda one: one.objective)
            return solution.objective
        if solution.status is not Status.INFEASIBLE:
            self.passed.append((node.bound, rows, solution))
        return np.inf

    def step(self) -> None:
        """Solve the node of the lowest bound in full where it lies on rows, and divide it if others may be better."""
        node = heapq.heappop(self.open)
        rows, away = self.nearest_rows(node.left, node.point)
        is_new = away <= _SAME and rows not in self.tried
        try:
            objective = self.complete(rows, node) if is_new else np.inf
            if node.size > 1 and objective > node.bound and not math.isclose(objective, node.bound, rel_tol=_SAME):
                self.divide(node)
        except KeyboardInterrupt:
            heapq.heappush(self.open, node)
            raise

    @property
    def bound(self) -> float:
        """What no open node can fall below."""
        return min((node.bound for node in self.open), default=np.inf)

    @property
    def is_over(self) -> bool:
        """Whether no open node can be better than the answer."""
        answer = np.inf if self.answer is None else self.answer.objective
        return not self.open or self.bound >= answer - _SAME * abs(answer) > -np.inf


def branched(
    problem: Problem,
    transcription: AbstractTranscription,
    solver: AbstractSolver,
    first: Float[np.ndarray, " n"] | None,
    full: Full,
) -> Solution:
    """The solution with the best integers and rows of tables, and how it was found.

    - `first`: the decisions to start from; `full`: see `Tree`.
    """
    transcribed = transcribe(in_quantiles(problem), transcription)
    start = transcribed.program.start if first is None else transcribed.point(first)
    if isinstance(solver, AbstractLocalSolver):
        solver = replace(solver, max_iterations=min(solver.max_iterations, _ITERATIONS))
    tree, interrupted = Tree(problem, transcribed, solver, full), False
    is_listed = tree.combinations <= _LISTED
    try:
        for left in itertools.product(*tree.every) if is_listed else [tree.every]:
            tree.grow(tuple(map(np.atleast_1d, left)), start)
        while not tree.is_over and len(tree.nodes) < _MOST:
            tree.step()
        if tree.answer is None and tree.open:
            node = tree.open[0]
            tree.complete(tree.nearest_rows(node.left, node.point)[0], node)
    except KeyboardInterrupt:
        if tree.answer is None:
            raise
        interrupted = True
    if tree.answer is None:
        return _as_declared(_unsolved(tree), tree, None)
    objective, lowest, in_words = tree.answer.objective, tree.bound, ""
    better = [one for one in tree.passed if -np.inf < one[0] < objective - _SAME * abs(objective)]
    if better:
        bound, rows, _ = min(better, key=itemgetter(0))
        named = tree.numbers(rows, tree.places.vector("initial"))
        chosen = {name: named[name] for name, one in tree.places.decisions.items() if one.decision.values is not None}
        lowest, in_words = min(lowest, bound), f"{listed(chosen)} (objective {bound:.6g})"
    alone = sum(len(table.where) for table in tree.tables) == tree.places.size
    branching = Branching(
        combinations=tree.combinations,
        nodes=len(tree.nodes),
        passed_over=len(tree.passed),
        listed=is_listed,
        bound=min(lowest, objective),
        gap=max(0.0, objective - lowest),
        better=in_words,
        is_finished=tree.is_over,
        is_proven=is_listed and tree.is_over and alone and not tree.passed,
    )
    answer = replace(tree.answer, status=Status.INTERRUPTED) if interrupted else tree.answer
    return _as_declared(answer, tree, branching)


def _unsolved(tree: Tree) -> Solution:
    """What is said where no combination is an answer: the first whose certificate failed, else the least violated."""
    for _, _, one in tree.passed:
        if isinstance(one, ProblemError):
            raise one
        return one
    point = min(tree.nodes, key=lambda one: np.nan_to_num(one.violation, nan=np.inf)).point
    solution = tree.decided(tree.nearest_rows(tree.every, point)[0], point)
    said = f"None of {tree.combinations} combinations of integers and choices was found to meet all limits"
    return replace(solution, message=f"{said}. {solution.message}".strip())


def _as_declared(solution: Solution, tree: Tree, branching: Branching | None) -> Solution:
    """The solution of the problem as it was declared, in which integers and choices are free again."""
    chosen = {name: one.decision for name, one in tree.places.decisions.items() if one.decision.values is not None}
    at_ends = {name for name, one in chosen.items() if solution.decisions[name] in (one.lower, one.upper)}
    iterations, evaluations = (sum(getattr(one, of) for one in tree.nodes) for of in ("iterations", "evaluations"))
    effort = replace(
        solution.effort,
        iterations=solution.effort.iterations + iterations,
        evaluations=solution.effort.evaluations + evaluations,
    )
    return replace(
        solution,
        problem=_with_decisions(solution.problem, lambda name, one: chosen.get(name, one)),
        at_bounds=tuple(name for name in solution.at_bounds if name not in chosen or name in at_ends),
        effort=effort,
        branching=branching,
    )


def _with_decisions(problem: Problem, choose: Callable[[str, Any], Any]) -> Problem:
    return with_simulation(problem, with_decisions(problem.simulation, choose))
