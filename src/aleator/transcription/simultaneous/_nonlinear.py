"""A simultaneous program as solvers see it: bounds, magnitudes, and where it starts."""

from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Float

from aleator.design import Problem
from aleator.nlp import Evaluation, Magnitudes, NonlinearProgram
from aleator.transcription._constraints import Sizing, decision_scales, least_objective, row_bounds, spread
from aleator.transcription._scenarios import Scenarios
from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._program import Assembled
from aleator.transcription.simultaneous._rows import Given
from aleator.transcription.simultaneous._scales import scales, tie_sizes


@final
@dataclass(frozen=True)
class _Judge:
    """Judges variables and rows by their magnitudes at a point.

    - `typical`: magnitudes of the decisions; `sizing`: of the problem's own rows.
    """

    layout: Layout
    assembled: Assembled
    typical: Float[np.ndarray, " n"]
    sizing: Sizing

    def scales(self, point: Float[np.ndarray, " variables"], evaluation: Evaluation) -> np.ndarray:
        """Of the variables."""
        return scales(self.layout, self.assembled.rows.ties, point, evaluation, self.typical)

    def ties(self, scale: Float[np.ndarray, " variables"], evaluation: Evaluation) -> np.ndarray:
        """Of the ties, from those of the variables."""
        return tie_sizes(self.layout, self.assembled.rows.ties, evaluation, scale)

    def __call__(self, point: Float[np.ndarray, " variables"], evaluation: Evaluation) -> Magnitudes:
        """Of all rows."""
        scale = self.scales(point, evaluation)
        size, by = replace(self.sizing, decision_scale=scale).at(point, evaluation)
        tied = self.ties(scale, evaluation)
        return Magnitudes(np.append(size, tied), np.append(by, tied))


def program_of(
    problem: Problem,
    scenarios: Scenarios | None,
    layout: Layout,
    assembled: Assembled,
    given: Given,
    start: Float[np.ndarray, " variables"],
) -> tuple[NonlinearProgram, tuple[float, ...]]:
    """The program, and the sizes of each of the problem's constraints at its start."""
    rows, evaluation = assembled.rows, assembled(start)
    typical = decision_scales(*(problem.placements.vector(name) for name in ("initial", "lower", "upper")))
    sizing = Sizing(problem.constraints, rows.own, np.ones(layout.count), [0.0] * len(rows.own))
    judge = _Judge(layout, assembled, typical, sizing)
    scale = judge.scales(start, evaluation)
    values, slopes = ([part[one] for one in rows.own] for part in (evaluation.constraints, evaluation.jacobian))
    sizes = replace(sizing, decision_scale=scale).each(start, values, slopes)
    lowest, highest = _bounds(problem, layout, given, start)
    own_lower, own_upper = row_bounds(problem.constraints, rows.own, scenarios)
    tied = np.zeros(len(rows.ties.variables))
    program = NonlinearProgram(
        evaluate=assembled,
        start=start,
        lower=lowest,
        upper=highest,
        constraint_lower=np.append(own_lower, tied),
        constraint_upper=np.append(own_upper, tied),
        constraint_scale=np.append(spread(rows.own, [one.scale for one in sizes]), judge.ties(scale, evaluation)),
        variable_scale=scale,
        sparsity=assembled.jacobian.sparsity,
        hessian=assembled.hessian,
        magnitudes=judge,
        least=least_objective(problem),
        ties=rows.ties,
    )
    return program, tuple(one.size for one in sizes)


def _bounds(problem: Problem, layout: Layout, given: Given, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of all variables: those of the decisions, and the values of what is the same at all decisions."""
    lowest, highest = np.full(layout.count, -np.inf), np.full(layout.count, np.inf)
    numbers = layout.numbers
    lowest[numbers.decisions], highest[numbers.decisions] = map(problem.placements.vector, ("lower", "upper"))
    for is_given, some in zip(given, (numbers.signals, numbers.duration), strict=True):
        if is_given:
            lowest[some] = highest[some] = start[some]
    return lowest, highest
