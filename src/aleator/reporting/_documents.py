"""A design as one document: what `designs.json` has of it, and what all else reads: row by row, for pages, tables and
notebooks; number by number, for datasets.
"""

import hashlib
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from aleator.design import statistics_in
from aleator.reporting._numbers import (
    count,
    given,
    number,
    residual,
    seconds,
    share_text,
    unit_of,
    unit_of_decision,
    values_text,
    words,
)
from aleator.solution import Solution
from aleator.sweep import Refused
from aleator.validation import Evidence

_LIBRARIES = ("jax", "jaxlib", "equinox", "numpy", "scipy", "casadi", "unopy")
RESIDUALS = "violation", "stationarity", "complementarity"
"""How far the optimality conditions are from being met."""

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


def environment() -> dict[str, str]:
    """The versions and the machine of this process, in words."""
    import aleator

    found = (one for name in _LIBRARIES for one in metadata.distributions(name=name))
    return {
        "aleator": aleator.__version__,
        "Python": f"{platform.python_version()} ({platform.python_implementation()})",
        "Libraries": ", ".join(dict.fromkeys(f"{one.name} {one.version}" for one in found)),
        "Machine": f"{platform.node()}: {platform.system()} {platform.release()}, {platform.machine()}",
        "Processor cores": count(os.cpu_count() or 1),
    }


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
            **_named(certificate, *RESIDUALS),
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


def evidence_on(solution: Solution | Refused, known: Sequence[Evidence]) -> Evidence | None:
    """The evidence on this very design: on its decisions, in a problem with the same text; None if there is none."""
    if isinstance(solution, Refused):
        return None
    for one in known:
        same = np.array_equal(one.solution.vector, solution.vector)
        if one.solution is solution or (same and one.solution.problem_text == solution.problem_text):
            return one
    return None


def _named(one: Any, *names: str) -> dict[str, Any]:
    """Attributes by their names."""
    return {name: getattr(one, name) for name in names}


# --- Rows ------------------------------------------------------------------------------------------------------------


HEADINGS = "Decisions", "Objective", "Limits", "Shadow prices", "Statistics", "Evidence", "Certificate"


class Row(NamedTuple):
    """One thing that is known of a design: under which heading, what it is called there, and what it is in words.

    - `label`: what it is called in a table of whole designs, which has no headings; empty where it is too much for it;
    - `value`: all digits, by which designs are compared, with their `unit`; None for what follows from other rows.
    """

    heading: str
    name: str
    text: str
    label: str = ""
    value: Any = None
    unit: str = ""


def rows_of(document: Mapping[str, Any]) -> Iterator[Row]:
    """All that a document says of a design, also one that was read from `designs.json`."""
    yield Row("Certificate", "Status", document["verdict"], "Status", document["status"])
    for name, one in document["decisions"].items():
        yield Row("Decisions", name, _decision(one), name, one["value"], one["unit"])
    objective, limits = document["objective"], dict[str, list[Any]]()
    text = number(objective["value"], 5, objective["unit"])
    yield Row("Objective", objective["expression"], text, "Objective", objective["value"], objective["unit"])
    for one in document["constraints"]:
        limits.setdefault(one["name"], []).append(one)
    for name, parts in limits.items():
        yield Row("Limits", name, _worst(parts), f"{name}: worst value")
    broken = list(dict.fromkeys(one["name"] for one in document["constraints"] if not one["holds"]))
    active = words([name for name in document["active"] if name not in broken], "nothing")
    yield Row("Limits", "Active", active, "Active")
    if broken:
        yield Row("Limits", "Violated", words(broken), "Violated")
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

    def excesses(one: Mapping[str, Any]) -> list[float]:
        """How far it is above its upper bound and below its lower one: JSON has no infinite bounds."""
        value, lower, upper = (np.nan if one[key] is None else one[key] for key in ("worst_value", "lower", "upper"))
        return [-np.inf if np.isnan(excess) else excess for excess in (value - upper, lower - value)]

    one, (above, below) = max(((one, excesses(one)) for one in parts), key=lambda each: max(each[1]))
    relation, bound = ("≤", one["upper"]) if above >= below else ("≥", one["lower"])
    relation = "=" if one["lower"] == one["upper"] else relation
    when = "" if one["worst_time_s"] is None else f" at {number(one['worst_time_s'], 4, 's')}"
    text = f"{number(one['worst_value'], 5)} {relation} {given(bound, one['unit'])}{when}"
    return text if one["holds"] else f"{text}, violated"


def _prices(document: Mapping[str, Any], limits: Mapping[str, Sequence[Any]]) -> Iterator[Row]:
    """The shadow price of each limit, and those of the bounds of decisions where these lie at one."""
    each = {name: float(sum(one["shadow_price"] for one in parts)) for name, parts in limits.items()}
    prices = [(name, price, limits[name][0]["unit"]) for name, price in each.items()]
    for name, one in document["decisions"].items():
        if one["at_bound"] and np.any(one["multiplier"]):
            prices.append((f"bound of {name}", float(np.sum(np.abs(one["multiplier"]))), one["unit"]))
    unit = document["objective"]["unit"]
    for name, price, by in prices:
        text = number(price, 4, f"{unit} per {by}".strip() if by else unit)
        yield Row("Shadow prices", name, text, f"{name}: shadow price of the bound")


def evidence_rows(evidence: Mapping[str, Any]) -> Iterator[Row]:
    """How often fresh systems break each limit, and whether they agree with the expansion."""
    yield Row("Evidence", "Fresh systems", count(evidence["samples"]), "Fresh systems")
    for limit, share in evidence["violations"].items():
        label = f"Systems that violate {'any limit' if limit == 'any' else limit}"
        yield Row("Evidence", label, share_text(SimpleNamespace(**share)), label, share)  # type: ignore[arg-type]
    agree = "Agree with the expansion"
    yield Row("Evidence", agree, "yes" if evidence["agrees"] else "no", agree)


def _certificate(document: Mapping[str, Any]) -> Iterator[Row]:
    """How far a design can be trusted, and what it took."""
    certificate, expansion, times = document["certificate"], document["expansion"], document["seconds"]
    # What is said under the label of the certificate itself are the residuals.
    said: dict[str, str] = {label: text for label, text in certificate["said"].items() if label != "certificate"}
    errors = expansion["leave_one_out"] if expansion["points"] > 1 else {}
    rows: dict[str, str] = {
        "Solver": certificate["solver"],
        "States": document["meshes"] and f"variables, {document['meshes'][-1]}",
        **{f"{name.capitalize()} (scaled)": residual(certificate[name]) for name in RESIDUALS},
        **{_LABELS.get(label, label).capitalize(): text for label, text in said.items()},
        **{f"Leave-one-out error, {text}": residual(one) for text, one in errors.items()},
        "Iterations / evaluations": f"{certificate['iterations']} / {certificate['evaluations']}",
        "Search": certificate["search"],
        "Time to compile / to solve": f"{seconds(times['compile'])} / {seconds(times['solve'])}",
    }
    yield from (Row("Certificate", label, text) for label, text in rows.items() if text)
