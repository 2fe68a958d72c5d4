"""Figures and tables of fronts: what lies along a bound, or between wishes."""

import html
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from aleator.design import Problem
from aleator.reporting._documents import evidence_on, objective_text, status_words
from aleator.reporting._numbers import (
    NOTHING,
    given,
    number,
    share_text,
    unit_of,
    unit_of_decision,
    unit_of_limit,
    words,
)
from aleator.reporting._page import Table
from aleator.reporting._showing import Facts, chosen, facts_of, figure
from aleator.reporting._style import FONT, GRID, INK, MUTED, SIZE, Look, blank, draw, label, limit_line, looks, plain
from aleator.solution import Solution
from aleator.sweep import Front, Refused, TradeOff
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Values that differ by less than this part are shown as equal: the rest is what solvers' tolerances leave.
_FLAT = 1e-6
# Characters of a line over a point.
_WRAPPED = 60
# The part of the range of a front between its points and the crosses below them.
_STEP = 0.07


# --- Along a bound ---------------------------------------------------------------------------------------------------


def in_order(fronts: Mapping[str, Front]) -> dict[str, tuple[Front, list[int]]]:
    """Each front by its bounds, as they are where these rise or fall throughout, and the places of its points among
    those of all as they were given, by which a page links them with their designs.
    """
    ordered, before = {}, 0
    for name, front in fronts.items():
        changes, order = np.diff(front.values), np.arange(len(front.values))
        if not (np.all(changes >= 0) or np.all(changes <= 0)):
            order = np.argsort(front.values, kind="stable")
        points = tuple(front.points[i] for i in order)
        ordered[name] = replace(front, values=front.values[order], points=points), (before + order).tolist()
        before += len(order)
    return ordered


def _units_along(front: Front) -> tuple[str, str]:
    """The units of the bound and of the objective."""
    problem = front.points[0].problem
    return unit_of_limit(front.bound, problem), unit_of(problem.objective, problem)


def front_figure(
    fronts: Mapping[str, Front],
    *,
    x: str = "",
    y: str = "",
    x_unit: str = "",
    y_unit: str = "",
    limits: Mapping[str, float] = MappingProxyType({}),
) -> "Figure":
    """The optimum against the bound, one line for each front; axes without a name have those of the problem.

    A marker is filled where the swept bound is active and open where it is not. Points without a solution are crosses
    on the axis; their hover text says what cannot be met. `limits` are drawn as lines.
    """
    first = next(iter(fronts.values()))
    drawn = _over_bound(first, (x, x_unit), (y, y_unit) if y else ("Objective", _units_along(first)[1]))
    values = [one.objective for front in fronts.values() for one in front.optima if one] + [*limits.values()]
    low, high = min(values, default=0.0), max(values, default=1.0)
    if high - low <= _FLAT * max(abs(low), abs(high)):
        low, high = low - 0.5 * abs(low or 1.0), high + 0.5 * abs(high or 1.0)
    step, rows = _STEP * (high - low), 1
    for name, (front, places) in in_order(fronts).items():
        look = looks(fronts)[name]
        # A filled marker, whatever the first point's marker is.
        draw(drawn, [None], [None], look, name=name, legendgroup=plain(name))
        texts = {"text": [_point_text(front, one) for one in front.points], "showlegend": False}
        _add_points(drawn, name, front, look, front.objectives, places, hover="%{text}", **texts)
        if not front.solved.all():
            _add_infeasible(drawn, name, front, look, low - step * rows, places)
            rows += 1
    drawn.update_yaxes(range=[low - step * rows, high + step])
    for text, value in limits.items():
        limit_line(drawn, value, text)
    return drawn


def shadow_price_figure(fronts: Mapping[str, Front]) -> "Figure":
    """The value of relaxing a bound: the multiplier along each front."""
    first = next(iter(fronts.values()))
    by, unit = _units_along(first)
    price = "Shadow price of the bound", f"{unit or '1'} per {by}" if by else ""
    drawn = _over_bound(first, ("", ""), price, height=360)
    for name, (front, places) in in_order(fronts).items():
        _add_points(drawn, name, front, looks(fronts)[name], front.shadow_prices, places, cliponaxis=False)
    return drawn.update_yaxes(rangemode="tozero")


def _over_bound(front: Front, x: tuple[str, str], y: tuple[str, str], height: int = 420) -> "Figure":
    """An empty figure over the bound of a front, which is called as in the problem where `x` has no name."""
    return blank(label(*(x if x[0] else (f"Limit of {front.bound}", _units_along(front)[0]))), label(*y), height=height)


def _add_points(
    drawn: "Figure",
    name: str,
    front: Front,
    look: Look,
    values: Float[np.ndarray, " points"],
    places: list[int],
    **style: Any,
) -> None:
    """The solved points as one line, interrupted where a point between them has no solution; filled where the swept
    bound is active.
    """
    active = [isinstance(one, Solution) and one.multiplier(front.bound) > 0 for one in front.points]
    symbols = [look.symbol if is_active else f"{look.symbol}-open" for is_active in active]
    marks = {"marker_symbol": symbols, "marker_line_width": 2, "marker_line_color": look.colour}
    draw(drawn, front.values, values, look, name=name, legendgroup=plain(name), meta=places, **marks, **style)


def _point_text(front: Front, point: Solution | Refused) -> str:
    """What limits a point, what that costs, and its decisions, in lines."""
    if isinstance(point, Refused):
        return ""
    active = ", ".join(dict.fromkeys(name.split("[")[0] for name in point.active)) or "nothing"
    price = number(point.multiplier(front.bound), 3)
    decisions = [f"{key} = {number(float(value))}" for key, value in point.decisions.items() if not np.ndim(value)]
    return "<br>".join(map(plain, [f"active: {active}", f"shadow price of the bound {price} per unit", *decisions]))


def _add_infeasible(drawn: "Figure", name: str, front: Front, look: Look, height: float, places: list[int]) -> None:
    """Points without a solution, on the axis, each with the reason."""
    missing = [i for i, one in enumerate(front.points) if not one.ok]
    last, middle = max(missing, key=lambda i: front.values[i]), (front.values.min() + front.values.max()) / 2
    whys = ["<br>".join(textwrap.wrap(plain(front.points[i].why()), _WRAPPED)) for i in missing]
    texts = [f" {plain(name)} infeasible" if i == last else "" for i in missing]
    beside = "middle right" if front.values[last] < middle else "middle left"
    written = {"text": texts, "textposition": beside, "textfont": {"size": SIZE - 1, "color": look.colour}}
    # Their height is no objective.
    over = {"customdata": whys, "hovertemplate": "%{xaxis.title.text}: %{x}<br>%{customdata}<extra></extra>"}
    shown = {"name": f"{name}: no design exists", "showlegend": False, "cliponaxis": False}
    marks = {"mode": "markers+text", "meta": [places[i] for i in missing]}
    heights, look = [height] * len(missing), Look(look.colour, "x")
    draw(drawn, front.values[missing], heights, look, **shown, **marks, **written, **over)


@figure(Front)
def curve(front: Front) -> "Figure":
    """The optimum against the bound: filled where it is active; crosses where there is no design."""
    return front_figure({"design": front})


@figure(Front)
def shadow_prices(front: Front) -> "Figure":
    """By what the optimum falls for each unit by which the bound is relaxed."""
    return shadow_price_figure({"design": front})


@figure(Front)
def decision(front: Front, name: str | None = None) -> "Figure":
    """A decision against the bound, of an array each entry; by default the first."""
    (front, _), problem = in_order({"": front})[""], front.points[0].problem
    name, place = chosen("plot.decision", name, problem.placements.designed)
    drawn = _over_bound(front, ("", ""), (name, unit_of_decision(name, problem)))
    missing = np.full(np.size(place.decision.initial), np.nan)
    rows = np.array([np.ravel(one.decisions[name]) if one else missing for one in front.optima], dtype=float)
    entries = [f"{name}[{i}]" for i in range(len(missing))] if np.ndim(place.decision.initial) else [name]
    for (entry, look), column in zip(looks(entries).items(), rows.T, strict=True):
        draw(drawn, front.values, column, look, name=entry, marker_size=8)
    return drawn.update_layout(showlegend=len(entries) > 1)


def points_of(fronts: Mapping[str, Front]) -> list[tuple[str, str, Front, Solution | Refused]]:
    """Each point of some fronts: the name of its front, if there are several, its bound, its front, and what it is."""
    return [
        (f"{name}, " if len(fronts) > 1 else "", given(value, _units_along(front)[0]), front, point)
        for name, front in fronts.items()
        for value, point in zip(front.values, front.points, strict=True)
    ]


def front_table(fronts: Mapping[str, Front], evidence: Sequence[Evidence] = ()) -> Table:
    """A row for each point of some fronts along one bound: its optimum and decisions; why there is no design."""
    first = next(iter(fronts.values()))
    decided = _numbers_in(first.points[0].problem)
    rows, counted = [], []
    for before, bound, front, point in points_of(fronts):
        if isinstance(point, Solution) and point.ok:
            price, active = number(point.multiplier(front.bound), 4), words(point.active, "nothing")
            optimum = [objective_text(point), price, active, *_decided_in(point, decided)]
        else:
            status = status_words(point) if isinstance(point, Solution) else f"no design: {point.reason}"
            optimum = [status, *[NOTHING] * (2 + len(decided))]
        rows.append([f"{before}{bound}", *optimum])
        counted.append(evidence_on(point, evidence))
    header = [f"Limit of {first.bound}", "Objective", "Shadow price", "Active", *decided]
    if any(counted):
        header.append("Violate any limit")
        shares = (share_text(one.joint if one and one.broken else None) for one in counted)
        rows = [[*row, share] for row, share in zip(rows, shares, strict=True)]
    return Table(f"Designs along the limit of {first.bound}", header, rows)


def _numbers_in(problem: Problem) -> list[str]:
    """The decisions that are single numbers."""
    return [name for name, place in problem.placements.designed.items() if np.ndim(place.decision.initial) == 0]


def _decided_in(point: Solution, names: Sequence[str]) -> list[str]:
    return [number(float(point.decisions[name]), 5, unit_of_decision(name, point.problem)) for name in names]


@facts_of.register(Front)
def _(front: Front) -> Facts:
    solved, every = int(front.solved.sum()), len(front.points)
    heading = f"Front over {front.bound}: {solved} of {every} points solved"
    reasons = [f"No design at {bound}: {one.why()}" for _, bound, _, one in points_of({"": front}) if not one.ok]
    return Facts(heading, " ".join(reasons), [front_table({"": front})])


# --- Between wishes --------------------------------------------------------------------------------------------------


def _units(front: TradeOff) -> list[str]:
    """The units of the wishes; empty where they are unknown."""
    return [unit_of(wish, front.solutions[0].problem) if front.solutions else "" for wish in front.wishes]


def _labels(front: TradeOff) -> list[str]:
    return [label(name, unit) for name, unit in zip(front.names, _units(front), strict=True)]


def _wishes(front: TradeOff) -> list[list[str]]:
    """The numbers of each design, in words."""
    units = _units(front)
    return [[number(float(one), 5, unit) for one, unit in zip(row, units, strict=True)] for row in front.values]


def pair_figure(front: TradeOff, first: int, second: int) -> "Figure":
    """Two wishes, by their places among `front.names`, against one another."""
    drawn = blank(*(_labels(front)[i] for i in (first, second)))
    look, (x, y) = looks(["design"])["design"], (front.values[:, i] for i in (first, second))
    shown: dict[str, Any] = {"mode": "markers", "text": _texts(front), "hover": "%{text}"}
    if len(front.names) == 2:
        shown = {"line_color": look.fill(0.4), "line_width": 1.5}
    draw(drawn, x, y, look, meta=list(range(len(x))), **shown)
    return drawn.update_layout(showlegend=False)


def _texts(front: TradeOff) -> list[str]:
    """All wishes of each design, to be shown over its point."""
    rows = [zip(map(plain, front.names), row, strict=True) for row in _wishes(front)]
    return ["<br>".join(f"{name}: {one}" for name, one in row) for row in rows]


@figure(TradeOff, "")
def trade_off_figure(front: TradeOff) -> "Figure":
    """Two wishes as a curve, three in space, more of them as parallel coordinates."""
    return {2: trade_off_curve, 3: _space}.get(len(front.names), parallel)(front)


@figure(TradeOff, "curve")
def trade_off_curve(front: TradeOff, x: str | None = None, y: str | None = None) -> "Figure":
    """Two wishes against one another, by their names; by default the first two."""
    places = {name: i for i, name in enumerate(front.names)}
    return pair_figure(front, *(chosen("plot.curve", name, places)[1] for name in (x, y or front.names[1])))


def _space(front: TradeOff) -> "Figure":
    """Three wishes as points in space."""
    x, y, z = front.values.T
    marker = {"size": 5, "color": z, "colorscale": "Cividis", "line": {"width": 0.5, "color": INK}}
    over = {"text": _texts(front), "hovertemplate": "%{text}<extra></extra>"}
    drawn = blank("", "", height=560).add_scatter3d(x=x, y=y, z=z, mode="markers", marker=marker, **over)
    # There Plotly reads markup but no escaped characters.
    titles = [html.unescape(text).replace("<", "‹").replace(">", "›") for text in _labels(front)]
    shown = {"gridcolor": GRID, "linecolor": MUTED, "showbackground": False}
    axes = {f"{axis}axis": {"title": {"text": text}} | shown for axis, text in zip("xyz", titles, strict=True)}
    return drawn.update_layout(scene=axes | {"camera": {"eye": {"x": 1.6, "y": 1.6, "z": 0.9}}}, showlegend=False)


@figure(TradeOff)
def parallel(front: TradeOff) -> "Figure":
    """One axis for each wish, and one line for each design."""
    drawn = blank("", "").add_parcoords(
        dimensions=[{"label": text, "values": one} for text, one in zip(_labels(front), front.values.T, strict=True)],
        line={"color": front.values[:, 0], "colorscale": "Cividis"},
        labelfont={"size": SIZE, "family": FONT, "color": INK},
    )
    # Labels stand above the axes, and those of the outer ones reach beyond them.
    return drawn.update_layout(margin={"t": 80, "l": 110, "r": 110})


def trade_off_table(front: TradeOff, caption: str = "") -> Table:
    """A row for each design of a trade-off: its wishes, then its decisions."""
    decided = _numbers_in(front.solutions[0].problem) if front.solutions else []
    pairs = zip(_wishes(front), front.solutions, strict=True)
    return Table(caption, [*front.names, *decided], [[*row, *_decided_in(one, decided)] for row, one in pairs])


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
    designs = f"{len(front.solutions)} designs"
    return Facts(f"Trade-off of {words(front.names)}: {designs}", failed, [trade_off_table(front)])
