"""`Certificate`: what an answer is worth, all in one place."""

from dataclasses import dataclass
from typing import final

from aleator.solution._between import Between
from aleator.solution._expansion import ExpansionQuality
from aleator.solution._grid_error import GridError
from aleator.solution._opinion import SecondOpinion
from aleator.solution._worst_case import WorstCase


@final
@dataclass(frozen=True)
class Certificate:
    """What an answer is worth: of the program, of the grid, of the expansion, of the model. `print` shows it.

    - `violation`, `stationarity`, `complementarity`: residuals of the optimality conditions, scaled, computed from the
      point and its multipliers and not taken from the solver;
    - `expansion`: how far the expansions can be trusted;
    - `between`: how far limits over time are exceeded between instants; None where that was not checked;
    - `grid_error`: how far a finer grid and an integrator of another order differ; None where time plays no part;
    - `worst_case`: the worst realisations of limits on the worst case; None where there are none;
    - `opinion`: what a few fresh simulations at the answer say of the expansions; None where nothing is uncertain, or
      nothing was solved;
    - `misled`: where nothing was solved, a sentence on what the grid is far off at the start of the search; else empty.
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

    def rows(self) -> list[tuple[str, str]]:
        """What it says, a label and a text for each line."""
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
            *([("not seen", self.expansion.unseen.sentence())] if self.expansion.unseen else []),
        ]

    def __str__(self) -> str:
        return lines(self.rows())


def lines(rows: list[tuple[str, str]]) -> str:
    """Labels and texts, a line each."""
    return "\n".join(f"{label:<12} {text}" for label, text in rows)
