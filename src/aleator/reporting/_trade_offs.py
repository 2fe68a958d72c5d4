"""Figures of trade-offs: each pair of wishes against one another."""

from itertools import combinations
from typing import TYPE_CHECKING

from aleator.reporting import _units
from aleator.reporting._numbers import number
from aleator.reporting._style import blank, label, looks, plain
from aleator.sweep import TradeOff

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def trade_off_figure(front: TradeOff) -> "list[Figure]":
    """A figure for each pair of wishes: every design, with the values of all wishes to hover over."""
    return [_pair(front, *pair) for pair in combinations(range(len(front.names)), 2)]


def _pair(front: TradeOff, first: int, second: int) -> "Figure":
    x, y = ((front.names[i], _unit(front, i)) for i in (first, second))
    figure = blank(label(*x), label(*y))
    look = looks(["design"])["design"]
    is_line = len(front.names) == 2
    figure.add_scatter(
        x=front.values[:, first],
        y=front.values[:, second],
        mode="lines+markers" if is_line else "markers",
        line={"color": look.fill(0.4), "width": 1.5},
        marker={"symbol": look.symbol, "size": 9, "color": look.colour},
        text=["<br>".join(_told(front, row)) for row in front.values],
        hovertemplate="%{text}<extra></extra>",
    )
    return figure.update_layout(showlegend=False)


def _told(front: TradeOff, row: "list[float]") -> list[str]:
    each = enumerate(zip(front.names, row, strict=True))
    return [plain(f"{name}: {number(float(one), 5, _unit(front, i))}") for i, (name, one) in each]


def _unit(front: TradeOff, which: int) -> str:
    """The unit of a wish; empty where it is unknown."""
    return _units.of_expression(front.wishes[which], front.solutions[0].problem) if front.solutions else ""
