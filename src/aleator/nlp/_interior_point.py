"""Uno's interior-point method: many sparse decisions, and a second opinion on IPOPT."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from aleator.nlp._pattern import pattern_of
from aleator.nlp._scaling import ScaledProgram
from aleator.nlp._solver import AbstractSolver
from aleator.nlp._uno import answer_of, load_unopy, model_of
from aleator.nlp._verdict import Answer


@final
@dataclass(frozen=True)
class InteriorPoint(AbstractSolver):
    """Primal-dual interior points with a filter line search, as IPOPT does it, in Uno's implementation.

    For programs with sparse derivatives and a Hessian of their own (`NonlinearProgram.hessian`); without one the
    Hessian is of limited memory. Vanaret and Leyffer 2026 (Uno, https://github.com/cvanaret/Uno), preset `ipopt`, with
    MUMPS.
    """

    def _require(self) -> None:
        load_unopy("InteriorPoint")

    def _name(self) -> str:
        return f"interior points (Uno {load_unopy('InteriorPoint').current_uno_version()})"

    def _minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        unopy = load_unopy("InteriorPoint")
        solver = unopy.UnoSolver()
        solver.set_preset("ipopt")
        for option, value in self._options(scaled).items():
            solver.set_option(option, value)
        pattern = pattern_of(scaled.structure)
        solver.set_termination_callback(lambda *_: scaled.evaluations.halt is not None)
        return answer_of(solver.optimize(model_of(unopy, scaled, pattern, scaled.start, multipliers)))

    def _options(self, scaled: ScaledProgram) -> dict[str, Any]:
        return {
            "hessian_model": "LBFGS" if scaled.curved is None else "exact",
            "primal_tolerance": self.aim,
            "dual_tolerance": self.aim,
            "residual_norm": "INF",
            "max_iterations": self.max_iterations,
            "logger": "SILENT",
        }
