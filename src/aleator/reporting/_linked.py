"""Fronts and trade-offs on a page, linked with their designs, of which a reader chooses one and sees all of it."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from aleator.design import statistics_in
from aleator.reporting._fronts import evidence_on, front_figure, front_table, points_of, shadow_price_figure
from aleator.reporting._numbers import (
    count,
    number,
    unit_of_decision,
    unit_of_limit,
    unit_of_objective,
    unit_of_statistic,
    words,
)
from aleator.reporting._page import Choice, Linked, Table
from aleator.reporting._paths import figures_over_time
from aleator.reporting._sweeps import pair_figure, rates_of, trade_off_table
from aleator.reporting._tables import (
    certificate_rows,
    decision_text,
    objective_text,
    status_words,
    violations,
    worst_text,
)
from aleator.solution import Solution
from aleator.sweep import SAME, Front, Refused, TradeOff
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

_UNCHECKED = "No fresh systems were simulated at this design: see al.validate_all."


def choice(
    name: str,
    point: Solution | Refused,
    evidence: Evidence | None = None,
    wishes: Mapping[str, str] = MappingProxyType({}),
) -> Choice:
    """All that is known of a design, or why there is none.

    - `evidence`: on this design; `wishes`: their values and rates, where the objective is a weighted sum of wishes.
    """
    if isinstance(point, Refused):
        return Choice(name, [_table("Certificate", [("Status", status_words(point))], point.reason)])
    limits = list(dict.fromkeys(one.name for one in point.constraints))
    objective, active = [(str(point.problem.objective), objective_text(point))], words(list(point.active), "nothing")
    counted = violations(evidence) if evidence else {}
    alarms = [] if evidence is None or evidence.agrees else [evidence.alarm()]
    alarms += [one.sentence() for one in evidence.compared] if evidence else [_UNCHECKED]
    if evidence:
        agrees = "yes" if evidence.agrees else "no"
        counted = {"Fresh systems": count(evidence.samples), **counted, "Agree with the expansion": agrees}
    tables = [
        _table("Decisions", [(one, decision_text(point, one)) for one in point.decisions]),
        _table("Wishes", wishes.items()) if wishes else _table("Objective", objective),
        _table("Limits", [*((one, worst_text(point, one)) for one in limits), ("Active", active)]),
        _table(f"Shadow prices{' in the weighted sum of the wishes' if wishes else ''}", _prices(point, limits)),
        _table("Statistics", _statistics(point)),
        _table("Evidence", counted.items(), " ".join(alarms)),
    ]
    certificate = _table("Certificate", certificate_rows(point), "" if point.ok else point.why())
    # That there is no design comes first.
    every = [*tables, certificate] if point.ok else [certificate, *tables]
    limited, others = figures_over_time(point)
    figures = [figure().update_layout(height=300, meta=path) for path, figure in (limited | others).items()]
    return Choice(name, [one for one in every if one.rows or one.note], figures)


def _table(caption: str, rows: Iterable[tuple[str, str]], note: str = "") -> Table:
    return Table(caption, ["", ""], [list(row) for row in rows], note)


def _prices(solution: Solution, limits: Sequence[str]) -> Iterator[tuple[str, str]]:
    """The shadow price of each limit, and those of the bounds of decisions where these lie at one. Of designs alone."""
    if not solution.ok:
        return
    prices = [(one, solution.multiplier(one), unit_of_limit(one, solution.problem)) for one in limits]
    for name, value in solution.bound_multipliers.items():
        if np.any(value) and solution.is_at_bound(name):
            price = float(np.sum(np.abs(value)))
            prices.append((f"bound of {name}", price, unit_of_decision(name, solution.problem)))
    unit = unit_of_objective(solution.problem)
    for name, price, by in prices:
        yield name, number(price, 4, f"{unit} per {by}".strip() if by else unit)


def _statistics(solution: Solution) -> Iterator[tuple[str, str]]:
    """The statistics in the problem that are numbers; those of paths are drawn."""
    for one in statistics_in(solution.problem.expressions):
        if np.ndim(value := solution.statistics[one.text()]) == 0:
            yield one.text(), number(float(value), 5, unit_of_statistic(one, solution.problem))


def front_blocks(
    fronts: Mapping[str, Front], evidence: Iterable[Evidence] = (), recommended: Solution | None = None
) -> list[Linked]:
    """For each swept bound: the optimum and the shadow price along it, and the designs."""
    known, blocks = list(evidence), []
    for bound in dict.fromkeys(one.bound for one in fronts.values()):
        # A study names the front of its design by the bound.
        group = {"design" if name == bound else name: one for name, one in fronts.items() if one.bound == bound}
        caption = (
            f"Filled markers: {bound} is active; open markers: it is not, and something else, or nothing, limits the "
            f"design. Crosses on the axis: no design meets all limits there. The shadow price is what relaxing {bound} "
            "is worth: zero where it is not active."
        )
        figures, heading = [front_figure(group), shadow_price_figure(group)], f"Optimum against the limit of {bound}"
        blocks.append(linked_front(group, figures, heading, caption, evidence=known, recommended=recommended))
    return blocks


def linked_front(
    fronts: Mapping[str, Front],
    figures: "Sequence[Figure]",
    heading: str,
    caption: str = "",
    number: str = "",
    evidence: Iterable[Evidence] = (),
    recommended: Solution | None = None,
) -> Linked:
    """Figures of fronts along one bound, linked with the designs.

    - `figures`: of all these fronts in the same order, by `front_figure` or `shadow_price_figure`; `evidence`: on some
      of the designs; `recommended`: the design to build: the one nearest to it is shown first.
    """
    known, points = list(evidence), points_of(fronts)
    choices = [
        choice(f"{before}{front.bound}: {bound}", point, evidence_on(point, known))
        for before, bound, front, point in points
    ]
    doubts = [f"{name}: {one}." for name, front in fronts.items() for one in front.doubts()]
    caption = " ".join(filter(None, [caption, *doubts]))
    chosen = _nearest([point for *_, point in points], recommended)
    return Linked(figures, heading, front_table(fronts, known), choices, chosen, caption, number)


def _nearest(designs: Sequence[Solution | Refused], recommended: Solution | None) -> int:
    """The place of the design that is nearest to the recommended one, among those with its decisions, and before others
    those with its objective and its uncertain numbers; of the first design where there is none.
    """
    solved = {i: one for i, one in enumerate(designs) if isinstance(one, Solution) and one.ok}
    if recommended is not None:
        names, size = list(recommended.decisions), len(recommended.vector)
        alike = {i: one for i, one in solved.items() if list(one.decisions) == names and len(one.vector) == size}
        if alike:
            vectors = np.array([one.vector for one in alike.values()])
            scale = np.ptp(vectors, axis=0)
            far = np.max(np.abs(vectors - recommended.vector) / np.where(scale > 0, scale, 1.0), axis=1)
            kind = str(recommended.problem.objective), recommended.problem.placements.germ_names
            other = [(str(one.problem.objective), one.problem.placements.germ_names) != kind for one in alike.values()]
            return min(zip(other, far.tolist(), alike, strict=True))[-1]
    return next(iter(solved), 0)


def disagreements(designs: Mapping[str, Solution], fronts: Mapping[str, Front]) -> list[str]:
    """Where a design and a point of a front solve the same problem, but one is better: the other is a local optimum."""
    sentences = []
    for name, design in designs.items():
        for _, bound, front, point in points_of(fronts):
            if not (design.ok and isinstance(point, Solution) and point.ok and point.problem == design.problem):
                continue
            gap = abs(design.objective - point.objective)
            if gap > SAME * max(abs(design.objective), abs(point.objective)):
                sentences.append(
                    f"'{name}' and the front at {front.bound} = {bound} are optima of one problem, "
                    f"{objective_text(design)} and {objective_text(point)}: the higher one is local, and neither need "
                    "be the least. al.multistart and al.portfolio look for others."
                )
    return sentences


def trade_off_blocks(
    fronts: Mapping[str, TradeOff], evidence: Iterable[Evidence] = (), recommended: Solution | None = None
) -> list[Linked]:
    """For each trade-off: a figure for each pair of wishes, and the designs."""
    known, blocks = list(evidence), []
    caption = "Each point is a certified design: none other is better in all wishes."
    for name, front in fronts.items():
        if not front.solutions:
            continue
        table, choices = replace(trade_off_table(front), caption=f"Designs of {name}"), []
        for place, (row, one) in enumerate(zip(table.rows, front.solutions, strict=True)):
            wishes = dict(zip(front.names, row, strict=False))
            title = ", ".join(f"{wish}: {value}" for wish, value in wishes.items())
            choices.append(choice(title, one, evidence_on(one, known), wishes | rates_of(front, place)))
        figures = [pair_figure(front, *pair) for pair in combinations(range(len(front.names)), 2)]
        first = _nearest(front.solutions, recommended)
        blocks.append(Linked(figures, f"Trade-off: {name}", table, choices, first, caption))
    return blocks
