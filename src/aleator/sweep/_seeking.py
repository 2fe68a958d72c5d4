"""Solving the problems that lead to points of a front."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, TypeAlias, final

import numpy as np

from aleator._core.warned import warned_of
from aleator.design import Problem
from aleator.nlp import AbstractSearch, AbstractSolver, DifferentialEvolution, Slsqp
from aleator.solution import Solution
from aleator.solving import solve
from aleator.sweep._portfolio import Portfolio, portfolio
from aleator.sweep._wishes import Compromise, Design, Found
from aleator.transcription import AbstractTranscription

Start: TypeAlias = Solution | Mapping[str, Any] | None


@final
@dataclass(frozen=True)
class Seeker:
    """Solves problems of a front: by a solver, or the default ones for None; with so many local searches each.

    An executor does several of these at once.
    """

    transcription: AbstractTranscription
    solver: AbstractSolver | None
    starts: int
    executor: Executor | None

    def add(self, compromise: Compromise, found: Found, start: Start) -> Design | None:
        """Find the design of a compromise, which is kept with the others, or why there is none."""
        design, reason = self.sought(compromise, start)
        if design is None:
            found.failed.append(reason)
        else:
            found.designs.append(design)
        return design

    def sought(self, compromise: Compromise, start: Start) -> tuple[Design | None, str]:
        """The design of a compromise; or None, and why."""
        solution = self._local(compromise.problem, start)
        if self.starts > 1:
            with warned_of("trade_off"):
                other = self._portfolio(compromise.problem, None).best
            solution = min((one for one in (solution, other)), key=lambda one: (not one.ok, one.objective))
        return (compromise.design(solution), "") if solution.ok else (None, solution.why())

    def everywhere(self, problem: Problem) -> Start:
        """Where an objective is least everywhere, as far as a global search tells; None if none is asked for."""
        if self.starts == 1:
            return None
        lower, upper = (problem.placements.vector(name) for name in ("lower", "upper"))
        search = DifferentialEvolution() if np.isfinite(upper - lower).all() else None
        return self._portfolio(problem, search).best.decisions

    def _portfolio(self, problem: Problem, search: AbstractSearch | None) -> Portfolio:
        return portfolio(problem, self.starts, search=search, solver=self.solver, executor=self.executor)

    def _local(self, problem: Problem, start: Start) -> Solution:
        """The first solution of the ways tried; the last one if none is."""
        solution = None
        for solver, begun in self._ways(start):
            design = begun if isinstance(begun, Solution) else None
            values = None if isinstance(begun, Solution) else begun
            with warned_of("trade_off"):
                solution = solve(
                    problem,
                    solver,
                    transcription=self.transcription,
                    warm_start=design,
                    start=values,
                    throw=False,
                )
            if solution.ok:
                break
        assert solution is not None
        return solution

    def _ways(self, start: Start) -> Iterator[tuple[AbstractSolver | None, Start]]:
        """Solvers and starts to be tried; SLSQP makes ever longer steps where wishes are linear, others do not."""
        yield self.solver, start
        if start is not None:
            yield self.solver, None
        if self.solver is None:
            yield Slsqp(), start


def between(solutions: Sequence[Solution]) -> Mapping[str, Any] | None:
    """The means of the decisions of some solutions; None if they are of different shapes."""
    every = [one.decisions for one in solutions]
    if any(np.shape(one[name]) != np.shape(value) for one in every for name, value in every[0].items()):
        return None
    return {name: np.mean([one[name] for one in every], axis=0)[()] for name in every[0]}
