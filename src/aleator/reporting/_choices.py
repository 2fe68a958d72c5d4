"""What a page shows of designs that a reader chooses: facts as tables, paths, and the data of both for its script."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from aleator.design import functionals_of
from aleator.reporting._blocks import Band, Choice, Linked, Table
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
from aleator.reporting._style import padded, plain
from aleator.reporting._tables import STATUS_WORDS, decision_text, objective_text, status_words, worst_text
from aleator.solution import Moments, Solution
from aleator.sweep import Refused
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Instants of a path on a page: more would only make the page larger.
_INSTANTS = 120
# A band is written to this part of the range of its figure, finer than a pixel.
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
        _table("Evidence", _counted(evidence), _alarms(evidence)),
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


def _alarms(evidence: Evidence | None) -> str:
    if evidence is None:
        return _UNCHECKED
    alarms = [] if evidence.agrees else [evidence.alarm()]
    return " ".join([*alarms, *(one.sentence() for one in evidence.compared)])


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


def bands(solution: Solution) -> Iterator[Band]:
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
) -> Iterator[Band]:
    """A path, of a vector each component."""
    shown = np.unique(np.linspace(0, len(times) - 1, min(_INSTANTS, len(times))).round().astype(int))
    for part, one in components(name, moments.mean, moments.std).items():
        yield Band(part, unit, times[shown], one.mean[shown], one.std[shown], sigmas, limits)


def stages(block: Linked) -> "dict[str, Figure]":
    """A figure for each path of the choices, by its name, as the choice with the widest band; all on the same axes."""
    figures = {}
    for name, each in _by_name(block).items():
        widest = max(each, key=lambda band: band.sigmas * float(np.max(band.std)))
        moments = {f"mean of {name}" if widest.sigmas else name: Moments(widest.mean, widest.std)}
        named = {"y": name, "unit": widest.unit, "limits": widest.limits}
        figure = path_figure(widest.times, moments, sigmas=widest.sigmas, **named).update_layout(height=300)
        figure.update_xaxes(range=[min(one.times.min() for one in each), max(one.times.max() for one in each)])
        figures[name] = figure.update_yaxes(range=padded(_reached(each), 0.1))
    return figures


def choices_data(block: Linked) -> dict[str, Any]:
    """Names, facts and paths of the choices, as JSON."""
    grouped = _by_name(block)
    finest = {
        name: (_digits([edge for one in each for edge in ends(one.times)]), _digits(_reached(each)))
        for name, each in grouped.items()
    }
    return {
        "paths": list(grouped),
        "choices": [
            {
                "name": one.name,
                "facts": [
                    {"caption": table.caption, "rows": [list(row) for row in table.rows], "note": table.note}
                    for table in one.facts
                ],
                "bands": {band.name: _numbers(band, *finest[band.name]) for band in one.bands},
            }
            for one in block.choices
        ],
    }


def _by_name(block: Linked) -> dict[str, list[Band]]:
    """The bands of all choices by the names of their paths."""
    grouped: dict[str, list[Band]] = {}
    for band in (band for one in block.choices for band in one.bands):
        grouped.setdefault(band.name, []).append(band)
    return grouped


def _reached(bands: Sequence[Band]) -> list[float]:
    """The ends of all bands, and their limits."""
    edges = [edge for one in bands for sign in (-1, 1) for edge in ends(one.mean + sign * one.sigmas * one.std)]
    return [*edges, *(value for one in bands for value in one.limits)]


def _digits(values: Sequence[float]) -> int:
    """The decimals by which a figure that reaches over these values is drawn exactly."""
    wide = max(values, default=1.0) - min(values, default=0.0)
    return math.ceil(-math.log10(wide / _FINE)) if wide > 0 else 6


def _numbers(band: Band, seconds: int, digits: int) -> dict[str, Any]:
    return {
        "times": _rounded(band.times, seconds),
        "mean": _rounded(band.mean, digits),
        # One digit more: it is multiplied.
        "std": _rounded(band.std, digits + 1),
        "sigmas": band.sigmas,
        "limits": [[value, plain(text)] for value, text in band.limits.items()],
    }


def _rounded(values: np.ndarray, digits: int) -> list[float | None]:
    """Numbers as JSON, without a fraction where they have none; null where one is not finite."""
    rounded = (round(float(one), digits) if math.isfinite(one) else None for one in values)
    return [int(one) if one is not None and one.is_integer() else one for one in rounded]
