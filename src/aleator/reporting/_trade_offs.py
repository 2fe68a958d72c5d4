"""Figures, tables and facts of trade-offs: wishes against one another."""

import html
from typing import TYPE_CHECKING

import numpy as np

from aleator._core.errors import ProblemError
from aleator.reporting._fronts import decided_in, numbers_in
from aleator.reporting._numbers import number, unit_of_expression, words
from aleator.reporting._page import Table
from aleator.reporting._style import FONT, GRID, INK, MUTED, SIZE, blank, draw, label, looks
from aleator.reporting.drawn import AbstractPlots, Facts, facts_of, plots_of, unknown
from aleator.sweep import TradeOff

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def _units(front: TradeOff) -> list[str]:
    """The units of the wishes; empty where they are unknown."""
    known = front.solutions[0].problem if front.solutions else None
    return ["" if known is None else unit_of_expression(wish, known) for wish in front.wishes]


def _labels(front: TradeOff) -> list[str]:
    return [label(name, unit) for name, unit in zip(front.names, _units(front), strict=True)]


def _texts(front: TradeOff) -> list[str]:
    """The numbers of each design, to be shown over its point."""
    wishes, units = [label(name) for name in front.names], _units(front)
    rows = [[number(float(value), 5, unit) for value, unit in zip(row, units, strict=True)] for row in front.values]
    return ["<br>".join(f"{name}: {text}" for name, text in zip(wishes, row, strict=True)) for row in rows]


def pair_figure(front: TradeOff, first: int, second: int) -> "Figure":
    """Two wishes, by their places among `front.names`, against one another."""
    figure = blank(*(_labels(front)[i] for i in (first, second)))
    look, (x, y) = looks(["design"])["design"], (front.values[:, i] for i in (first, second))
    line = {"line_color": look.fill(0.4), "line_width": 1.5} if len(front.names) == 2 else {"mode": "markers"}
    draw(figure, x, y, look, hover="%{text}", text=_texts(front), meta=list(range(len(x))), **line)
    return figure.update_layout(showlegend=False)


@plots_of.register(TradeOff)
class TradeOffPlots(AbstractPlots[TradeOff]):
    """Figures of a trade-off between wishes."""

    def __call__(self) -> "Figure":
        """Two wishes as a curve, three in space, more of them as parallel coordinates."""
        wishes = len(self._result.names)
        drawn = self.curve if wishes == 2 else self.space if wishes == 3 else self.parallel
        return drawn()

    def curve(self, x: str | None = None, y: str | None = None) -> "Figure":
        """Two wishes against one another, by their names; by default the first two."""
        front, places = self._solved("plot.curve"), []
        for name, usual in ((x, 0), (y, 1)):
            if name is not None and name not in front.names:
                raise unknown("plot.curve", name, front.names)
            places.append(usual if name is None else front.names.index(name))
        return pair_figure(front, *places)

    def space(self) -> "Figure":
        """Three wishes as points in space."""
        front = self._solved("plot.space")
        if len(front.names) != 3:
            raise ProblemError(
                f"plot.space: expected three wishes; received {len(front.names)}. Draw plot.curve or plot.parallel."
            )
        figure = blank("", "", height=560)
        x, y, z = front.values.T
        marker = {"size": 5, "color": z, "colorscale": "Cividis", "line": {"width": 0.5, "color": INK}}
        over = {"text": _texts(front), "hovertemplate": "%{text}<extra></extra>"}
        figure.add_scatter3d(x=x, y=y, z=z, mode="markers", marker=marker, **over)
        # There Plotly reads markup but no escaped characters.
        titles = [html.unescape(text).replace("<", "‹").replace(">", "›") for text in _labels(front)]
        shown = {"gridcolor": GRID, "linecolor": MUTED, "showbackground": False}
        axes = {f"{axis}axis": {"title": {"text": text}} | shown for axis, text in zip("xyz", titles, strict=True)}
        return figure.update_layout(scene=axes | {"camera": {"eye": {"x": 1.6, "y": 1.6, "z": 0.9}}}, showlegend=False)

    def parallel(self) -> "Figure":
        """One axis for each wish, and one line for each design."""
        front = self._solved("plot.parallel")
        columns = zip(_labels(front), front.values.T, strict=True)
        figure = blank("", "").add_parcoords(
            dimensions=[{"label": text, "values": column} for text, column in columns],
            line={"color": front.values[:, 0], "colorscale": "Cividis"},
            labelfont={"size": SIZE, "family": FONT, "color": INK},
        )
        # Labels stand above the axes, and those of the outer ones reach beyond them.
        return figure.update_layout(margin={"t": 80, "l": 110, "r": 110})

    def _solved(self, what: str) -> TradeOff:
        if not len(self._result.values):
            why = f": {'; '.join(self._result.failed)}" if self._result.failed else "."
            raise ProblemError(f"{what}: expected a solved design; received none{why}")
        return self._result


def trade_off_table(front: TradeOff) -> Table:
    """A row for each design of a trade-off: its wishes, then its decisions."""
    decided = numbers_in(front.solutions[0].problem) if front.solutions else []
    units = _units(front)
    rows = [
        [*(number(float(value), 5, unit) for value, unit in zip(row, units, strict=True)), *decided_in(one, decided)]
        for row, one in zip(front.values, front.solutions, strict=True)
    ]
    return Table("", [*front.names, *decided], rows)


def rates_of(front: TradeOff, place: int) -> dict[str, str]:
    """By how much each other wish falls for one unit more of the first one, as long as changes are small.

    At the best design of a wish the front ends: its multipliers need not be the slope of what is left of the front, and
    the wish may not give way at all.
    """
    values = front.values
    if np.any(values[place] <= values.min(axis=0)):
        return {"Rates of exchange": "none at an end of the front"}
    (first, *others), units = front.weights[place], _units(front)
    buys = [
        f"{number(first / weight, 4, units[i])} less of {front.names[i]}"
        for i, weight in enumerate(others, start=1)
        if weight > 0 and np.isfinite(first)
    ]
    return {f"Each {units[0] or 'unit'} more of {front.names[0]} buys": " or ".join(buys)} if buys else {}


@facts_of.register(TradeOff)
def _(front: TradeOff) -> Facts:
    failed = f"No design: {'; '.join(front.failed)}" if front.failed else ""
    designs = f"{len(front.solutions)} designs{', interrupted' * front.interrupted}"
    return Facts(f"Trade-off of {words(list(front.names))}: {designs}", failed, [trade_off_table(front)])
