"""Figures and facts of other sweeps: calibrations, penalties, starts, portfolios, cross-checks."""

from typing import TYPE_CHECKING

import numpy as np

from aleator._core.errors import ProblemError
from aleator.reporting._numbers import given, number, percent, share_text, unit_of
from aleator.reporting._page import Table
from aleator.reporting._showing import Facts, facts_of, figure
from aleator.reporting._spreads import bars_figure, calibration_figure
from aleator.reporting._style import limit_line
from aleator.reporting._tables import objective_text
from aleator.solution import Solution
from aleator.sweep import Calibration, CrossChecked, Hardened, Portfolio, Starts

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

figure(Calibration, "trials")(calibration_figure)


@facts_of.register(Calibration)
def _(calibration: Calibration) -> Facts:
    name, trials = calibration.name, calibration.trials
    rows = [[f"{one.sigmas:.4f}", number(one.solution.objective, 5), share_text(one.violation)] for one in trials]
    end = f"{'' if calibration.confirmed else 'not '}confirmed{', interrupted' * calibration.interrupted}"
    heading = f"Calibration of {name} for {percent(calibration.target)}: {calibration.sigmas:.4f} σ, {end}"
    return Facts(heading, calibration.sentence(), [Table("", ["sigmas", "objective", f"violates {name}"], rows)])


@figure(Hardened)
def excesses(hardened: Hardened) -> "Figure":
    """The excess of each constraint with each weight of the penalties, and the one accepted."""
    groups = {f"weight {one:g}": sizes for one, sizes in zip(hardened.weights, hardened.excesses, strict=True)}
    drawn = bars_figure(groups, y="Excess over the limit, relative").update_yaxes(type="log")
    limit_line(drawn, hardened.tolerance, f"accepted: {given(hardened.tolerance)}")
    return drawn


@facts_of.register(Hardened)
def _(hardened: Hardened) -> Facts:
    rows = [
        [f"{weight:g}", number(one.objective, 5), "; ".join(f"{size:.1e} of {name}" for name, size in sizes.items())]
        for weight, one, sizes in zip(hardened.weights, hardened.solutions, hardened.excesses, strict=True)
    ]
    heading = f"Penalties: {'all' if hardened.holds else 'not all'} limits hold{', interrupted' * hardened.interrupted}"
    return Facts(heading, "", [Table("", ["weight", "objective", "excess"], rows)])


# --- Local optima ----------------------------------------------------------------------------------------------------


@figure(Starts)
def objectives(starts: Starts) -> "Figure":
    """How many starts led to each local optimum, best first, and how many failed."""
    failed = sum(not one.ok for one in starts.solutions)
    rows = [(f"{i}: {objective_text(one)}", {"starts": led}) for i, (one, led) in enumerate(starts.optima, 1)]
    return _optima([*rows, ("failed", {"starts": failed})] if failed else rows)


@figure(Portfolio)
def optima(portfolio: Portfolio) -> "Figure":
    """How many starts led to each optimum, best first: in all, and of the random ones."""
    if not portfolio.optima:
        raise ProblemError(f"plot.optima: expected an optimum; received none: {portfolio.best.why()}")
    unit = _unit(portfolio.best)
    return _optima(
        [
            (f"{i}: {number(one.objective, 5, unit)}", {"starts": one.starts, "of these random": one.random})
            for i, one in enumerate(portfolio.optima, 1)
        ]
    )


def _optima(counts: list[tuple[str, dict[str, int]]]) -> "Figure":
    groups = {kind: {place: one[kind] for place, one in counts} for kind in counts[0][1]}
    drawn = bars_figure(groups, y="Starts that led there")
    return drawn.update_xaxes(title_text="Objective of each optimum, best first")


def _unit(solution: Solution) -> str:
    return unit_of(solution.problem.objective, solution.problem)


@facts_of.register(Starts)
def _(starts: Starts) -> Facts:
    every = len(starts.solutions)
    rows = [[objective_text(one, 6), f"{led} of {every}"] for one, led in starts.optima]
    heading = f"{every} starts: {len(rows)} local optima{', interrupted' * starts.interrupted}"
    sentence = "" if starts.best.ok else starts.best.why()
    return Facts(heading, sentence, [Table("", ["objective", "starts"], rows)])


@facts_of.register(Portfolio)
def _(portfolio: Portfolio) -> Facts:
    unit = _unit(portfolio.best)
    rows = [[number(one.objective, 6, unit), f"{one.starts}", f"{one.random}"] for one in portfolio.optima]
    heading = f"Portfolio of {portfolio.starts} starts: {len(rows)} optima{', interrupted' * portfolio.interrupted}"
    sentence = portfolio.sure() if portfolio.best.ok else portfolio.best.why()
    return Facts(heading, sentence, [Table("", ["objective", "starts", "of these random"], rows)])


# --- Two ways to one solution ----------------------------------------------------------------------------------------


@figure(CrossChecked)
def differences(checked: CrossChecked) -> "Figure":
    """The relative differences of two solutions: of the objective, of decisions, statistics and multipliers."""
    multipliers = {f"multiplier of {text}": value for text, value in checked.multipliers.items()}
    groups = {"objective": {"objective": checked.objective}, "decisions": checked.decisions}
    groups |= {"statistics": checked.statistics, "multipliers": multipliers}
    # On a logarithmic axis none and an infinite one have no bar.
    bars = {
        kind: {name if 0 < size < np.inf else f"{name}: {number(size)}": size for name, size in sizes.items()}
        for kind, sizes in groups.items()
        if sizes
    }
    drawn = bars_figure(bars, y="Relative difference")
    limit_line(drawn.update_yaxes(type="log"), checked.tolerance, f"accepted: {given(checked.tolerance)}")
    return drawn
