"""Fronts and trade-offs on a page, linked with their designs, of which a reader chooses one and sees all of it."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from aleator.design import Problem, functionals_of
from aleator.reporting._fronts import bound_unit, front_figure, pair_figure, shadow_price_figure, unit_of
from aleator.reporting._numbers import (
    NOTHING,
    count,
    given,
    number,
    share_text,
    unit_of_decision,
    unit_of_expression,
    unit_of_limit,
    unit_of_objective,
    units_of_statistics,
    words,
)
from aleator.reporting._page import Choice, Linked, Table
from aleator.reporting._paths import components, limits_of, limits_text, path_figure, paths_of
from aleator.reporting._tables import (
    STATUS_WORDS,
    certificate_rows,
    decision_text,
    objective_text,
    violations,
    worst_text,
)
from aleator.solution import Moments, Solution
from aleator.sweep import SAME, Front, Refused, TradeOff
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Instants of a path on a page: more would only make the page larger.
_INSTANTS = 120
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
        return Choice(name, [_table("Certificate", [("Status", STATUS_WORDS[point.status])], point.reason)])
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
    return Choice(name, [one for one in every if one.rows or one.note], list(bands(point)))


def evidence_on(solution: Solution | Refused, known: Iterable[Evidence]) -> Evidence | None:
    """The evidence on this very design: on its decisions, in a problem with the same text; None if there is none."""
    if isinstance(solution, Refused):
        return None
    for one in known:
        same = np.array_equal(one.solution.vector, solution.vector)
        if one.solution is solution or (same and one.solution.problem_text == solution.problem_text):
            return one
    return None


def _table(caption: str, rows: Iterable[tuple[str, str]], note: str = "") -> Table:
    return Table(caption, ["", ""], [list(row) for row in rows], note)


def _prices(solution: Solution, limits: Sequence[str]) -> Iterator[tuple[str, str]]:
    """The shadow price of each limit, and those of the bounds of decisions where these lie at one. Of designs alone."""
    if not solution.ok:
        return
    objective = unit_of_objective(solution.problem)
    for name in limits:
        yield name, _price(solution.multiplier(name), objective, unit_of_limit(name, solution.problem))
    for name, value in solution.bound_multipliers.items():
        if np.any(value) and solution.is_at_bound(name):
            price, unit = float(np.sum(np.abs(value))), unit_of_decision(name, solution.problem)
            yield f"bound of {name}", _price(price, objective, unit)


def _price(value: float, unit: str, by: str) -> str:
    return number(value, 4, f"{unit} per {by}".strip() if by else unit)


def _statistics(solution: Solution) -> Iterator[tuple[str, str]]:
    """The statistics in the problem that are numbers; those of paths are drawn."""
    units = units_of_statistics(solution.problem)
    for text, value in solution.statistics.items():
        if np.ndim(value) == 0:
            yield text, number(float(value), 5, units.get(text, ""))


def bands(solution: Solution) -> "Iterator[Figure]":
    """What is limited over time, at no more than 120 instants: limits on several paths together, then the other paths
    in the problem of a design.
    """
    problem, paths = solution.problem, paths_of(solution.problem)
    own = {name: limits_of(problem, one) for name, one in paths.items()}
    limited = set().union(*(limits.names for limits in own.values()))
    pairs = zip(solution.constraints, problem.constraints, strict=True)
    together = [(one, limit) for one, limit in pairs if one.times is not None and one.name not in limited]
    names = [one.name for one, _ in together]
    for i, (one, limit) in enumerate(together):
        name = f"{one.name} {names[: i + 1].count(one.name)}" if names.count(one.name) > 1 else one.name
        unit, values = unit_of_expression(limit.expression, problem), Moments(one.values, np.zeros_like(one.values))
        yield from _bands(name, unit, np.asarray(one.times), values, 0.0, limits_text([one.lower, one.upper], unit))
    seen = functionals_of(tuple(limit.expression for _, limit in together))
    for name, functional in paths.items():
        if own[name].names or functional not in seen:
            moments, limits = solution.moments[functional.text()], own[name]
            yield from _bands(name, limits.unit, solution.times_of(functional), moments, limits.sigmas, limits.texts)


def _bands(
    name: str, unit: str, times: np.ndarray, moments: Moments, sigmas: float, limits: Mapping[float, str]
) -> "Iterator[Figure]":
    """A path, of a vector each component."""
    shown = np.unique(np.linspace(0, len(times) - 1, min(_INSTANTS, len(times))).round().astype(int))
    for part, one in components(name, moments.mean, moments.std).items():
        paths = {f"mean of {part}" if sigmas else part: Moments(one.mean[shown], one.std[shown])}
        figure = path_figure(times[shown], paths, y=part, unit=unit, sigmas=sigmas, limits=limits)
        yield figure.update_layout(height=300, meta=part)


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
    known, points = list(evidence), _points(fronts)
    choices = [
        choice(f"{before}{front.bound}: {bound}", point, evidence_on(point, known))
        for before, bound, front, point in points
    ]
    doubts = [f"{name}: {one}." for name, front in fronts.items() for one in front.doubts()]
    caption = " ".join(filter(None, [caption, *doubts]))
    chosen = _nearest([point for *_, point in points], recommended)
    return Linked(figures, heading, front_table(fronts, known), choices, chosen, caption, number)


def _points(fronts: Mapping[str, Front]) -> list[tuple[str, str, Front, Solution | Refused]]:
    """Each point of some fronts: the name of its front, if there are several, its bound, its front, and what it is."""
    return [
        (f"{name}, " if len(fronts) > 1 else "", given(value, bound_unit(front)), front, point)
        for name, front in fronts.items()
        for value, point in zip(front.values, front.points, strict=True)
    ]


def front_table(fronts: Mapping[str, Front], evidence: Sequence[Evidence] = ()) -> Table:
    """A row for each point of some fronts along one bound: its optimum and decisions; why there is no design."""
    first = next(iter(fronts.values()))
    decided = _numbers_in(first.points[0].problem)
    rows, counted = [], []
    for before, bound, front, point in _points(fronts):
        if isinstance(point, Solution) and point.ok:
            price, active = number(point.multiplier(front.bound), 4), words(list(point.active), "nothing")
            optimum = [objective_text(point), price, active, *_decided(point, decided)]
        else:
            status = STATUS_WORDS[point.status] if isinstance(point, Solution) else f"no design: {point.reason}"
            optimum = [status, *[NOTHING] * (2 + len(decided))]
        rows.append([f"{before}{bound}", *optimum])
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
        for _, bound, front, point in _points(fronts):
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


def _numbers_in(problem: Problem) -> list[str]:
    """The decisions that are single numbers."""
    return [name for name, place in problem.placements.designed.items() if np.ndim(place.decision.initial) == 0]


def _decided(point: Solution, names: Sequence[str]) -> list[str]:
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
        figures = [pair_figure(front, *pair) for pair in combinations(range(len(front.names)), 2)]
        first = _nearest(front.solutions, recommended)
        blocks.append(Linked(figures, f"Trade-off: {name}", table, choices, first, caption))
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
