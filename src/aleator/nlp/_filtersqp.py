"""Uno's filterSQP: few variables, many dense rows, costly values."""

from dataclasses import dataclass
from typing import final

import numpy as np
from typing_extensions import override

from aleator._core import given
from aleator._core.errors import MissingExtraError
from aleator.nlp._answer import Answer
from aleator.nlp._ipopt import Ipopt
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._pattern import AnyPattern, pattern_of
from aleator.nlp._scaling import ScaledProgram
from aleator.nlp._uno import load_unopy, run_uno, uno_version

# With more pairs, the limited-memory Hessian costs more than it gains.
_LARGEST_MEMORY = 20


@final
@dataclass(frozen=True)
class FilterSQP(AbstractLocalSolver):
    """Sequential quadratic programming with a filter and a trust region, and BQPD subproblems.

    The Hessian is the program's own if it has one, else an L-BFGS approximation.
    Fletcher and Leyffer 2002, "Nonlinear programming without a penalty function", in the implementation of
    Vanaret and Leyffer 2026 (Uno, https://github.com/cvanaret/Uno). Points that cannot be evaluated shrink
    the trust region.

    - `tolerance`, `max_iterations`: see `AbstractLocalSolver`;
    - `radius`: initial trust region, in typical magnitudes of the variables.
    """

    radius: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        given.positive("FilterSQP: radius", self.radius)

    @override
    def require(self) -> None:
        load_unopy("FilterSQP")

    @property
    @override
    def name(self) -> str:
        return f"filterSQP (Uno {uno_version('FilterSQP')})"

    @override
    def minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        pattern = pattern_of(scaled.sparsity)
        answer = self._solved(scaled, pattern, scaled.start, multipliers, self.max_iterations)
        while pattern.outgrown and scaled.evaluations.halt is None and answer.iterations < self.max_iterations:
            pattern = pattern.widened()
            rows = None if answer.multipliers is None else answer.multipliers.rows
            left = self.max_iterations - answer.iterations
            again = self._solved(scaled, pattern, answer.point, rows, left)
            answer = again._replace(iterations=answer.iterations + again.iterations)
        return answer

    def _solved(
        self,
        scaled: ScaledProgram,
        pattern: AnyPattern,
        start: np.ndarray,
        multipliers: np.ndarray | None,
        iterations: int,
    ) -> Answer:
        options = {
            "QP_solver": "BQPD",
            "quasi_newton_memory_size": int(np.clip(2 * scaled.size, 6, _LARGEST_MEMORY)),
            "TR_radius": float(self.radius),
        }
        return run_uno(
            "filtersqp",
            scaled,
            pattern,
            start,
            multipliers,
            aim=self.aim,
            max_iterations=iterations,
            options=options,
        )


def default_solver() -> AbstractLocalSolver:
    """`FilterSQP()` if unopy is installed, else `Ipopt()`."""
    try:
        load_unopy("FilterSQP")
    except MissingExtraError:
        return Ipopt()
    return FilterSQP()
