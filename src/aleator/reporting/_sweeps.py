"""Figures, tables and facts of other sweeps: trade-offs, calibrations, penalties, starts, portfolios, cross-checks."""

import html
from typing import TYPE_CHECKING, Any

import numpy as np

from aleator._core.errors import ProblemError
from aleator.reporting._fronts import decided_in, numbers_in
from aleator.reporting._numbers import (
    given,
    number,
    percent,
    share_text,
    unit_of_expression,
    unit_of_objective,
    words,
)
from aleator.reporting._page import Table
from aleator.reporting._showing import AbstractPlots, Facts, facts_of, plots_of, unknown
from aleator.reporting._solutions import search_figure
from aleator.reporting._spreads import bars_figure, calibration_figure
from aleator.reporting._style import (
    ALARM,
    FONT,
    GRID,
    INK,
    MUTED,
    SIZE,
    Look,
    blank,
    draw,
    label,
    limit_line,
    looks,
    plain,
)
from aleator.sweep import Calibration, CrossChecked, Hardened, Portfolio, Starts, TradeOff

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Relative differences below this are drawn there: on a logarithmic axis, zero has no place.
_LEAST = 1e-16
# Objectives with a smaller relative difference belong to one optimum, and have to look alike.
_ALIKE = 1e-4

# --- Trade-offs between wishes ---------------------------------------------------------------------------------------


def _units(front: TradeOff) -> list[str]:
    """The units of the wishes; empty where they are unknown."""
    known = front.solutions[0].problem if front.solutions else None
    return ["" if known is None else unit_of_expression(wish, known) for wish in front.wishes]


def _labels(front: TradeOff) -> list[str]:
    return [label(name, unit) for name, unit in zip(front.names, _units(front), strict=True)]


def _texts(front: TradeOff, *on_axes: int) -> list[str]:
    """The numbers of each design but those on the axes of a figure, to be shown over its point."""
    wishes = list(zip(front.names, _units(front), front.values.T, strict=True))
    others = [one for i, one in enumerate(wishes) if i not in on_axes]
    columns = [[f"{label(name)}: {number(float(one), 5, unit)}" for one in column] for name, unit, column in others]
    return ["<br>".join(row) for row in zip(*columns, strict=True)]


def pair_figure(front: TradeOff, first: int, second: int) -> "Figure":
    """Two wishes, by their places among `front.names`, against one another."""
    figure = blank(*(_labels(front)[i] for i in (first, second)))
    look, (x, y) = looks(["design"])["design"], (front.values[:, i] for i in (first, second))
    shown: dict[str, Any] = {"mode": "markers", "text": _texts(front, first, second), "hover": "%{text}"}
    if len(front.names) == 2:
        shown = {"line_color": look.fill(0.4), "line_width": 1.5}
    draw(figure, x, y, look, meta=list(range(len(x))), **shown)
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


# --- Margins, penalties and starts ------------------------------------------------------------------------------------


@plots_of.register(Calibration)
class CalibrationPlots(AbstractPlots[Calibration]):
    """Figures of a calibration."""

    def trials(self) -> "Figure":
        """The violation rate of each margin tried, the target, and the choice on fresh systems."""
        return calibration_figure(self._result)


@plots_of.register(Hardened)
class HardenedPlots(AbstractPlots[Hardened]):
    """Figures of growing penalties."""

    def excesses(self) -> "Figure":
        """The excess of each constraint against the weight of its penalty, and the one accepted."""
        hardened, powers = self._result, {"type": "log", "dtick": 1}
        figure = blank(label("Weight of the penalties"), label("Excess over the limit, relative"))
        figure.update_layout(showlegend=True, xaxis=powers, yaxis=powers)
        for name, look in looks(hardened.excesses[0]).items():
            excesses = [one[name] if one[name] > 0 else None for one in hardened.excesses]
            draw(figure, list(hardened.weights), excesses, look, name=name)
        limit_line(figure, hardened.tolerance, f"accepted: {given(hardened.tolerance)}")
        return figure


@facts_of.register(Calibration)
def _(calibration: Calibration) -> Facts:
    name, trials = calibration.name, calibration.trials
    rows = [[f"{one.sigmas:.4f}", number(one.solution.objective, 5), share_text(one.violation)] for one in trials]
    end = f"{'' if calibration.confirmed else 'not '}confirmed{', interrupted' * calibration.interrupted}"
    heading = f"Calibration of {name} for {percent(calibration.target)}: {calibration.sigmas:.4f} σ, {end}"
    return Facts(heading, calibration.sentence(), [Table("", ["sigmas", "objective", f"violates {name}"], rows)])


@facts_of.register(Hardened)
def _(hardened: Hardened) -> Facts:
    rows = [
        [f"{weight:g}", number(one.objective, 5), "; ".join(f"{size:.1e} of {name}" for name, size in excesses.items())]
        for weight, one, excesses in zip(hardened.weights, hardened.solutions, hardened.excesses, strict=True)
    ]
    heading = f"Penalties: {'all' if hardened.holds else 'not all'} limits hold{', interrupted' * hardened.interrupted}"
    return Facts(heading, "", [Table("", ["weight", "objective", "excess"], rows)])


@plots_of.register(Starts)
class StartsPlots(AbstractPlots[Starts]):
    """Figures of a problem solved from many starts."""

    def objectives(self) -> "Figure":
        """The objectives that the starts led to, best first; starts that failed come last, as crosses."""
        every = self._result.solutions
        figure = blank(label("Starts, best first"), label("Objective", unit_of_objective(every[0].problem)))
        solved, failed = (sorted(one.objective for one in every if one.ok == ok) for ok in (True, False))
        draw(figure, 1 + np.arange(len(solved)), solved, looks(["solved"])["solved"], name="solved", mode="markers")
        if failed:
            places = 1 + len(solved) + np.arange(len(failed))
            draw(figure, places, failed, Look(ALARM, "x"), name="failed", mode="markers")
        known = [one for one in (*solved, *failed) if np.isfinite(one)]
        size = max(map(abs, known), default=0.0)
        if known and np.ptp(known) <= _ALIKE * size:
            figure.update_yaxes(range=[min(known) - 0.1 * size, max(known) + 0.1 * size])
        return figure.update_layout(showlegend=bool(failed))


@plots_of.register(Portfolio)
class PortfolioPlots(AbstractPlots[Portfolio]):
    """Figures of a portfolio of searches."""

    def optima(self) -> "Figure":
        """How many starts led to each optimum, best first: in all, and of the random ones."""
        unit = unit_of_objective(self._result.best.problem)
        places = [f"{i + 1}: {number(one.objective, 5, unit)}" for i, one in enumerate(self._result.optima)]
        if not places:
            raise ProblemError(f"plot.optima: expected an optimum; received none: {self._result.best.why()}")
        by_kind = {"starts": "starts", "of these random": "random"}
        optima = list(zip(places, self._result.optima, strict=True))
        groups = {kind: {place: float(getattr(one, key)) for place, one in optima} for kind, key in by_kind.items()}
        figure = bars_figure(groups, y="Starts that led there")
        return figure.update_xaxes(title_text="Objective of each optimum, best first")

    def search(self) -> "Figure":
        """What the global search evaluated."""
        return search_figure(self._result.searched, unit_of_objective(self._result.best.problem))


@plots_of.register(CrossChecked)
class CrossCheckedPlots(AbstractPlots[CrossChecked]):
    """The figure of a cross-check."""

    def differences(self) -> "Figure":
        """The relative differences of two solutions: of the objective, of decisions, statistics and multipliers."""
        one = self._result
        groups = {
            "objective": {"objective": one.objective},
            "decisions": one.decisions,
            "statistics": one.statistics,
            "multipliers": {f"multiplier of {text}": value for text, value in one.multipliers.items()},
        }
        groups = {kind: each for kind, each in groups.items() if each}
        rows = sum(map(len, groups.values()))
        figure = blank(label("Relative difference"), "", height=130 + 34 * rows)
        figure.update_layout(showlegend=True, xaxis={"type": "log", "dtick": 2})
        for kind, look in looks(groups).items():
            sizes = {plain(name): size for name, size in groups[kind].items()}
            places = [max(size, _LEAST) if np.isfinite(size) else None for size in sizes.values()]
            texts = [f"{name}: {size:.1e}" for name, size in sizes.items()]
            draw(figure, places, [*sizes], look, name=kind, mode="markers", text=texts, hover="%{text}")
        limit_line(figure, one.tolerance, f"accepted: {given(one.tolerance)}", axis="x")
        return figure.update_yaxes(type="category", autorange="reversed")


@facts_of.register(Starts)
def _(starts: Starts) -> Facts:
    unit, every = unit_of_objective(starts.best.problem), len(starts.solutions)
    rows = [[number(one.objective, 6, unit), f"{led} of {every}"] for one, led in starts.optima]
    sentence = "" if starts.best.ok else starts.best.why()
    heading = f"{every} starts: {len(rows)} local optima{', interrupted' * starts.interrupted}"
    return Facts(heading, sentence, [Table("", ["objective", "starts"], rows)])


@facts_of.register(Portfolio)
def _(portfolio: Portfolio) -> Facts:
    unit = unit_of_objective(portfolio.best.problem)
    rows = [[number(one.objective, 6, unit), f"{one.starts}", f"{one.random}"] for one in portfolio.optima]
    heading = f"Portfolio of {portfolio.starts} starts: {len(rows)} optima{', interrupted' * portfolio.interrupted}"
    sentence = portfolio.sure() if portfolio.best.ok else portfolio.best.why()
    return Facts(heading, sentence, [Table("", ["objective", "starts", "of these random"], rows)])
