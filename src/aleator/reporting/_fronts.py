"""Figures, tables and facts of fronts: what lies along a bound."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator.design import Problem
from aleator.reporting._numbers import (
    NOTHING,
    given,
    number,
    share_text,
    unit_of_decision,
    unit_of_limit,
    unit_of_objective,
    words,
)
from aleator.reporting._page import Table
from aleator.reporting._showing import AbstractPlots, Facts, chosen, facts_of, plots_of
from aleator.reporting._style import (
    DASHES,
    LIMIT,
    MUTED,
    SIZE,
    Look,
    blank,
    draw,
    label,
    limit_line,
    looks,
    padded,
    plain,
)
from aleator.reporting._tables import objective_text, status_words
from aleator.solution import Solution
from aleator.sweep import Front, Refused
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Values that differ by less than this part are shown as equal: the rest is what solvers' tolerances leave.
_FLAT = 1e-6
# Characters of a line over a point.
_WRAPPED = 60
# The part of the range of a front between its points and the crosses below them.
_STEP = 0.07


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


def bound_unit(front: Front) -> str:
    """The unit of the bound along which a front lies."""
    return unit_of_limit(front.bound, front.points[0].problem)


def front_figure(
    fronts: Mapping[str, Front],
    *,
    x: str = "",
    y: str = "",
    x_unit: str = "",
    y_unit: str = "",
    limits: Mapping[str, float] = MappingProxyType({}),
    infeasible: Mapping[str, Front] = MappingProxyType({}),
) -> "Figure":
    """The optimum against the bound, one line for each front; axes without a name have those of the problem.

    A marker is filled where the swept bound is active and open where it is not. Points without a
    solution are crosses on the axis; their hover text says what cannot be met. `limits` are drawn as lines;
    `infeasible` shades the bounds at which another design does not exist.
    """
    objective = "Objective", unit_of_objective(next(iter(fronts.values())).points[0].problem)
    figure = _over_bound(fronts, (x, x_unit), (y, y_unit) if y else objective)
    values = [one.objective for front in fronts.values() for one in front.optima if one] + [*limits.values()]
    low, high = min(values, default=0.0), max(values, default=1.0)
    if high - low <= _FLAT * max(abs(low), abs(high)):
        low, high = low - 0.5 * abs(low or 1.0), high + 0.5 * abs(high or 1.0)
    step, rows = _STEP * (high - low), 1
    for name, (front, places) in in_order(fronts).items():
        look = looks(fronts)[name]
        # A filled marker, whatever the first point's marker is.
        draw(figure, [None], [None], look, name=name, legendgroup=plain(name))
        texts = {"text": [_point_text(front, one) for one in front.points], "showlegend": False}
        _add_points(figure, name, front, look, front.objectives, places, hover="%{text}", **texts)
        if not front.solved.all():
            _add_infeasible(figure, name, front, look, low - step * rows, places)
            rows += 1
    # Leaves room below the data for the label of the shaded band.
    figure.update_yaxes(range=[low - step * (rows + bool(infeasible)), high + step])
    for text, value in limits.items():
        limit_line(figure, value, text)
    for name, front in infeasible.items():
        _shade_infeasible(figure, name, front)
    return figure


def shadow_price_figure(
    fronts: Mapping[str, Front], *, x: str = "", y: str = "", x_unit: str = "", y_unit: str = "", scale: float = 1.0
) -> "Figure":
    """The value of relaxing a bound: the multiplier along each front, times `scale`; axes as of `front_figure`."""
    first = next(iter(fronts.values()))
    unit, by = unit_of_objective(first.points[0].problem), bound_unit(first)
    price = "Shadow price of the bound", f"{unit or '1'} per {by}" if by else ""
    figure = _over_bound(fronts, (x, x_unit), (y, y_unit) if y else price, height=360)
    for name, (front, places) in in_order(fronts).items():
        _add_points(figure, name, front, looks(fronts)[name], scale * front.shadow_prices, places, cliponaxis=False)
    return figure.update_yaxes(rangemode="tozero")


def _over_bound(fronts: Mapping[str, Front], x: tuple[str, str], y: tuple[str, str], height: int = 420) -> "Figure":
    """An empty figure over the bound of some fronts, which is called as in the problem where `x` has no name."""
    first = next(iter(fronts.values()))
    return blank(label(*(x if x[0] else (f"Limit of {first.bound}", bound_unit(first)))), label(*y), height=height)


def _add_points(
    figure: "Figure",
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
    draw(figure, front.values, values, look, name=name, legendgroup=plain(name), meta=places, **marks, **style)


def _point_text(front: Front, point: Solution | Refused) -> str:
    """What limits a point, what that costs, and its decisions, in lines."""
    if isinstance(point, Refused):
        return ""
    active = ", ".join(dict.fromkeys(name.split("[")[0] for name in point.active)) or "nothing"
    price = number(point.multiplier(front.bound), 3)
    decisions = [f"{key} = {number(float(value))}" for key, value in point.decisions.items() if not np.ndim(value)]
    return "<br>".join(map(plain, [f"active: {active}", f"shadow price of the bound {price} per unit", *decisions]))


def _add_infeasible(figure: "Figure", name: str, front: Front, look: Look, height: float, places: list[int]) -> None:
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
    draw(figure, front.values[missing], heights, look, **shown, **marks, **written, **over)


def _shade_infeasible(figure: "Figure", name: str, front: Front) -> None:
    """A band over the bounds at which a design does not exist, up to the middle of the next interval."""
    missing = front.values[~front.solved]
    if not len(missing):
        return
    gap = float(np.min(np.abs(np.diff(np.sort(front.values))))) / 2 if len(front.values) > 1 else 0.0
    low, high = float(missing.min()) - gap, float(missing.max()) + gap
    figure.add_vrect(x0=low, x1=high, fillcolor=MUTED, opacity=0.13, line_width=0)
    place = {"x": high, "y": 0.02, "yref": "paper", "xanchor": "left", "yanchor": "bottom"}
    font = {"size": SIZE - 1, "color": LIMIT}
    figure.add_annotation(text=f"◄ no {plain(name)} exists here", showarrow=False, font=font, **place)


def decision_path_figure(
    fronts: Mapping[str, Front],
    across: str,
    up: str,
    *,
    x: str,
    y: str,
    bound_unit: str = "",
    lower: float | None = None,
    lower_text: str = "",
) -> "Figure":
    """Two decisions against each other along each front (figure 6.8); the rightmost end is labelled with its bound."""
    figure = blank(plain(x), plain(y))
    for name, (front, _) in in_order(fronts).items():
        look = looks(fronts)[name]
        solved = [(value, one) for value, one in zip(front.values, front.optima, strict=True) if one]
        xs, ys = ([float(one.decisions[key]) for _, one in solved] for key in (across, up))
        bounds = [given(float(f"{value:.4g}"), bound_unit) for value, _ in solved]
        # Labels at both ends of several fronts would overlap.
        texts = [text if place == max(xs) else "" for place, text in zip(xs, bounds, strict=True)]
        marks = {"line_width": 1.5, "marker_symbol": f"{look.symbol}-open", "marker_size": 10, "marker_line_width": 2}
        written = {"text": texts, "textposition": "middle left", "textfont": {"size": SIZE - 2, "color": look.colour}}
        over = {"customdata": bounds, "hover": f"{plain(front.bound)} limit: %{{customdata}}", "cliponaxis": False}
        draw(figure, xs, ys, look, name=name, mode="lines+markers+text", **over, **marks, **written)
    if lower is not None:
        limit_line(figure, lower, lower_text, dash="dot", under=True)
        reached = [float(one.decisions[up]) for front in fronts.values() for one in front.optima if one]
        figure.update_yaxes(range=padded([lower, *reached], 0.12))
    return figure.update_yaxes(tickformat=",d")


def relative_figure(front: Front, names: Mapping[str, str], *, x: str, y: str, x_unit: str = "") -> "Figure":
    """Decisions along a front in percent of their initial values (figure 7.5); `names` are their labels."""
    (front, _), figure = in_order({"": front})[""], blank(label(x, x_unit), plain(y))
    places = front.solutions[0].problem.placements.designed
    for (name, text), look, dash in zip(names.items(), looks(names).values(), DASHES, strict=False):
        values = np.array([float(one.decisions[name]) if one else np.nan for one in front.optima])
        over = {"customdata": [number(one) for one in values], "hover": "%{customdata}", "line_dash": dash}
        draw(figure, front.values, 100 * values / float(places[name].decision.initial), look, name=text, **over)
    limit_line(figure, 100.0, "initial value (100 %)")
    _shade_infeasible(figure, "design", front)
    return figure.update_yaxes(rangemode="tozero")


@plots_of.register(Front)
class FrontPlots(AbstractPlots[Front]):
    """Figures of a front along a bound."""

    def curve(self) -> "Figure":
        """The optimum against the bound: filled where it is active; crosses where there is no design."""
        return front_figure({"design": self._solved("plot.curve")})

    def shadow_prices(self) -> "Figure":
        """By what the optimum falls for each unit by which the bound is relaxed."""
        return shadow_price_figure({"design": self._solved("plot.shadow_prices")})

    def decision(self, name: str | None = None) -> "Figure":
        """A decision against the bound, of an array each entry; by default the first."""
        (front, _) = in_order({"": self._solved("plot.decision")})[""]
        problem, nothing = front.solutions[0].problem, "expected a decision; received none."
        name, place = chosen("plot.decision", name, problem.placements.designed, nothing)
        figure = _over_bound({"": front}, ("", ""), (name, unit_of_decision(name, problem)))
        shape = np.shape(place.decision.initial)
        entries = [f"{name}[{i}]" for i in range(int(np.prod(shape)))] if shape else [name]
        missing = np.full(len(entries), np.nan)
        rows = np.array([np.ravel(one.decisions[name]) if one else missing for one in front.optima], dtype=float)
        for (entry, look), column in zip(looks(entries).items(), rows.T, strict=True):
            draw(figure, front.values, column, look, name=entry, marker_size=8)
        return figure.update_layout(showlegend=len(entries) > 1)

    def _solved(self, what: str) -> Front:
        """The front. Raises `ProblemError` if it has no design."""
        front = self._result
        if not front.solved.any():
            why = f": {front.points[0].why()}" if front.points else "."
            raise ProblemError(f"{what}: expected a solved design; received none{why}")
        return front


# --- Tables of designs -----------------------------------------------------------------------------------------------


def evidence_on(solution: Solution | Refused, known: Iterable[Evidence]) -> Evidence | None:
    """The evidence on this very design: on its decisions, in a problem with the same text; None if there is none."""
    if isinstance(solution, Refused):
        return None
    for one in known:
        same = np.array_equal(one.solution.vector, solution.vector)
        if one.solution is solution or (same and one.solution.problem_text == solution.problem_text):
            return one
    return None


def points_of(fronts: Mapping[str, Front]) -> list[tuple[str, str, Front, Solution | Refused]]:
    """Each point of some fronts: the name of its front, if there are several, its bound, its front, and what it is."""
    return [
        (f"{name}, " if len(fronts) > 1 else "", given(value, bound_unit(front)), front, point)
        for name, front in fronts.items()
        for value, point in zip(front.values, front.points, strict=True)
    ]


def front_table(fronts: Mapping[str, Front], evidence: Sequence[Evidence] = ()) -> Table:
    """A row for each point of some fronts along one bound: its optimum and decisions; why there is no design."""
    first = next(iter(fronts.values()))
    decided = numbers_in(first.points[0].problem)
    rows, counted = [], []
    for before, bound, front, point in points_of(fronts):
        if isinstance(point, Solution) and point.ok:
            price, active = number(point.multiplier(front.bound), 4), words(list(point.active), "nothing")
            optimum = [objective_text(point), price, active, *decided_in(point, decided)]
        else:
            status = status_words(point) if isinstance(point, Solution) else f"no design: {point.reason}"
            optimum = [status, *[NOTHING] * (2 + len(decided))]
        rows.append([f"{before}{bound}", *optimum])
        counted.append(evidence_on(point, evidence))
    header = [f"Limit of {first.bound}", "Objective", "Shadow price", "Active", *decided]
    if any(counted):
        header.append("Violate any limit")
        rows = [[*row, share_text(one.joint if one else None)] for row, one in zip(rows, counted, strict=True)]
    return Table(f"Designs along the limit of {first.bound}", header, rows)


def numbers_in(problem: Problem) -> list[str]:
    """The decisions that are single numbers."""
    return [name for name, place in problem.placements.designed.items() if np.ndim(place.decision.initial) == 0]


def decided_in(point: Solution, names: Sequence[str]) -> list[str]:
    return [number(float(point.decisions[name]), 5, unit_of_decision(name, point.problem)) for name in names]


@facts_of.register(Front)
def _(front: Front) -> Facts:
    solved, every = int(front.solved.sum()), len(front.points)
    heading = f"Front over {front.bound}: {solved} of {every} points solved{', interrupted' * front.interrupted}"
    points = zip(front.values, front.points, strict=True)
    reasons = [f"No design at {given(value, bound_unit(front))}: {one.why()}" for value, one in points if not one.ok]
    return Facts(heading, " ".join(reasons), [front_table({"": front})])
