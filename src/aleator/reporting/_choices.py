"""What a page shows of designs that a reader chooses: facts as tables, paths, and the data of both for its script."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from aleator.design import functionals_of
from aleator.reporting._blocks import Choice, Linked, Table
from aleator.reporting._numbers import (
    count,
    number,
    residual,
    share_text,
    unit_of_decision,
    unit_of_expression,
    unit_of_functional,
    unit_of_limit,
    unit_of_objective,
    units_of_statistics,
    words,
)
from aleator.reporting._paths import components, ends, limits_of, limits_text, path_figure, paths_of
from aleator.reporting._tables import STATUS_WORDS, decision_text, objective_text, status_words, worst_text
from aleator.solution import Moments, Solution
from aleator.sweep import Refused
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Instants of a path on a page: more would only make the page larger.
_INSTANTS = 120
# A curve is written to this part of its range.
_FINE = 2000

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
    objective = _table("Objective", [(str(point.problem.objective), objective_text(point))])
    tables = [
        _table("Decisions", [(one, decision_text(point, one)) for one in point.decisions]),
        _table("Wishes", wishes.items()) if wishes else objective,
        _table("Limits", [(one, worst_text(point, one)) for one in limits]),
        _table(f"Shadow prices{' in the weighted sum of the wishes' if wishes else ''}", _prices(point, limits)),
        _table("Statistics", _statistics(point)),
        _table("Evidence", _counted(evidence), _UNCHECKED if evidence is None else " ".join(_alarms(evidence))),
    ]
    certificate = _table("Certificate", _certified(point), "" if point.ok else point.why())
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


def _counted(evidence: Evidence | None) -> Iterator[tuple[str, str]]:
    if evidence is None:
        return
    yield "Fresh systems", count(evidence.samples)
    for name, share in evidence.violations.items():
        yield f"Violate {name}", share_text(share)
    if evidence.violations:
        yield "Violate any limit", share_text(evidence.joint)
    yield "Agree with the expansion", "yes" if evidence.agrees else "no"


def _alarms(evidence: Evidence) -> list[str]:
    return [*([] if evidence.agrees else [evidence.alarm()]), *(one.sentence() for one in evidence.compared)]


def _certified(solution: Solution) -> Iterator[tuple[str, str]]:
    yield "Status", status_words(solution)
    yield "Active", words(list(solution.active), "nothing")
    certificate = solution.certificate
    names = ("violation", "stationarity", "complementarity")
    yield "Residuals, scaled", ", ".join(f"{name} {residual(getattr(certificate, name))}" for name in names)
    errors = certificate.expansion.leave_one_out
    if errors and certificate.expansion.points > 1:
        worst = max(errors, key=lambda text: errors[text])
        yield "Worst leave-one-out error", f"{residual(errors[worst])} ({worst})"


def bands(solution: Solution) -> "Iterator[Figure]":
    """What is limited over time, at no more than 120 instants: limits on several paths together, then the other paths
    in the problem of a design.
    """
    problem, paths = solution.problem, paths_of(solution.problem)
    units = {name: unit_of_functional(one, problem) for name, one in paths.items()}
    own = {name: limits_of(problem, one, units[name]) for name, one in paths.items()}
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
            yield from _bands(name, units[name], solution.times_of(functional), moments, limits.sigmas, limits.texts)


def _bands(
    name: str, unit: str, times: np.ndarray, moments: Moments, sigmas: float, limits: Mapping[float, str]
) -> "Iterator[Figure]":
    """A path, of a vector each component."""
    shown = np.unique(np.linspace(0, len(times) - 1, min(_INSTANTS, len(times))).round().astype(int))
    for part, one in components(name, moments.mean, moments.std).items():
        paths = {f"mean of {part}" if sigmas else part: Moments(one.mean[shown], one.std[shown])}
        figure = path_figure(times[shown], paths, y=part, unit=unit, sigmas=sigmas, limits=limits)
        yield figure.update_layout(height=300, meta=part)


def stages(block: Linked) -> "dict[str, Figure]":
    """A figure for each path of the choices, by its name, on axes that suit all of them."""
    every: dict[str, list[Any]] = {}
    for figure in (figure for one in block.choices for figure in one.bands):
        every.setdefault(_path_of(figure), []).append(figure)
    stages = {}
    for name, figures in every.items():
        times = [edge for one in figures for edge in ends(np.asarray(one.data[-1].x))]
        reached = [edge for one in figures for edge in one.layout.yaxis.range]
        stages[name] = type(figures[0])(figures[0]).update_xaxes(range=[min(times), max(times)])
        stages[name].update_yaxes(range=[min(reached), max(reached)])
    return stages


def choices_data(block: Linked) -> list[dict[str, Any]]:
    """Names, facts and paths of the choices, as JSON."""
    return [
        {
            "name": one.name,
            "facts": [{"caption": table.caption, "rows": table.rows, "note": table.note} for table in one.facts],
            "bands": {_path_of(figure): _drawn(figure) for figure in one.bands},
        }
        for one in block.choices
    ]


def _path_of(figure: Any) -> str:
    return figure.layout.meta


def _drawn(figure: Any) -> dict[str, Any]:
    """What differs between the designs in the figure of a path: its curves and its limits."""
    layout, traces = figure.layout.to_plotly_json(), [one.to_plotly_json() for one in figure.data]
    limits = {kind: layout.get(kind, []) for kind in ("shapes", "annotations")}
    numbers = ("x", "y", "customdata")
    curves = [{key: _rounded(one) if key in numbers else one for key, one in each.items()} for each in traces]
    return {"data": curves, "layout": limits}


def _rounded(values: np.ndarray) -> list[float | None]:
    """Numbers to a part of their range that is finer than a pixel; null where one is not finite."""
    known = [*ends(values)]
    wide = max(known, default=0.0) - min(known, default=0.0)
    digits = math.ceil(-math.log10(wide / _FINE)) if wide > 0 else 6
    return [round(float(one), digits) if math.isfinite(one) else None for one in values]
