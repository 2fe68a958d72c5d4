"""Fronts and trade-offs on a page, linked with their designs, of which a reader chooses one and sees all of it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from aleator.design import Problem
from aleator.reporting._blocks import Linked, Table
from aleator.reporting._choices import choice, evidence_on
from aleator.reporting._fronts import bound_unit, optimum_figure, price_figure, trade_off_figure, unit_of
from aleator.reporting._numbers import given, number, share_text, unit_of_decision, words
from aleator.reporting._tables import STATUS_WORDS, objective_text
from aleator.solution import Solution
from aleator.sweep import SAME, Front, Refused, TradeOff
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def front_blocks(
    fronts: Mapping[str, Front], evidence: Iterable[Evidence] = (), recommended: Solution | None = None
) -> list[Linked]:
    """For each swept bound: the optimum and the shadow price along it, and the designs."""
    known = list(evidence)
    blocks = []
    for bound in dict.fromkeys(one.bound for one in fronts.values()):
        # A study names the front of its design by the bound.
        group = {"design" if name == bound else name: one for name, one in fronts.items() if one.bound == bound}
        caption = (
            f"Filled markers: {bound} is active; open markers: it is not, and something else, or nothing, limits the "
            f"design. Crosses on the axis: no design meets all limits there. The shadow price is what relaxing {bound} "
            "is worth: zero where it is not active."
        )
        figures, heading = [optimum_figure(group), price_figure(group)], f"Optimum against the limit of {bound}"
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
    known, points = list(evidence), [point for front in fronts.values() for point in front.points]
    names = [
        f"{before}{front.bound}: {bound}"
        for (before, front), bounds in zip(_prefixed(fronts), map(_bounds, fronts.values()), strict=True)
        for bound in bounds
    ]
    choices = [choice(name, one, evidence_on(one, known)) for name, one in zip(names, points, strict=True)]
    doubts = [f"{name}: {one}." for name, front in fronts.items() for one in front.doubts()]
    caption = " ".join(filter(None, [caption, *doubts]))
    return Linked(figures, heading, front_table(fronts, known), choices, _nearest(points, recommended), caption, number)


def _bounds(front: Front) -> list[str]:
    """The bound of each point, with its unit."""
    return [given(value, bound_unit(front)) for value in front.values]


def _prefixed(fronts: Mapping[str, Front]) -> list[tuple[str, Front]]:
    """Each front after its name, if there are several."""
    return [(f"{name}, " if len(fronts) > 1 else "", front) for name, front in fronts.items()]


def front_table(fronts: Mapping[str, Front], evidence: Sequence[Evidence] = ()) -> Table:
    """A row for each point of some fronts along one bound: its optimum and decisions; why there is no design."""
    first = next(iter(fronts.values()))
    decided = _numbers_in(first.points[0].problem)
    rows, counted = [], []
    for before, front in _prefixed(fronts):
        for bound, point in zip(_bounds(front), front.points, strict=True):
            rows.append([f"{before}{bound}", *_optimum(front, point), *_decided(point, decided)])
            counted.append(evidence_on(point, evidence))
    header = [f"Limit of {first.bound}", "Objective", "Shadow price", "Active", *decided]
    if any(counted):
        header.append("Violate any limit")
        rows = [[*row, share_text(one.joint if one else None)] for row, one in zip(rows, counted, strict=True)]
    return Table(f"Designs along the limit of {first.bound}", header, rows)


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
            other = [_kind(one.problem) != _kind(recommended.problem) for one in alike.values()]
            return min(zip(other, far.tolist(), alike, strict=True))[-1]
    return next(iter(solved), 0)


def _kind(problem: Problem) -> tuple[Any, ...]:
    return str(problem.objective), problem.placements.germ_names


def disagreements(designs: Mapping[str, Solution], fronts: Mapping[str, Front]) -> list[str]:
    """Where a design and a point of a front solve the same problem, but one is better: the other is a local optimum."""
    sentences = []
    for name, design in designs.items():
        for front in fronts.values():
            for value, point in zip(front.values, front.points, strict=True):
                if not (design.ok and isinstance(point, Solution) and point.ok and point.problem == design.problem):
                    continue
                gap = abs(design.objective - point.objective)
                if gap > SAME * max(abs(design.objective), abs(point.objective)):
                    places = f"'{name}' and the front at {front.bound} = {given(value, bound_unit(front))}"
                    both = f"{objective_text(design)} and {objective_text(point)}"
                    sentences.append(
                        f"{places} are optima of one problem, {both}: the higher one is local, and neither need be the "
                        "least. al.multistart and al.portfolio look for others."
                    )
    return sentences


def _optimum(front: Front, point: Solution | Refused) -> list[str]:
    """Objective, shadow price and what is active; the status or the reason where there is no design."""
    if isinstance(point, Refused):
        return [f"no design: {point.reason}", "–", "–"]
    if not point.ok:
        return [STATUS_WORDS[point.status], "–", "–"]
    return [objective_text(point), number(point.multiplier(front.bound), 4), words(list(point.active), "nothing")]


def _numbers_in(problem: Problem) -> list[str]:
    """The decisions that are single numbers."""
    return [name for name, place in problem.placements.designed.items() if np.ndim(place.decision.initial) == 0]


def _decided(point: Solution | Refused, names: Sequence[str]) -> list[str]:
    """Some decisions where there is a design."""
    if isinstance(point, Refused) or not point.ok:
        return ["–"] * len(names)
    return [number(float(point.decisions[name]), 5, unit_of_decision(name, point.problem)) for name in names]


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
            choices.append(choice(title, one, evidence_on(one, known), wishes | _rates(front, place)))
        first = _nearest(front.solutions, recommended)
        blocks.append(Linked(trade_off_figure(front), f"Trade-off: {name}", table, choices, first, caption))
    return blocks


def trade_off_table(front: TradeOff) -> Table:
    """A row for each design of a trade-off: its wishes, then its decisions."""
    decided = _numbers_in(front.solutions[0].problem) if front.solutions else []
    units = [unit_of(front, i) for i in range(len(front.names))]
    rows = [
        [*(number(float(value), 5, unit) for value, unit in zip(row, units, strict=True)), *_decided(one, decided)]
        for row, one in zip(front.values, front.solutions, strict=True)
    ]
    return Table("", [*front.names, *decided], rows)


def _rates(front: TradeOff, place: int) -> dict[str, str]:
    """By how much each other wish falls for one unit more of the first one, as long as changes are small.

    At the best design of a wish the front ends: its multipliers need not be the slope of what is left of the front, and
    the wish may not give way at all.
    """
    values = front.values
    if np.any(values[place] <= values.min(axis=0)):
        return {"Rates of exchange": "none at an end of the front"}
    first, *others = front.weights[place]
    buys = [
        f"{number(first / weight, 4, unit_of(front, i))} less of {front.names[i]}"
        for i, weight in enumerate(others, start=1)
        if weight > 0 and np.isfinite(first)
    ]
    return {f"Each {unit_of(front, 0) or 'unit'} more of {front.names[0]} buys": " or ".join(buys)} if buys else {}
