"""Fronts and trade-offs on a page, each linked with its designs: a reader chooses one and sees all of it."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from aleator.reporting._blocks import Choice, Linked, Table
from aleator.reporting._choices import choice, evidence_on
from aleator.reporting._numbers import given, number, share_text, unit_of_decision, words
from aleator.reporting._sweeps import bound_unit, optimum_figure, price_figure, told_values, trade_off_figure, unit_of
from aleator.reporting._tables import STATUS_WORDS, objective_text
from aleator.solution import Solution
from aleator.sweep import SAME, Front, Refused, TradeOff
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

_CHOOSE = "Choose a design, by a click on its point or in the table, to see it beside the figures."


def front_blocks(fronts: Mapping[str, Front], evidence: Iterable[Evidence] = ()) -> list[Linked]:
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
        figures = [optimum_figure(group), price_figure(group)]
        blocks.append(linked_front(group, figures, f"Optimum against the limit of {bound}", caption, evidence=known))
    return blocks


def linked_front(
    fronts: Mapping[str, Front],
    figures: "Sequence[Figure]",
    heading: str,
    caption: str = "",
    number: str = "",
    evidence: Iterable[Evidence] = (),
) -> Linked:
    """Figures of fronts along one bound, linked with the designs.

    - `figures`: of all these fronts in the same order, by `front_figure` or `shadow_price_figure`; `evidence`: on some
      of the designs.
    """
    known = list(evidence)
    points = [point for front in fronts.values() for point in front.points]
    places = zip(_places(fronts), points, strict=True)
    choices = [choice(name, point, evidence_on(point, known)) for name, point in places]
    doubts = [f"{name}: {one}." for name, front in fronts.items() for one in front.doubts()]
    caption = " ".join(filter(None, [caption, *doubts, _CHOOSE]))
    first = next((i for i, one in enumerate(points) if one.ok), 0)
    return Linked(figures, heading, _front_table(fronts, known), choices, first, caption, number)


def disagreements(designs: Mapping[str, Solution], fronts: Mapping[str, Front]) -> list[str]:
    """Where a design and a point of a front solve the same problem, but one is better: the other is a local optimum."""
    found = []
    for name, design in designs.items():
        for front in fronts.values():
            for value, point in zip(front.values, front.points, strict=True):
                if not (design.ok and isinstance(point, Solution) and point.ok and point.problem == design.problem):
                    continue
                gap = abs(design.objective - point.objective)
                if gap > SAME * max(abs(design.objective), abs(point.objective)):
                    told = f"'{name}' and the front at {front.bound} = {given(value, bound_unit(front))}"
                    both = f"{objective_text(design)} and {objective_text(point)}"
                    found.append(
                        f"{told} are optima of one problem, {both}: the higher one is local, and neither need be the "
                        "least. al.multistart and al.portfolio look for others."
                    )
    return found


def _places(group: Mapping[str, Front]) -> list[str]:
    """The name of each point of some fronts: its bound, after the name of its front if there are several."""
    places = []
    for name, front in group.items():
        before = f"{name}, " if len(group) > 1 else ""
        places += [f"{before}{front.bound}: {given(value, bound_unit(front))}" for value in front.values]
    return places


def _front_table(group: Mapping[str, Front], evidence: list[Evidence]) -> Table:
    """A row for each point of some fronts along one bound."""
    first = next(iter(group.values()))
    decided = _numbers_in(first.solutions[0])
    counted = [evidence_on(one, evidence) for front in group.values() for one in front.points]
    header = [f"Limit of {first.bound}", "Objective", "Shadow price", "Active", *decided]
    rows = []
    for name, front in group.items():
        before = f"{name}, " if len(group) > 1 else ""
        for value, point in zip(front.values, front.points, strict=True):
            row = [f"{before}{given(value, bound_unit(front))}", *_told(front, point)]
            rows.append([*row, *(_decided(point, one) for one in decided)])
    if any(counted):
        header.append("Violate any limit")
        rows = [[*row, share_text(one.joint if one else None)] for row, one in zip(rows, counted, strict=True)]
    return Table(f"Designs along the limit of {first.bound}", header, rows)


def _told(front: Front, point: Solution | Refused) -> list[str]:
    """Objective, shadow price and what is active; the status where there is no design."""
    if isinstance(point, Refused) or not point.ok:
        return [STATUS_WORDS[point.status], "–", "–"]
    return [objective_text(point), number(point.multiplier(front.bound), 4), words(list(point.active), "nothing")]


def _numbers_in(solution: Solution) -> list[str]:
    """The decisions that are single numbers."""
    return [name for name, value in solution.decisions.items() if np.ndim(value) == 0]


def _decided(point: Solution | Refused, name: str) -> str:
    """A decision where there is a design."""
    if isinstance(point, Refused) or not point.ok:
        return "–"
    return number(float(point.decisions[name]), 5, unit_of_decision(name, point.problem))


def trade_off_blocks(fronts: Mapping[str, TradeOff], evidence: Iterable[Evidence] = ()) -> list[Linked]:
    """For each trade-off: a figure for each pair of wishes, and the designs."""
    known = list(evidence)
    return [_trade_off_block(front, name, known) for name, front in fronts.items() if front.solutions]


def _trade_off_block(front: TradeOff, name: str, evidence: list[Evidence]) -> Linked:
    caption = f"Each point is a certified design: none other is better in all wishes. {_CHOOSE}"
    choices = [_traded(front, i, evidence) for i in range(len(front.solutions))]
    return Linked(trade_off_figure(front), f"Trade-off: {name}", _trade_off_table(front, name), choices, 0, caption)


def _traded(front: TradeOff, place: int, evidence: list[Evidence]) -> Choice:
    """A design of a trade-off, with the values of its wishes, and the rates at which they buy one another."""
    values = dict(zip(front.names, told_values(front, front.values[place]), strict=True))
    name = ", ".join(f"{wish}: {value}" for wish, value in values.items())
    solution = front.solutions[place]
    return choice(name, solution, evidence_on(solution, evidence), values | _rates(front, place))


def _rates(front: TradeOff, place: int) -> dict[str, str]:
    """By how much each other wish falls for one unit more of the first one, as long as changes are small.

    At the best design of a wish the front ends: its multipliers need not be the slope of what is left of the front, and
    the wish may not give way at all.
    """
    values = front.values
    if np.any(values[place] <= values.min(axis=0)):
        return {"Rates of exchange": "none at an end of the front"}
    first, *others = front.weights[place]
    unit = unit_of(front, 0)
    return {
        f"Each {unit or 'unit'} more of {front.names[0]} buys": (
            f"{number(first / weight, 4, unit_of(front, i))} less of {front.names[i]}"
        )
        for i, weight in enumerate(others, start=1)
        if weight > 0 and np.isfinite(first)
    }


def _trade_off_table(front: TradeOff, name: str) -> Table:
    """The designs of a trade-off: wishes, then decisions."""
    decided = _numbers_in(front.solutions[0])
    rows = [
        [*told_values(front, row), *(_decided(solution, one) for one in decided)]
        for row, solution in zip(front.values, front.solutions, strict=True)
    ]
    return Table(f"Designs of {name}", [*front.names, *decided], rows)
