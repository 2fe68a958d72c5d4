"""Uno's interior-point method: many sparse variables, and a second opinion on IPOPT."""

from dataclasses import dataclass
from typing import final

import numpy as np
from typing_extensions import override

from aleator.nlp._answer import Answer
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._pattern import pattern_of
from aleator.nlp._scaling import ScaledProgram
from aleator.nlp._uno import load_unopy, run_uno, uno_version


@final
@dataclass(frozen=True)
class InteriorPoint(AbstractLocalSolver):
    """The primal-dual interior-point method with a filter line search of IPOPT, in Uno's implementation.

    For programs with sparse derivatives and a Hessian of their own (`NonlinearProgram.hessian`); without one the
    Hessian is a limited-memory approximation. Vanaret and Leyffer 2026 (Uno, https://github.com/cvanaret/Uno), preset
    `ipopt`, with MUMPS.

    - `tolerance`, `max_iterations`: see `AbstractLocalSolver`.
    """

    @override
    def require(self) -> None:
        load_unopy("InteriorPoint")

    @property
    @override
    def name(self) -> str:
        return f"interior points (Uno {uno_version('InteriorPoint')})"

    @override
    def minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        return run_uno(
            "ipopt",
            scaled,
            pattern_of(scaled.sparsity),
            scaled.start,
            multipliers,
            aim=self.aim,
            max_iterations=self.max_iterations,
        )
