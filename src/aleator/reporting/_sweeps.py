"""Figures and facts of other sweeps: calibrations, penalties, evidence on many designs, local optima, cross-checks."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from aleator._core.errors import ProblemError
from aleator.reporting._documents import objective_text
from aleator.reporting._numbers import given, number, percent, share_text, unit_of
from aleator.reporting._page import Table
from aleator.reporting._samples import bars_figure, draw_shares, shares_figure
from aleator.reporting._showing import Facts, facts_of, figure
from aleator.reporting._style import ALARM, Look, blank, limit_line, plain
from aleator.sweep import Calibration, CrossChecked, EvidenceOfAll, Hardened, Portfolio, Starts

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# --- Margins, penalties, evidence ------------------------------------------------------------------------------------


@figure(Calibration, "trials")
def calibration_figure(calibration: Calibration, *, who: str = "systems") -> "Figure":
    """The violation rate against the margin, with intervals; the target; the chosen margin on fresh samples."""
    y = plain(f"{who.capitalize()} that violate {calibration.name} (%)")
    figure = blank("Margin a (multiples of σ)", y, height=380)
    trials = sorted(calibration.trials, key=lambda one: one.sigmas)
    dotted = {"mode": "markers+lines" if len(trials) > 1 else "markers", "line_width": 1, "line_dash": "dot"}
    sigmas, shares = [one.sigmas for one in trials], [one.violation for one in trials]
    named = {"name": "trials, one sample for all", "marker_size": 8}
    draw_shares(figure, sigmas, shares, Look("#0072b2", "circle"), **named, **dotted)
    fresh = [] if calibration.confirmation is None else [calibration.confirmation]
    named = {"name": "the choice, on fresh samples", "mode": "markers", "marker_size": 14}
    draw_shares(figure, [calibration.sigmas] * len(fresh), fresh, Look(ALARM, "star"), **named)
    limit_line(figure, 100 * calibration.target, f"target {given(100 * calibration.target)} %")
    return figure.update_yaxes(rangemode="tozero")


@facts_of.register(Calibration)
def _(calibration: Calibration) -> Facts:
    name, trials = calibration.name, calibration.trials
    rows = [[f"{one.sigmas:.4f}", number(one.solution.objective, 5), share_text(one.violation)] for one in trials]
    end = "confirmed" if calibration.confirmed else "not confirmed"
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
    heading = f"Penalties: {'all' if hardened.holds else 'not all'} limits hold"
    return Facts(heading, "", [Table("", ["weight", "objective", "excess"], rows)])


@figure(EvidenceOfAll, "violations")
def violations_of_all(along: EvidenceOfAll) -> "Figure":
    """How many systems of each design break each limit, with 95 % confidence intervals."""
    shares = {name: [one.violations.get(name) if one else None for one in along.evidence] for name in _counted(along)}
    return shares_figure(along.places, shares, x="Design", y="Systems that break the limit")


def _counted(along: EvidenceOfAll) -> list[str]:
    """The limits that are counted on any design."""
    return list(dict.fromkeys(name for one in along.evidence if one for name in one.violations))


@facts_of.register(EvidenceOfAll)
def _(along: EvidenceOfAll) -> Facts:
    names = _counted(along)
    rows = [
        [place, *(share_text(one.violations.get(name)) if one else along.refused[i] for name in names)]
        for i, (place, one) in enumerate(zip(along.places, along.evidence, strict=True))
    ]
    heading = f"Evidence on {len(along.designs)} designs"
    sentence = "" if along.agrees else "Samples contradict some of the designs, or these could not be simulated."
    return Facts(heading, sentence, [Table("Systems that break limits, with 95 % intervals", ["design", *names], rows)])


# --- Local optima ----------------------------------------------------------------------------------------------------


@figure(Starts)
def objectives(starts: Starts) -> "Figure":
    """How many starts led to each local optimum, best first, and how many failed."""
    counts = {f"{i}: {objective_text(one)}": led for i, (one, led) in enumerate(starts.optima, 1)}
    if failed := sum(not one.ok for one in starts.solutions):
        counts["failed"] = failed
    return _optima({"starts": counts})


@figure(Portfolio)
def optima(portfolio: Portfolio) -> "Figure":
    """How many starts led to each optimum, best first: in all, and of the random ones."""
    if not portfolio.optima:
        raise ProblemError(f"plot.optima: expected an optimum; received none: {portfolio.best.why()}")
    unit = unit_of(portfolio.best.problem.objective, portfolio.best.problem)
    places = {f"{i}: {number(one.objective, 5, unit)}": one for i, one in enumerate(portfolio.optima, 1)}
    random = {place: one.random for place, one in places.items()}
    return _optima({"starts": {place: one.starts for place, one in places.items()}, "of these random": random})


def _optima(counts: Mapping[str, Mapping[str, int]]) -> "Figure":
    drawn = bars_figure(counts, y="Starts that led there")
    return drawn.update_xaxes(title_text="Objective of each optimum, best first")


@facts_of.register(Starts)
def _(starts: Starts) -> Facts:
    every = len(starts.solutions)
    rows = [[objective_text(one, 6), f"{led} of {every}"] for one, led in starts.optima]
    heading = f"{every} starts: {len(rows)} local optima"
    sentence = "" if starts.best.ok else starts.best.why()
    return Facts(heading, sentence, [Table("", ["objective", "starts"], rows)])


@facts_of.register(Portfolio)
def _(portfolio: Portfolio) -> Facts:
    unit = unit_of(portfolio.best.problem.objective, portfolio.best.problem)
    rows = [[number(one.objective, 6, unit), f"{one.starts}", f"{one.random}"] for one in portfolio.optima]
    heading = f"Portfolio of {portfolio.starts} starts: {len(rows)} optima"
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
