"""`Certificate`: how far an answer can be trusted."""

from dataclasses import dataclass
from typing import final

from aleator._core.shown import Printed
from aleator.solution._between import Between
from aleator.solution._expansion import ExpansionQuality
from aleator.solution._grid_error import GridError
from aleator.solution._opinion import SecondOpinion
from aleator.solution._worst_case import WorstCase


@final
@dataclass(frozen=True)
class Certificate(Printed):
    """How far an answer can be trusted: program, grid, expansion and model. `print` shows it.

    - `violation`, `stationarity`, `complementarity`: scaled residuals of the optimality conditions, recomputed from the
      point and its multipliers instead of taken from the solver;
    - `expansion`: the quality of the expansions;
    - `between`: how far limits over time are exceeded between instants; None if that was not checked;
    - `grid_error`: the difference to a finer grid with an integrator of another order; None for models without time;
    - `worst_case`: the worst realisations of limits on the worst case; None if there are no such limits;
    - `opinion`: fresh simulations at the answer, compared with the expansions; None if nothing is uncertain or nothing
      was solved;
    - `misled`: if nothing was solved, a sentence on large errors of the grid at the start of the search, or, of an
      infeasible problem, on a limit that the grid does not resolve at the least violated point; else empty;
    - `correlations`: which correlations of uncertain numbers are not those given, for decisions set their shapes.
    """

    violation: float
    stationarity: float
    complementarity: float
    expansion: ExpansionQuality
    between: Between | None = None
    grid_error: GridError | None = None
    worst_case: WorstCase | None = None
    opinion: SecondOpinion | None = None
    misled: str = ""
    correlations: str = ""

    def rows(self) -> list[tuple[str, str]]:
        """A label and a text for each printed line."""
        residuals = (
            f"violation {self.violation:.1e}, stationarity {self.stationarity:.1e}, "
            f"complementarity {self.complementarity:.1e} (scaled)"
        )
        return [
            *([] if self.between is None else [("between", self.between.sentence())]),
            *([] if self.grid_error is None else [("grid", str(self.grid_error))]),
            *(("worst case", row) for row in (self.worst_case.rows() if self.worst_case else ())),
            ("certificate", residuals),
            ("expansion", str(self.expansion)),
            *([("derivatives", self.expansion.tangent_sentence())] if self.expansion.worst_tangent else []),
            *([("fresh", self.opinion.sentence())] if self.opinion else []),
            *([("correlated", self.correlations)] if self.correlations else []),
            *([("not seen", self.expansion.unseen.sentence())] if self.expansion.unseen else []),
        ]

    def __str__(self) -> str:
        return lines(self.rows())


def lines(rows: list[tuple[str, str]]) -> str:
    """Labels and texts as text, one pair a line."""
    return "\n".join(f"{label:<12} {text}" for label, text in rows)
