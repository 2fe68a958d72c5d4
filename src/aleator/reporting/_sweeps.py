"""Sweeps with the names and units of their problem: figures along a bound, of trade-offs and of growing penalties; and
both on a page, linked with their designs, of which a reader chooses one and sees all of it.
"""

import html
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from aleator.reporting._blocks import Choice, Linked, Table
from aleator.reporting._choices import choice, evidence_on
from aleator.reporting._fronts import front_figure, ordered, shadow_price_figure
from aleator.reporting._numbers import (
    given,
    number,
    share_text,
    unit_of_decision,
    unit_of_expression,
    unit_of_limit,
    unit_of_objective,
    words,
)
from aleator.reporting._style import FONT, GRID, INK, MUTED, SIZE, blank, label, limit_line, looks, plain
from aleator.reporting._tables import STATUS_WORDS, objective_text
from aleator.solution import Solution
from aleator.sweep import SAME, Front, Hardened, Refused, TradeOff
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def optimum_figure(fronts: Mapping[str, Front]) -> "Figure":
    """The optimum along one bound, for some fronts by name, with the units of their problem."""
    front = next(iter(fronts.values()))
    problem = front.solutions[0].problem
    x_unit, y_unit = bound_unit(front), unit_of_objective(problem)
    return front_figure(fronts, y="Objective", y_unit=y_unit, x=f"Limit of {front.bound}", x_unit=x_unit)


def price_figure(fronts: Mapping[str, Front]) -> "Figure":
    """The shadow price of one bound along it, for some fronts by name, with its unit."""
    front = next(iter(fronts.values()))
    problem = front.solutions[0].problem
    x_unit, y_unit = bound_unit(front), unit_of_objective(problem)
    per = f"{y_unit or '1'} per {x_unit}" if x_unit else ""
    x = f"Limit of {front.bound}"
    return shadow_price_figure(fronts, y="Shadow price of the bound", y_unit=per, x=x, x_unit=x_unit)


def bound_unit(front: Front) -> str:
    """The unit of the bound along which a front lies."""
    problem = front.solutions[0].problem
    return unit_of_limit(front.bound, problem)


def decision_figure(front: Front, name: str) -> "Figure":
    """A decision along the bound of a front, of an array each entry; gaps where there is no design."""
    front, problem = ordered(front), front.solutions[0].problem
    unit = unit_of_decision(name, problem)
    figure = blank(label(f"Limit of {front.bound}", bound_unit(front)), label(name, unit))
    shape = np.shape(problem.placements.decisions[name].decision.initial)
    entries = [f"{name}[{i}]" for i in range(int(np.prod(shape)))] if shape else [name]
    missing = np.full(len(entries), np.nan)
    rows = np.array([np.ravel(one.decisions[name]) if one else missing for one in front.optima], dtype=float)
    for (entry, look), column in zip(looks(entries).items(), rows.T, strict=True):
        figure.add_scatter(
            x=front.values,
            y=column,
            mode="lines+markers",
            name=plain(entry),
            line={"color": look.colour, "width": 2},
            marker={"symbol": look.symbol, "size": 8, "color": look.colour},
            hovertemplate=f"{plain(entry)} = %{{y:.5~g}} {plain(unit)} at %{{x:.4~g}}<extra></extra>",
        )
    return figure.update_layout(showlegend=len(entries) > 1)


def told_values(front: TradeOff, row: Sequence[float] | Float[np.ndarray, " wishes"]) -> list[str]:
    """The value of each wish with its unit."""
    return [number(float(one), 5, unit_of(front, i)) for i, one in enumerate(row)]


def trade_off_figure(front: TradeOff) -> "list[Figure]":
    """A figure for each pair of wishes: every design, with the values of all wishes to hover over."""
    return [pair_figure(front, *pair) for pair in combinations(range(len(front.names)), 2)]


def pair_figure(front: TradeOff, first: int, second: int) -> "Figure":
    """Two wishes, by their places among `front.names`, against one another."""
    x, y = ((front.names[i], unit_of(front, i)) for i in (first, second))
    figure = blank(label(*x), label(*y))
    look = looks(["design"])["design"]
    is_line = len(front.names) == 2
    figure.add_scatter(
        x=front.values[:, first],
        y=front.values[:, second],
        mode="lines+markers" if is_line else "markers",
        line={"color": look.fill(0.4), "width": 1.5},
        marker={"symbol": look.symbol, "size": 9, "color": look.colour},
        text=["<br>".join(_hover(front, row)) for row in front.values],
        hovertemplate="%{text}<extra></extra>",
        meta=list(range(len(front.values))),
    )
    return figure.update_layout(showlegend=False)


def space_figure(front: TradeOff) -> "Figure":
    """The designs of three wishes as points in space, coloured by the third."""
    figure = blank("", "", height=560)
    figure.add_scatter3d(
        x=front.values[:, 0],
        y=front.values[:, 1],
        z=front.values[:, 2],
        mode="markers",
        marker={"size": 5, "color": front.values[:, 2], "colorscale": "Cividis", "line": {"width": 0.5, "color": INK}},
        text=["<br>".join(_hover(front, row)) for row in front.values],
        hovertemplate="%{text}<extra></extra>",
    )
    axes = {
        f"{axis}axis": {
            "title": {"text": _in_space(name, unit_of(front, i))},
            "gridcolor": GRID,
            "linecolor": MUTED,
            "showbackground": False,
        }
        for i, (axis, name) in enumerate(zip("xyz", front.names, strict=True))
    }
    return figure.update_layout(scene=axes | {"camera": {"eye": {"x": 1.6, "y": 1.6, "z": 0.9}}}, showlegend=False)


def _in_space(name: str, unit: str) -> str:
    """A label in space, where Plotly reads markup but no escaped characters."""
    return html.unescape(label(name, unit)).replace("<", "‹").replace(">", "›")


def parallel_figure(front: TradeOff) -> "Figure":
    """One axis for each wish and one line for each design, coloured by the first wish; drag along axes to select."""
    figure = blank("", "", height=420)
    figure.add_parcoords(
        dimensions=[
            {"label": label(name, unit_of(front, i)), "values": np.asarray(front.values[:, i])}
            for i, name in enumerate(front.names)
        ],
        line={"color": front.values[:, 0], "colorscale": "Cividis"},
        labelfont={"size": SIZE, "family": FONT, "color": INK},
    )
    # Labels stand above the axes, and those of the outer ones reach beyond them.
    return figure.update_layout(margin={"t": 80, "l": 110, "r": 110})


def _hover(front: TradeOff, row: "list[float]") -> list[str]:
    each = enumerate(zip(front.names, row, strict=True))
    return [plain(f"{name}: {number(float(one), 5, unit_of(front, i))}") for i, (name, one) in each]


def unit_of(front: TradeOff, which: int) -> str:
    """The unit of a wish; empty where it is unknown."""
    return unit_of_expression(front.wishes[which], front.solutions[0].problem) if front.solutions else ""


def excesses_figure(hardened: Hardened) -> "Figure":
    """The excess of each constraint against the weight of its penalty; one that is zero has no place on the axis."""
    figure = blank(label("Weight of the penalties"), label("Excess over the limit, relative"))
    for name, look in looks(hardened.excesses[0]).items():
        excesses = np.array([one[name] for one in hardened.excesses])
        figure.add_scatter(
            x=list(hardened.weights),
            y=[one if one > 0 else None for one in excesses.tolist()],
            mode="lines+markers",
            name=plain(name),
            line={"color": look.colour, "width": 2},
            marker={"symbol": look.symbol, "size": 9, "color": look.colour},
            hovertemplate=f"{plain(name)}: %{{y:.2~e}} at weight %{{x:.4~g}}<extra></extra>",
        )
    limit_line(figure, hardened.tolerance, f"accepted: {given(hardened.tolerance)}", logarithmic=True)
    for axis in (figure.update_xaxes, figure.update_yaxes):
        axis(type="log", exponentformat="power", dtick=1)
    return figure.update_layout(showlegend=True)


_CHOOSE = "Choose a design, by a click on its point or in the table, to see it beside the figures."


def front_blocks(fronts: Mapping[str, Front], evidence: Iterable[Evidence] = ()) -> list[Linked]:
    """For each swept bound: the optimum and the shadow price along it, and the designs."""
    known = list(evidence)
    blocks = []
    for bound in dict.fromkeys(one.bound for one in fronts.values()):
        # A study names the front of its design by the bound.
        group = {"design" if name == bound else name: one for name, one in fronts.items() if one.bound == bound}
        caption = (
            f"Filled markers: {bound} is active; open markers: it is not, and something else, or nothing, limits the "
            f"design. Crosses on the axis: no design meets all limits there. The shadow price is what relaxing {bound} "
            "is worth: zero where it is not active."
        )
        figures = [optimum_figure(group), price_figure(group)]
        blocks.append(linked_front(group, figures, f"Optimum against the limit of {bound}", caption, evidence=known))
    return blocks


def linked_front(
    fronts: Mapping[str, Front],
    figures: "Sequence[Figure]",
    heading: str,
    caption: str = "",
    number: str = "",
    evidence: Iterable[Evidence] = (),
) -> Linked:
    """Figures of fronts along one bound, linked with the designs.

    - `figures`: of all these fronts in the same order, by `front_figure` or `shadow_price_figure`; `evidence`: on some
      of the designs.
    """
    known = list(evidence)
    points = [point for front in fronts.values() for point in front.points]
    places = zip(_places(fronts), points, strict=True)
    choices = [choice(name, point, evidence_on(point, known)) for name, point in places]
    doubts = [f"{name}: {one}." for name, front in fronts.items() for one in front.doubts()]
    caption = " ".join(filter(None, [caption, *doubts, _CHOOSE]))
    first = next((i for i, one in enumerate(points) if one.ok), 0)
    return Linked(figures, heading, _front_table(fronts, known), choices, first, caption, number)


def disagreements(designs: Mapping[str, Solution], fronts: Mapping[str, Front]) -> list[str]:
    """Where a design and a point of a front solve the same problem, but one is better: the other is a local optimum."""
    found = []
    for name, design in designs.items():
        for front in fronts.values():
            for value, point in zip(front.values, front.points, strict=True):
                if not (design.ok and isinstance(point, Solution) and point.ok and point.problem == design.problem):
                    continue
                gap = abs(design.objective - point.objective)
                if gap > SAME * max(abs(design.objective), abs(point.objective)):
                    told = f"'{name}' and the front at {front.bound} = {given(value, bound_unit(front))}"
                    both = f"{objective_text(design)} and {objective_text(point)}"
                    found.append(
                        f"{told} are optima of one problem, {both}: the higher one is local, and neither need be the "
                        "least. al.multistart and al.portfolio look for others."
                    )
    return found


def _places(group: Mapping[str, Front]) -> list[str]:
    """The name of each point of some fronts: its bound, after the name of its front if there are several."""
    places = []
    for name, front in group.items():
        before = f"{name}, " if len(group) > 1 else ""
        places += [f"{before}{front.bound}: {given(value, bound_unit(front))}" for value in front.values]
    return places


def _front_table(group: Mapping[str, Front], evidence: list[Evidence]) -> Table:
    """A row for each point of some fronts along one bound."""
    first = next(iter(group.values()))
    decided = _numbers_in(first.solutions[0])
    counted = [evidence_on(one, evidence) for front in group.values() for one in front.points]
    header = [f"Limit of {first.bound}", "Objective", "Shadow price", "Active", *decided]
    rows = []
    for name, front in group.items():
        before = f"{name}, " if len(group) > 1 else ""
        for value, point in zip(front.values, front.points, strict=True):
            row = [f"{before}{given(value, bound_unit(front))}", *_optimum(front, point)]
            rows.append([*row, *(_decided(point, one) for one in decided)])
    if any(counted):
        header.append("Violate any limit")
        rows = [[*row, share_text(one.joint if one else None)] for row, one in zip(rows, counted, strict=True)]
    return Table(f"Designs along the limit of {first.bound}", header, rows)


def _optimum(front: Front, point: Solution | Refused) -> list[str]:
    """Objective, shadow price and what is active; the status where there is no design."""
    if isinstance(point, Refused) or not point.ok:
        return [STATUS_WORDS[point.status], "–", "–"]
    return [objective_text(point), number(point.multiplier(front.bound), 4), words(list(point.active), "nothing")]


def _numbers_in(solution: Solution) -> list[str]:
    """The decisions that are single numbers."""
    return [name for name, value in solution.decisions.items() if np.ndim(value) == 0]


def _decided(point: Solution | Refused, name: str) -> str:
    """A decision where there is a design."""
    if isinstance(point, Refused) or not point.ok:
        return "–"
    return number(float(point.decisions[name]), 5, unit_of_decision(name, point.problem))


def trade_off_blocks(fronts: Mapping[str, TradeOff], evidence: Iterable[Evidence] = ()) -> list[Linked]:
    """For each trade-off: a figure for each pair of wishes, and the designs."""
    known = list(evidence)
    return [_trade_off_block(front, name, known) for name, front in fronts.items() if front.solutions]


def _trade_off_block(front: TradeOff, name: str, evidence: list[Evidence]) -> Linked:
    caption = f"Each point is a certified design: none other is better in all wishes. {_CHOOSE}"
    choices = [_traded(front, i, evidence) for i in range(len(front.solutions))]
    return Linked(trade_off_figure(front), f"Trade-off: {name}", _trade_off_table(front, name), choices, 0, caption)


def _traded(front: TradeOff, place: int, evidence: list[Evidence]) -> Choice:
    """A design of a trade-off, with the values of its wishes, and the rates at which they buy one another."""
    values = dict(zip(front.names, told_values(front, front.values[place]), strict=True))
    name = ", ".join(f"{wish}: {value}" for wish, value in values.items())
    solution = front.solutions[place]
    return choice(name, solution, evidence_on(solution, evidence), values | _rates(front, place))


def _rates(front: TradeOff, place: int) -> dict[str, str]:
    """By how much each other wish falls for one unit more of the first one, as long as changes are small.

    At the best design of a wish the front ends: its multipliers need not be the slope of what is left of the front, and
    the wish may not give way at all.
    """
    values = front.values
    if np.any(values[place] <= values.min(axis=0)):
        return {"Rates of exchange": "none at an end of the front"}
    first, *others = front.weights[place]
    unit = unit_of(front, 0)
    return {
        f"Each {unit or 'unit'} more of {front.names[0]} buys": (
            f"{number(first / weight, 4, unit_of(front, i))} less of {front.names[i]}"
        )
        for i, weight in enumerate(others, start=1)
        if weight > 0 and np.isfinite(first)
    }


def _trade_off_table(front: TradeOff, name: str) -> Table:
    """The designs of a trade-off: wishes, then decisions."""
    decided = _numbers_in(front.solutions[0])
    rows = [
        [*told_values(front, row), *(_decided(solution, one) for one in decided)]
        for row, solution in zip(front.values, front.solutions, strict=True)
    ]
    return Table(f"Designs of {name}", [*front.names, *decided], rows)
