"""Figures and facts of sweeps: fronts, trade-offs, calibrations, penalties, many starts, portfolios, cross-checks."""

import html
from typing import TYPE_CHECKING

import numpy as np

from aleator._core.errors import ProblemError
from aleator.nlp import Searched
from aleator.reporting._designs import search_figure
from aleator.reporting._fronts import (
    bound_unit,
    front_figure,
    in_order,
    pair_figure,
    shadow_price_figure,
    unit_of,
    wishes_text,
)
from aleator.reporting._linked import front_table, trade_off_table
from aleator.reporting._numbers import (
    given,
    number,
    percent,
    share_text,
    unit_of_decision,
    unit_of_objective,
    words,
)
from aleator.reporting._page import Table
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
    padded,
    plain,
)
from aleator.reporting.drawn._facts import AbstractPlots, Facts, chosen, facts_of, plots_of, unknown
from aleator.sweep import Calibration, CrossChecked, Front, Hardened, Portfolio, Starts, TradeOff

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Relative differences below this are drawn there: on a logarithmic axis, zero has no place.
_LEAST = 1e-16
_EMPTY = "expected a solved design; received none"


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
        unit = unit_of_decision(name, problem)
        figure = blank(label(f"Limit of {front.bound}", bound_unit(front)), label(name, unit))
        shape = np.shape(place.decision.initial)
        entries = [f"{name}[{i}]" for i in range(int(np.prod(shape)))] if shape else [name]
        missing = np.full(len(entries), np.nan)
        rows = np.array([np.ravel(one.decisions[name]) if one else missing for one in front.optima], dtype=float)
        for (entry, look), column in zip(looks(entries).items(), rows.T, strict=True):
            hover = f"{plain(entry)} = %{{y:.5~g}} {plain(unit)} at %{{x:.4~g}}"
            draw(figure, front.values, column, look, name=entry, hover=hover, marker_size=8)
        return figure.update_layout(showlegend=len(entries) > 1)

    def _solved(self, what: str) -> Front:
        """The front. Raises `ProblemError` if it has no design."""
        front = self._result
        if not front.solved.any():
            why = f": {front.points[0].why()}" if front.points else "."
            raise ProblemError(f"{what}: {_EMPTY}{why}")
        return front


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
        over = {"text": wishes_text(front), "hovertemplate": "%{text}<extra></extra>"}
        figure.add_scatter3d(x=x, y=y, z=z, mode="markers", marker=marker, **over)
        # There Plotly reads markup but no escaped characters.
        labels = [html.unescape(label(name, unit_of(front, i))) for i, name in enumerate(front.names)]
        axes = {
            f"{axis}axis": {
                "title": {"text": text.replace("<", "‹").replace(">", "›")},
                **{"gridcolor": GRID, "linecolor": MUTED, "showbackground": False},
            }
            for axis, text in zip("xyz", labels, strict=True)
        }
        return figure.update_layout(scene=axes | {"camera": {"eye": {"x": 1.6, "y": 1.6, "z": 0.9}}}, showlegend=False)

    def parallel(self) -> "Figure":
        """One axis for each wish, and one line for each design."""
        front = self._solved("plot.parallel")
        figure = blank("", "", height=420)
        figure.add_parcoords(
            dimensions=[
                {"label": label(name, unit_of(front, i)), "values": column}
                for i, (name, column) in enumerate(zip(front.names, front.values.T, strict=True))
            ],
            line={"color": front.values[:, 0], "colorscale": "Cividis"},
            labelfont={"size": SIZE, "family": FONT, "color": INK},
        )
        # Labels stand above the axes, and those of the outer ones reach beyond them.
        return figure.update_layout(margin={"t": 80, "l": 110, "r": 110})

    def _solved(self, what: str) -> TradeOff:
        if not len(self._result.values):
            why = f": {'; '.join(self._result.failed)}" if self._result.failed else "."
            raise ProblemError(f"{what}: {_EMPTY}{why}")
        return self._result


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
        hardened = self._result
        figure = blank(label("Weight of the penalties"), label("Excess over the limit, relative"))
        for name, look in looks(hardened.excesses[0]).items():
            excesses = [one[name] if one[name] > 0 else None for one in hardened.excesses]
            hover = f"{plain(name)}: %{{y:.2~e}} at weight %{{x:.4~g}}"
            draw(figure, list(hardened.weights), excesses, look, name=name, hover=hover)
        limit_line(figure, hardened.tolerance, f"accepted: {given(hardened.tolerance)}", logarithmic=True)
        powers = {"type": "log", "exponentformat": "power", "dtick": 1}
        return figure.update_layout(showlegend=True).update_xaxes(powers).update_yaxes(powers)


@facts_of.register(Front)
def _(front: Front) -> Facts:
    solved, every = int(front.solved.sum()), len(front.points)
    heading = f"Front over {front.bound}: {solved} of {every} points solved{', interrupted' * front.interrupted}"
    points = zip(front.values, front.points, strict=True)
    reasons = [f"No design at {given(value, bound_unit(front))}: {one.why()}" for value, one in points if not one.ok]
    return Facts(heading, " ".join(reasons), [front_table({"": front})])


@facts_of.register(TradeOff)
def _(front: TradeOff) -> Facts:
    failed = f"No design: {'; '.join(front.failed)}" if front.failed else ""
    designs = f"{len(front.solutions)} designs{', interrupted' * front.interrupted}"
    return Facts(f"Trade-off of {words(list(front.names))}: {designs}", failed, [trade_off_table(front)])


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


# Objectives with a smaller relative difference belong to one optimum.
_ALIKE = 1e-4


@plots_of.register(Starts)
class StartsPlots(AbstractPlots[Starts]):
    """Figures of a problem solved from many starts."""

    def objectives(self) -> "Figure":
        """The objectives that the starts led to, best first; starts that failed come last, as crosses."""
        every = self._result.solutions
        figure = blank(label("Starts, best first"), label("Objective", unit_of_objective(every[0].problem)))
        solved, failed = (sorted(one.objective for one in every if one.ok == ok) for ok in (True, False))
        groups = (
            ("solved", solved, 1, looks(["solved"])["solved"]),
            ("failed", failed, 1 + len(solved), Look(ALARM, "x")),
        )
        for name, values, first, look in groups:
            if values:
                places = first + np.arange(len(values))
                draw(figure, places, values, look, name=name, mode="markers", hover=f"{name}: %{{y:.6g}}")
        figure.update_yaxes(range=_range([*solved, *failed]))
        return figure.update_layout(showlegend=bool(failed))


def _range(values: list[float]) -> list[float]:
    """A range around all objectives; where they belong to one optimum, so wide that they look alike."""
    known = [one for one in values if np.isfinite(one)]
    size = max(map(abs, known), default=0.0)
    if known and max(known) - min(known) > _ALIKE * size:
        return padded(known)
    return padded([*known, *([known[0] - 0.1 * size, known[0] + 0.1 * size] if known else [])])


@plots_of.register(Portfolio)
class PortfolioPlots(AbstractPlots[Portfolio]):
    """Figures of a portfolio of searches."""

    def optima(self) -> "Figure":
        """How many starts led to each optimum, best first: in all, and of the random ones."""
        unit = unit_of_objective(self._result.best.problem)
        places = [f"{i + 1}: {number(one.objective, 5, unit)}" for i, one in enumerate(self._result.optima)]
        if not places:
            raise ProblemError(f"plot.optima: expected an optimum; received none: {self._result.best.why()}")
        groups = {
            "starts": dict(zip(places, (float(one.starts) for one in self._result.optima), strict=True)),
            "of these random": dict(zip(places, (float(one.random) for one in self._result.optima), strict=True)),
        }
        figure = bars_figure(groups, y="Starts that led there")
        return figure.update_xaxes(title_text="Objective of each optimum, best first")

    def search(self) -> "Figure":
        """What the global search evaluated."""
        return search_figure(self._result.searched, unit_of_objective(self._result.best.problem))


@plots_of.register(Searched)
class SearchedPlots(AbstractPlots[Searched]):
    """The figure of a search."""

    def search(self) -> "Figure":
        """The objective of every point evaluated, in order, and the best so far."""
        return search_figure(self._result)


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
        for kind, look in looks(groups).items():
            values, names = groups[kind].values(), [plain(name) for name in groups[kind]]
            places = [max(size, _LEAST) if np.isfinite(size) else None for size in values]
            texts = [f"{size:.1e}" for size in values]
            draw(figure, places, names, look, name=kind, mode="markers", text=texts, hover="%{y}: %{text}")
        limit_line(figure, one.tolerance, f"accepted: {given(one.tolerance)}", axis="x", logarithmic=True)
        figure.update_layout(showlegend=True).update_xaxes(type="log", exponentformat="power", dtick=2)
        return figure.update_yaxes(type="category", range=[rows - 0.5, -0.5])


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
