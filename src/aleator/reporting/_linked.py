"""Fronts and trade-offs on a page, linked with their designs, of which a reader chooses one and sees all of it."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from aleator.reporting._documents import objective_text, rows_of, solution_document, status_words
from aleator.reporting._fronts import (
    evidence_on,
    front_figure,
    front_table,
    pair_figure,
    points_of,
    rates_of,
    shadow_price_figure,
    trade_off_table,
)
from aleator.reporting._page import Choice, Linked, Table
from aleator.reporting._solutions import over_time
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
        return Choice(name, [Table("Certificate", ["", ""], [["Status", status_words(point)]], point.reason)])
    rows = list(rows_of(solution_document(point, evidence)))
    alarms = [] if evidence is None or evidence.agrees else [evidence.alarm()]
    alarms += [one.sentence() for one in evidence.compared] if evidence else [_UNCHECKED]

    achieved = wishes or {str(point.problem.objective): objective_text(point)}

    def facts(caption: str, *kinds: str, note: str = "") -> Table:
        return Table(caption, ["", ""], [[row.label, row.text] for row in rows if row.kind in kinds], note)

    tables = [
        facts("Decisions", "Decisions"),
        Table("Wishes" if wishes else "Objective", ["", ""], [[*one] for one in achieved.items()]),
        facts("Limits", "Limits", "Active"),
        facts(f"Shadow prices{' in the weighted sum of the wishes' if wishes else ''}", "Shadow prices"),
        facts("Statistics", "Statistics"),
        facts("Evidence", "Evidence", note=" ".join(alarms)),
    ]
    certificate = facts("Certificate", "Status", "Certificate", note="" if point.ok else point.why())
    # That there is no design comes first.
    every = [*tables, certificate] if point.ok else [certificate, *tables]
    figures = [one.draw(point, one.name).update_layout(height=300, meta=one.name) for one in over_time(point)]
    return Choice(name, [one for one in every if one.rows or one.note], figures)


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
    chosen = _nearest([point for *_, point in points], recommended)
    return Linked(figures, heading, front_table(fronts, known), choices, chosen, " ".join([caption, *doubts]), number)


def trade_off_blocks(
    fronts: Mapping[str, TradeOff], evidence: Iterable[Evidence] = (), recommended: Solution | None = None
) -> list[Linked]:
    """For each trade-off: a figure for each pair of wishes, and the designs."""
    known, blocks = list(evidence), []
    caption = "Each point is a certified design: none other is better in all wishes."
    for name, front in fronts.items():
        if not front.solutions:
            continue
        table, choices = trade_off_table(front, f"Designs of {name}"), []
        for place, (row, one) in enumerate(zip(table.rows, front.solutions, strict=True)):
            wishes = dict(zip(front.names, row, strict=False))
            title = ", ".join(f"{wish}: {value}" for wish, value in wishes.items())
            choices.append(choice(title, one, evidence_on(one, known), wishes | rates_of(front, place)))
        figures = [pair_figure(front, *pair) for pair in combinations(range(len(front.names)), 2)]
        first = _nearest(front.solutions, recommended)
        blocks.append(Linked(figures, f"Trade-off: {name}", table, choices, first, caption))
    return blocks


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
            other = [_kind(one) != _kind(recommended) for one in alike.values()]
            return min(zip(other, far.tolist(), alike, strict=True))[-1]
    return next(iter(solved), 0)


def _kind(design: Solution) -> tuple[str, Sequence[str]]:
    return str(design.problem.objective), design.problem.placements.germ_names


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
