"""Figures and facts of searches: many starts, portfolios, histories of solvers, cross-checks."""

from typing import Any

import numpy as np

from aleator._core.errors import ProblemError
from aleator.crosschecking import CrossChecked
from aleator.nlp import Searched
from aleator.reporting import _units
from aleator.reporting._blocks import Table
from aleator.reporting._methods import bars_figure
from aleator.reporting._numbers import count, number
from aleator.reporting._searches import search_figure
from aleator.reporting._shares import magnitudes_figure
from aleator.reporting._style import ALARM, blank, label, looks, padded
from aleator.reporting.drawn._facts import Facts, facts_of
from aleator.reporting.drawn._plots import AbstractPlots, Backend, drawn_by, plots_of
from aleator.solution import Solution
from aleator.sweep import Portfolio, Starts

# Objectives with a smaller relative difference belong to one optimum.
_ALIKE = 1e-4


class StartsPlots(AbstractPlots[Starts]):
    """Figures of a problem solved from many starts."""

    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """The objectives that the starts led to, best first."""
        return self.objectives(backend=backend)

    def objectives(self, *, backend: Backend = "plotly") -> Any:
        """The objectives that the starts led to, best first; starts that failed come last, as crosses."""
        every = self._result.solutions
        figure = blank(label("Starts, best first"), label("Objective", _objective_unit(every[0])))
        look = looks(["solved"])["solved"]
        solved = sorted(one.objective for one in every if one.ok)
        failed = sorted(one.objective for one in every if not one.ok)
        marked = (("solved", solved, 1, look.symbol, look.colour), ("failed", failed, 1 + len(solved), "x", ALARM))
        for name, values, first, symbol, colour in marked:
            if values:
                figure.add_scatter(
                    x=first + np.arange(len(values)),
                    y=values,
                    mode="markers",
                    name=name,
                    marker={"symbol": symbol, "size": 9, "color": colour},
                    hovertemplate=f"{name}: %{{y:.6g}}<extra></extra>",
                )
        figure.update_yaxes(range=_range([*solved, *failed]))
        return drawn_by(backend, figure.update_layout(showlegend=bool(failed)))


plots_of.register(Starts, StartsPlots)


def _range(values: list[float]) -> list[float]:
    """A range around all objectives; where they belong to one optimum, so wide that they look alike."""
    known = [one for one in values if np.isfinite(one)]
    size = max(map(abs, known), default=0.0)
    if known and max(known) - min(known) > _ALIKE * size:
        return padded(known)
    return padded([*known, *([known[0] - 0.1 * size, known[0] + 0.1 * size] if known else [])])


class PortfolioPlots(AbstractPlots[Portfolio]):
    """Figures of a portfolio of searches."""

    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """How many starts led to each optimum."""
        return self.optima(backend=backend)

    def optima(self, *, backend: Backend = "plotly") -> Any:
        """How many starts led to each optimum, best first: in all, and of the random ones."""
        unit = _objective_unit(self._result.best)
        places = [f"{i + 1}: {number(one.objective, 5, unit)}" for i, one in enumerate(self._result.optima)]
        if not places:
            raise ProblemError(f"plot.optima: expected an optimum; received none: {self._result.best.why()}")
        groups = {
            "starts": dict(zip(places, (float(one.starts) for one in self._result.optima), strict=True)),
            "of these random": dict(zip(places, (float(one.random) for one in self._result.optima), strict=True)),
        }
        figure = bars_figure(groups, y="Starts that led there")
        return drawn_by(backend, figure.update_xaxes(title_text="Objective of each optimum, best first"))

    def search(self, *, backend: Backend = "plotly") -> Any:
        """What the global search evaluated."""
        if self._result.searched is None:
            raise ProblemError("plot.search: expected a portfolio with a global search; received one without.")
        return drawn_by(backend, search_figure(self._result.searched, _objective_unit(self._result.best)))


plots_of.register(Portfolio, PortfolioPlots)


class SearchedPlots(AbstractPlots[Searched]):
    """The figure of a search."""

    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """The objective of every point evaluated, in order, and the best so far."""
        return self.search(backend=backend)

    def search(self, *, backend: Backend = "plotly") -> Any:
        """The objective of every point evaluated, in order, and the best so far."""
        if not self._result.evaluations:
            raise ProblemError("plot.search: expected a search that evaluated designs; received one without any.")
        return drawn_by(backend, search_figure(self._result))


plots_of.register(Searched, SearchedPlots)


class CrossCheckedPlots(AbstractPlots[CrossChecked]):
    """The figure of a cross-check."""

    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """The relative differences of two solutions."""
        return self.differences(backend=backend)

    def differences(self, *, backend: Backend = "plotly") -> Any:
        """The relative differences of two solutions: of the objective, of decisions, statistics and multipliers."""
        one = self._result
        groups = {
            "objective": {"objective": one.objective},
            "decisions": one.decisions,
            "statistics": one.statistics,
            "multipliers": {f"multiplier of {text}": value for text, value in one.multipliers.items()},
        }
        shown = {kind: each for kind, each in groups.items() if each}
        return drawn_by(backend, magnitudes_figure(shown, x="Relative difference", accepted=one.tolerance))


plots_of.register(CrossChecked, CrossCheckedPlots)


@facts_of.register(Starts)
def _(starts: Starts) -> Facts:
    unit, every = _objective_unit(starts.best), len(starts.solutions)
    rows = [[number(one.objective, 6, unit), f"{led} of {every}"] for one, led in starts.optima]
    said = "" if starts.best.ok else starts.best.why()
    heading = f"{every} starts: {len(rows)} local optima{', interrupted' * starts.interrupted}"
    return Facts(heading, said, [Table("", ["objective", "starts"], rows)])


@facts_of.register(Portfolio)
def _(found: Portfolio) -> Facts:
    unit = _objective_unit(found.best)
    rows = [[number(one.objective, 6, unit), f"{one.starts}", f"{one.random}"] for one in found.optima]
    heading = f"Portfolio of {found.starts} starts: {len(rows)} optima{', interrupted' * found.interrupted}"
    said = found.sure() if found.best.ok else found.best.why()
    return Facts(heading, said, [Table("", ["objective", "starts", "of these random"], rows)])


@facts_of.register(Searched)
def _(searched: Searched) -> Facts:
    return Facts(f"{searched.method}: {count(searched.evaluations)} evaluations")


@facts_of.register(CrossChecked)
def _(found: CrossChecked) -> Facts:
    return Facts(f"Cross-check: {'the solutions agree' if found.agree else 'the solutions do not agree'}")


def _objective_unit(solution: Solution) -> str:
    return _units.of_expression(solution.problem.objective, solution.problem)
