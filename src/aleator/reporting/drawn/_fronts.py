"""Figures and facts of fronts, trade-offs, calibrations and growing penalties."""

from typing import Any

from aleator._core.errors import ProblemError
from aleator.reporting import _units
from aleator.reporting._along_bounds import bound_unit, decision_figure, optimum_figure, price_figure
from aleator.reporting._blocks import Table
from aleator.reporting._numbers import given, number, percent, share_text, words
from aleator.reporting._penalties import excesses_figure
from aleator.reporting._samples import calibration_figure
from aleator.reporting._trade_offs import pair_figure, parallel_figure, space_figure
from aleator.reporting.drawn._facts import Facts, facts_of
from aleator.reporting.drawn._plots import AbstractPlots, Backend, chosen, drawn_by, plots_of, unknown
from aleator.solution import Solution
from aleator.sweep import Calibration, Front, Hardened, Refused, TradeOff

_EMPTY = "expected a solved design; received none"


class FrontPlots(AbstractPlots[Front]):
    """Figures of a front along a bound."""

    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """The optimum against the bound."""
        return self.curve(backend=backend)

    def curve(self, *, backend: Backend = "plotly") -> Any:
        """The optimum against the bound: filled where it is active; crosses where there is no design."""
        return drawn_by(backend, optimum_figure({"design": self._solved("plot.curve")}))

    def shadow_prices(self, *, backend: Backend = "plotly") -> Any:
        """By what the optimum falls for each unit by which the bound is relaxed."""
        return drawn_by(backend, price_figure({"design": self._solved("plot.shadow_prices")}))

    def decision(self, name: str | None = None, *, backend: Backend = "plotly") -> Any:
        """A decision against the bound, of an array each entry; by default the first."""
        front = self._solved("plot.decision")
        problem = front.solutions[0].problem
        name, _ = chosen("plot.decision", name, problem.placements.decisions, "expected a decision; received none.")
        return drawn_by(backend, decision_figure(front, name))

    def _solved(self, what: str) -> Front:
        """The front. Raises `ProblemError` if it has no design."""
        front = self._result
        if not front.solved.any():
            why = f": {front.points[0].why()}" if front.points else "."
            raise ProblemError(f"{what}: {_EMPTY}{why}")
        return front


plots_of.register(Front, FrontPlots)


class TradeOffPlots(AbstractPlots[TradeOff]):
    """Figures of a trade-off between wishes."""

    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """Two wishes as a curve, three in space, more of them as parallel coordinates."""
        wishes = len(self._result.names)
        drawn = self.curve if wishes == 2 else self.space if wishes == 3 else self.parallel
        return drawn(backend=backend)

    def curve(self, x: str | None = None, y: str | None = None, *, backend: Backend = "plotly") -> Any:
        """Two wishes against one another, by their names; by default the first two."""
        front, places = self._solved("plot.curve"), []
        for name, usual in ((x, 0), (y, 1)):
            if name is not None and name not in front.names:
                raise unknown("plot.curve", name, front.names)
            places.append(usual if name is None else front.names.index(name))
        return drawn_by(backend, pair_figure(front, *places))

    def space(self, *, backend: Backend = "plotly") -> Any:
        """Three wishes as points in space."""
        front = self._solved("plot.space")
        if len(front.names) != 3:
            raise ProblemError(
                f"plot.space: expected three wishes; received {len(front.names)}. Draw plot.curve or plot.parallel."
            )
        return drawn_by(backend, space_figure(front))

    def parallel(self, *, backend: Backend = "plotly") -> Any:
        """One axis for each wish, and one line for each design."""
        return drawn_by(backend, parallel_figure(self._solved("plot.parallel")))

    def _solved(self, what: str) -> TradeOff:
        if not len(self._result.values):
            why = f": {'; '.join(self._result.failed)}" if self._result.failed else "."
            raise ProblemError(f"{what}: {_EMPTY}{why}")
        return self._result


plots_of.register(TradeOff, TradeOffPlots)


class CalibrationPlots(AbstractPlots[Calibration]):
    """Figures of a calibration."""

    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """The violation rate against the margin."""
        return self.trials(backend=backend)

    def trials(self, *, backend: Backend = "plotly") -> Any:
        """The violation rate of each margin tried, the target, and the choice on fresh systems."""
        return drawn_by(backend, calibration_figure(self._result))


plots_of.register(Calibration, CalibrationPlots)


class HardenedPlots(AbstractPlots[Hardened]):
    """Figures of growing penalties."""

    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """The excess of each constraint against the weight of its penalty."""
        return self.excesses(backend=backend)

    def excesses(self, *, backend: Backend = "plotly") -> Any:
        """The excess of each constraint against the weight of its penalty, and the one accepted."""
        return drawn_by(backend, excesses_figure(self._result))


plots_of.register(Hardened, HardenedPlots)


@facts_of.register(Front)
def _(front: Front) -> Facts:
    solved, every = int(front.solved.sum()), len(front.points)
    unit = bound_unit(front) if front.solutions else ""
    rows = [[given(value, unit), *_point(front, one)] for value, one in zip(front.values, front.points, strict=True)]
    heading = f"Front over {front.bound}: {solved} of {every} points solved{', interrupted' * front.interrupted}"
    return Facts(heading, "", [Table("", [front.bound, "objective", "shadow price", "active"], rows)])


def _point(front: Front, one: Solution | Refused) -> list[str]:
    """Objective, shadow price and active limits; why there is no design, where there is none."""
    if isinstance(one, Refused) or not one.ok:
        return ["–", "–", one.why()]
    return [number(one.objective, 5), number(one.multiplier(front.bound), 4), words(list(one.active), "nothing")]


@facts_of.register(TradeOff)
def _(front: TradeOff) -> Facts:
    problem = front.solutions[0].problem if front.solutions else None
    units = [_units.of_expression(one, problem) if problem else "" for one in front.wishes]
    rows = [[number(value, 5, unit) for value, unit in zip(row, units, strict=True)] for row in front.values]
    failed = f"No design: {'; '.join(front.failed)}" if front.failed else ""
    heading = f"Trade-off of {words(list(front.names))}: {len(rows)} designs{', interrupted' * front.interrupted}"
    return Facts(heading, failed, [Table("", front.names, rows)])


@facts_of.register(Calibration)
def _(found: Calibration) -> Facts:
    rows = [[f"{one.sigmas:.4f}", number(one.solution.objective, 5), share_text(one.violation)] for one in found.trials]
    heading = (
        f"Calibration of {found.name} for {percent(found.target)}: "
        f"{found.sigmas:.4f} σ, {'' if found.confirmed else 'not '}confirmed{', interrupted' * found.interrupted}"
    )
    return Facts(heading, found.sentence(), [Table("", ["sigmas", "objective", f"violates {found.name}"], rows)])


@facts_of.register(Hardened)
def _(one: Hardened) -> Facts:
    told = ["; ".join(f"{excess:.1e} of {name}" for name, excess in each.items()) for each in one.excesses]
    found = zip(one.weights, one.solutions, told, strict=True)
    rows = [[f"{weight:g}", number(each.objective, 5), excesses] for weight, each, excesses in found]
    heading = f"Penalties: {'all' if one.holds else 'not all'} limits hold{', interrupted' * one.interrupted}"
    return Facts(heading, "", [Table("", ["weight", "objective", "excess"], rows)])
