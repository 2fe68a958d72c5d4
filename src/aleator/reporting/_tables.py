"""A design as one document: what `designs.json` has of it, and what every table is made of, row by row; the tables."""

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType, SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from aleator.design import statistics_in
from aleator.reporting._numbers import (
    NOTHING,
    count,
    given,
    number,
    residual,
    seconds,
    share_text,
    unit_of,
    unit_of_decision,
    units_of_moments,
    values_text,
    words,
)
from aleator.reporting._page import Table
from aleator.solution import Solution
from aleator.sweep import Refused
from aleator.validation import Evidence

# So many digits tell apart the designs of any study, and can be read aloud.
_DIGITS = 12
# Numbers of an array that are listed at most.
_LISTED = 6
# Where the label of the printed certificate is short for want of room.
_LABELS = {"between": "limits between the instants", "grid": "error of the grid", "fresh": "fresh systems"}


def digest(content: bytes) -> str:
    """Twelve digits that stand for some content."""
    return hashlib.sha256(content).hexdigest()[:_DIGITS]


def design_digest(solution: Solution) -> str:
    """Twelve digits that stand for a design: its equations, its decisions and its objective.

    They change with any of these, and are the same on a page and in `designs.json`.
    """
    numbers = np.array([*solution.vector, solution.objective], dtype=float)
    return digest(solution.problem.physics.text.encode() + numbers.tobytes())


def status_words(point: Solution | Refused) -> str:
    """How a solve ended, or what its certificate says against its answer."""
    objection = point.objection if isinstance(point, Solution) else None
    return point.status.value.partition(":")[0] if objection is None else objection.phrase


def objective_text(solution: Solution, digits: int = 5) -> str:
    """The objective with its unit."""
    return number(solution.objective, digits, unit_of(solution.problem.objective, solution.problem))


# --- Documents -------------------------------------------------------------------------------------------------------


def solution_document(solution: Solution, evidence: Evidence | None = None) -> dict[str, Any]:
    """One design: decisions, objective, constraints, certificate and, where it was sampled, violations."""
    problem, certificate, effort = solution.problem, solution.certificate, solution.effort
    said = dict[str, str]()
    for label, text in certificate.rows():
        said[label] = f"{said[label]}; {text}" if label in said else text
    document: dict[str, Any] = {
        "status": solution.status.value,
        "verdict": status_words(solution),
        "decisions": {
            name: {
                "value": value,
                "unit": unit_of_decision(name, problem),
                "multiplier": solution.bound_multipliers.get(name),
                "at_bound": solution.is_at_bound(name),
            }
            for name, value in solution.decisions.items()
        },
        "objective": {
            "value": solution.objective,
            "unit": unit_of(problem.objective, problem),
            "expression": str(problem.objective),
        },
        "active": solution.active,
        # At their worst instants: histories are in the netCDF file.
        "constraints": [
            {
                **_named(one, "name", "text", "lower", "upper", "violation", "shadow_price", "holds"),
                "unit": unit_of(declared.expression, problem),
                "worst_value": one.worst,
                "worst_time_s": one.worst_time,
                "active": bool(np.any(one.active)),
            }
            for one, declared in zip(solution.constraints, problem.constraints, strict=True)
        ],
        # Numbers alone, for the same reason.
        "statistics": {
            one.text(): {"value": solution.statistics[one.text()], "unit": unit_of(one, problem)}
            for one in statistics_in(problem.expressions)
            if np.ndim(solution.statistics[one.text()]) == 0
        },
        "certificate": {
            **_named(certificate, "violation", "stationarity", "complementarity"),
            **_named(effort, "iterations", "evaluations", "solver"),
            "search": None if effort.searched is None else str(effort.searched),
            "message": solution.message,
            "said": said,
        },
        "meshes": [str(one) for one in solution.meshes],
        "expansion": {
            **_named(certificate.expansion, "order", "terms", "points", "condition_number", "leave_one_out"),
            "leave_one_out_of_derivatives": certificate.expansion.tangents,
        },
        "seconds": {"compile": effort.times.compile_, "solve": effort.times.solve},
        "digest": design_digest(solution),
        "problem": solution.problem_text.splitlines(),
    }
    if not solution.ok:
        document["why"] = solution.why()
    if evidence is not None:
        document["evidence"] = evidence_document(evidence)
    return document


def evidence_document(evidence: Evidence) -> dict[str, Any]:
    """Evidence on one design: the share of fresh systems that break each limit, with its interval."""
    shares = {**evidence.violations, "any": evidence.joint} if evidence.violations else {}
    parts = ("estimate", "lower", "upper", "confidence", "count")
    return {
        **_named(evidence, "samples", "seed", "instants", "agrees"),
        "disagreements": [one.sentence() for one in evidence.disagreements],
        "compared": [one.sentence() for one in evidence.compared],
        "violations": {limit: _named(share, *parts) for limit, share in shares.items()},
    }


def _named(one: Any, *names: str) -> dict[str, Any]:
    """Attributes by their names."""
    return {name: getattr(one, name) for name in names}


# --- Rows ------------------------------------------------------------------------------------------------------------


class Row(NamedTuple):
    """One thing that is known of a design: of which kind it is, what it is called, and what it is in words.

    - `exact`: all digits, where designs are compared by it; None for what follows from other rows.
    """

    kind: str
    label: str
    text: str
    exact: Any = None


def rows_of(document: Mapping[str, Any]) -> Iterator[Row]:
    """All that a document says of a design, also one that was read from `designs.json`."""
    yield Row("Status", "Status", document["verdict"], document["status"])
    for name, one in document["decisions"].items():
        yield Row("Decisions", name, _decision(one), (one["value"], one["unit"]))
    objective, limits = document["objective"], dict[str, list[Any]]()
    text = number(objective["value"], 5, objective["unit"])
    yield Row("Objective", "Objective", text, (objective["value"], objective["unit"]))
    for one in document["constraints"]:
        limits.setdefault(one["name"], []).append(one)
    for name, parts in limits.items():
        yield Row("Limits", name, _worst(parts))
    broken = list(dict.fromkeys(one["name"] for one in document["constraints"] if not one["holds"]))
    yield Row("Active", "Active", words([name for name in document["active"] if name not in broken], "nothing"))
    if broken:
        yield Row("Active", "Violated", words(broken))
    if "why" not in document:
        yield from _prices(document, limits)
    for text, one in document["statistics"].items():
        yield Row("Statistics", text, number(one["value"], 5, one["unit"]))
    if "evidence" in document:
        yield from evidence_rows(document["evidence"])
    yield from _certificate(document)


def _decision(one: Mapping[str, Any]) -> str:
    """A decision with its unit, of a long array from where to where it goes."""
    values, unit = np.asarray(one["value"], float), one["unit"]
    text = values_text(values, 5, unit)
    if values.size > _LISTED:
        text = f"{values.size} numbers from {number(values.min(), 4)} to {number(values.max(), 4, unit)}"
    return f"{text} (at its bound)" if one["at_bound"] else text


def _worst(parts: Sequence[Mapping[str, Any]]) -> str:
    """Of the limits of one name, the value closest to or furthest beyond a bound, and that bound."""
    one, (above, below) = max(((one, _excesses(one)) for one in parts), key=lambda each: max(each[1]))
    relation, bound = ("≤", one["upper"]) if above >= below else ("≥", one["lower"])
    relation = "=" if one["lower"] == one["upper"] else relation
    when = "" if one["worst_time_s"] is None else f" at {number(one['worst_time_s'], 4, 's')}"
    text = f"{number(one['worst_value'], 5)} {relation} {given(bound, one['unit'])}{when}"
    return text if one["holds"] else f"{text}, violated"


def _excesses(one: Mapping[str, Any]) -> list[float]:
    """How far a limit at its worst is above its upper bound and below its lower one: JSON has no infinite bounds."""
    value, lower, upper = (np.nan if one[key] is None else one[key] for key in ("worst_value", "lower", "upper"))
    return [-np.inf if np.isnan(excess) else excess for excess in (value - upper, lower - value)]


def _prices(document: Mapping[str, Any], limits: Mapping[str, Sequence[Any]]) -> Iterator[Row]:
    """The shadow price of each limit, and those of the bounds of decisions where these lie at one."""
    prices = [(name, _price(parts), parts[0]["unit"]) for name, parts in limits.items()]
    for name, one in document["decisions"].items():
        if one["at_bound"] and np.any(one["multiplier"]):
            prices.append((f"bound of {name}", float(np.sum(np.abs(one["multiplier"]))), one["unit"]))
    unit = document["objective"]["unit"]
    for name, price, by in prices:
        yield Row("Shadow prices", name, number(price, 4, f"{unit} per {by}".strip() if by else unit))


def _price(parts: Sequence[Mapping[str, Any]]) -> float:
    return float(sum(one["shadow_price"] for one in parts))


def evidence_rows(evidence: Mapping[str, Any]) -> Iterator[Row]:
    """How often fresh systems break each limit, and whether they agree with the expansion."""
    yield Row("Evidence", "Fresh systems", count(evidence["samples"]))
    for limit, share in evidence["violations"].items():
        label = f"Systems that violate {'any limit' if limit == 'any' else limit}"
        yield Row("Evidence", label, share_text(SimpleNamespace(**share)), share)  # type: ignore[arg-type]
    yield Row("Evidence", "Agree with the expansion", "yes" if evidence["agrees"] else "no")


def _certificate(document: Mapping[str, Any]) -> Iterator[Row]:
    """How far a design can be trusted, and what it took."""
    certificate, expansion, times = document["certificate"], document["expansion"], document["seconds"]
    rows = {"Solver": certificate["solver"]}
    if document["meshes"]:
        rows["States"] = f"variables, {document['meshes'][-1]}"
    rows |= {
        f"{name.capitalize()} (scaled)": residual(certificate[name])
        for name in ("violation", "stationarity", "complementarity")
    }
    # That of the certificate itself are the residuals.
    said: dict[str, str] = {label: text for label, text in certificate["said"].items() if label != "certificate"}
    rows |= {_LABELS.get(label, label).capitalize(): text for label, text in said.items()}
    if expansion["points"] > 1:
        rows |= {f"Leave-one-out error, {text}": residual(one) for text, one in expansion["leave_one_out"].items()}
    rows["Iterations / evaluations"] = f"{certificate['iterations']} / {certificate['evaluations']}"
    if certificate["search"]:
        rows["Search"] = certificate["search"]
    rows["Time to compile / to solve"] = f"{seconds(times['compile'])} / {seconds(times['solve'])}"
    for label, text in rows.items():
        yield Row("Certificate", label, text)


# --- Tables ----------------------------------------------------------------------------------------------------------

# What a row is called in a table of whole designs; certificates and what is sampled beside them have their own.
_IN_TABLES = {
    **{"Status": "{}", "Decisions": "{}", "Objective": "{}", "Limits": "{}: worst value", "Active": "{}"},
    **{"Shadow prices": "{}: shadow price of the bound", "Evidence": "{}"},
}


def side_by_side(caption: str, columns: Mapping[str, Mapping[str, str]], note: str = "") -> Table:
    """Columns by their names, each with its cells by label; a dash where a column has none of a label.

    Labels that some columns lack stand where the others have them.
    """
    labels: list[str] = []
    for column in columns.values():
        place = 0
        for label in column:
            if label not in labels:
                labels.insert(place, label)
            place = labels.index(label) + 1
    rows = [[label, *(column.get(label, NOTHING) for column in columns.values())] for label in labels]
    return Table(caption, ["", *columns], rows, note)


def documents_table(caption: str, documents: Mapping[str, Mapping[str, object] | None], note: str = "") -> Table:
    """Documents of designs side by side; None where there is no design."""
    columns = {name: designed(rows_of(one)) if one else {} for name, one in documents.items()}
    return side_by_side(caption, columns, note)


def designed(rows: Iterable[Row]) -> dict[str, str]:
    """What a design is, what it achieves, and how often its limits break, in words by label."""
    return {_IN_TABLES[one.kind].format(one.label): one.text for one in rows if one.kind in _IN_TABLES}


def designs_table(
    solutions: Mapping[str, Solution],
    evidence: Mapping[str, Evidence],
    labels: Mapping[str, str] = MappingProxyType({}),
) -> Table:
    """The designs side by side: decisions, objective, constraints, active limits, and violations by Monte Carlo.

    `labels`: what rows are called, by what they are called otherwise, such as the name of a decision.
    """
    documents = {name: solution_document(one, evidence.get(name)) for name, one in solutions.items()}
    note = "Shadow price: the decrease of the objective per unit by which the bound is relaxed."
    table = documents_table("Decisions, limits and violations", documents, note)
    return replace(table, rows=[[labels.get(label, label), *cells] for label, *cells in table.rows])


def violations_table(evidence: Mapping[str, Evidence]) -> Table:
    """How many systems break each limit, a column for each design."""
    columns = {
        name: {row.label: row.text for row in evidence_rows(evidence_document(one))} for name, one in evidence.items()
    }
    return side_by_side("Systems that violate limits", columns, "In brackets: 95 % confidence.")


def certificate_table(solutions: Mapping[str, Solution]) -> Table:
    """The certificate of each design: residuals of the optimality conditions, what was checked, and the effort."""
    tolerances = sorted({f"{given(100 * one.certificate.expansion.tolerance)} %" for one in solutions.values()})
    note = (
        "Residuals are computed from the point and its multipliers, not taken from the solver. The leave-one-out error"
        " is the rms error of predicting each collocation point from all others, relative to the standard deviation:"
        f" up to {words(tolerances)} it counts as resolved."
    )
    columns = {
        name: {row.label: row.text for row in rows_of(solution_document(one)) if row.kind in ("Status", "Certificate")}
        for name, one in solutions.items()
    }
    return side_by_side("Certificate", columns, note)


def evidence_table(evidence: Mapping[str, Evidence]) -> Table:
    """Sampled statistics compared with the expansion's, and percentiles."""
    rows = []
    for name, one in evidence.items():
        units = units_of_moments(one.solution.problem)
        for text, sampled in one.functionals.items():
            if np.ndim(sampled.mean) or sampled.percentiles is None:
                continue
            numbers = sampled.mean, sampled.standard_error, sampled.expanded_mean, sampled.std, sampled.expanded_std
            mean, error, expanded, std, expanded_std = map(float, numbers)
            means = f"{number(mean, 5)} ± {number(error, 2)}", number(expanded, 5)
            percentiles = [number(sampled.percentiles[i], 4) for i in (1, 3, 5)]
            rows.append([_label(name, text, units[text]), *means, number(std), number(expanded_std), *percentiles])
    header = ["", "Mean, sampled", "Mean, expansion", "σ, sampled", "σ, expansion", "5 %", "Median", "95 %"]
    samples = words(sorted({count(one.samples) for one in evidence.values()}))
    note = (
        f"{samples} fresh random systems for each design, independent of the expansion; ± is one standard error of the"
        " mean."
    )
    return Table("Monte Carlo and the expansion compared", header, rows, note)


def statistics_table(evidence: Mapping[str, Evidence]) -> Table | None:
    """The other statistics in the problems, sampled and by the expansion; None if there are none."""
    rows = []
    for name, one in evidence.items():
        for text, checked in one.statistics.items():
            if not checked.statistic.is_moment:
                error = "" if np.isnan(checked.standard_error) else f" ± {number(checked.standard_error, 2)}"
                label = _label(name, text, unit_of(checked.statistic, one.solution.problem))
                rows.append([label, f"{number(checked.estimate, 5)}{error}", number(checked.expanded, 5)])
    note = "± is one standard error of the sampled number."
    return Table("Other statistics", ["", "Sampled", "Expansion"], rows, note) if rows else None


def _label(name: str, text: str, unit: str) -> str:
    """Of a row: the design and the functional, with its unit."""
    return f"{name}, {text}"[0 if name else 2 :] + (f" ({unit})" if unit else "")
