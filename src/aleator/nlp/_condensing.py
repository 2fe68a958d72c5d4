"""Interior points for many realisations: what ties determine is eliminated in every iteration."""

from dataclasses import dataclass
from typing import final

import numpy as np
from typing_extensions import override

from aleator.nlp._answer import Answer
from aleator.nlp._condensed import IllConditionedError
from aleator.nlp._elimination import Elimination, SingularTiesError
from aleator.nlp._interior_search import Search, StuckError
from aleator.nlp._ipopt import Ipopt
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._scaling import ScaledProgram

# Most numbers of how tied variables follow the others: 2 GB.
_MOST_MOVES = 250_000_000


@final
@dataclass(frozen=True)
class Condensing(AbstractLocalSolver):
    """The primal-dual interior-point method with a filter line search, for programs with ties.

    The iterations are those of IPOPT (Wächter and Biegler 2006) with second-order corrections. In each, the variables
    that ties determine are eliminated: by levels, in which all realisations are solved at once, so that time grows in
    proportion to the number of realisations. A small dense system is left, in the other variables, whose eigenvalues
    say whether the curvature must be regularised.

    For programs with few variables that no tie determines (say up to a hundred), and a Hessian. IPOPT solves the
    others, and those where a tie does not determine its variable, where the system is too ill-conditioned (unstable
    realisations over a long time), or where no step is acceptable; the message then says why.

    - `tolerance`, `max_iterations`: see `AbstractLocalSolver`.
    """

    @property
    @override
    def name(self) -> str:
        return "condensing interior points"

    @override
    def minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        why, search = _unfit(scaled), None
        if not why:
            try:
                assert scaled.ties is not None
                search = Search(scaled, Elimination(scaled.ties, scaled.sparsity), self.aim)
                return search.run(multipliers, self.max_iterations, self.tolerance)
            except SingularTiesError as singular:
                why = str(singular)
            except IllConditionedError:
                why = "the condensed system is too ill-conditioned"
            except StuckError:
                why = "no step was acceptable"
        spent = 0 if search is None else search.iterations
        answer = Ipopt(self.tolerance, max(1, self.max_iterations - spent)).minimise(scaled, multipliers)
        return answer._replace(
            iterations=spent + answer.iterations, message=f"{answer.message} (by IPOPT, because {why})"
        )


def _unfit(scaled: ScaledProgram) -> str:
    """Why a program cannot be condensed; empty if it can."""
    if scaled.ties is None or not scaled.ties.rows.size:
        return "the program declares no ties"
    if scaled.curved is None or isinstance(scaled.sparsity, np.ndarray):
        return "the program declares no sparse Jacobian and Hessian"
    decided = scaled.size - scaled.ties.rows.size
    if decided * scaled.size > _MOST_MOVES:
        return f"{decided} variables that no tie determines are too many"
    return ""
