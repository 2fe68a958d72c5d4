"""Tables of designs, certificates and evidence, from result objects."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from aleator.nlp import Status
from aleator.reporting._blocks import Table
from aleator.reporting._numbers import (
    NOTHING,
    count,
    given,
    number,
    residual,
    seconds,
    share_text,
    unit_of_decision,
    unit_of_expression,
    unit_of_objective,
    unit_of_statistic,
    units_of_moments,
    values_text,
    words,
)
from aleator.solution import Certificate, ConstraintResult, Solution
from aleator.validation import Checked, Evidence

STATUS_WORDS = {
    Status.SOLVED: "solved",
    Status.INFEASIBLE: "infeasible",
    Status.ITERATION_LIMIT: "iteration limit",
    Status.EVALUATION_FAILED: "model failed",
    Status.INTERRUPTED: "interrupted",
    Status.FAILED: "not solved",
}


def status_words(solution: Solution) -> str:
    """How a solve ended, or what its certificate says against its answer."""
    return STATUS_WORDS[solution.status] if solution.objection is None else solution.objection.phrase


def _union(groups: Iterable[Iterable[str]]) -> list[str]:
    return list(dict.fromkeys(name for group in groups for name in group))


def designs_table(solutions: Mapping[str, Solution], evidence: Mapping[str, Evidence]) -> Table:
    """The designs side by side: decisions, objective, constraints, active limits, and violations by Monte Carlo."""
    every = list(solutions.values())
    rows: list[list[str]] = [["Status", *map(status_words, every)]]
    for name in _union(one.decisions for one in every):
        rows.append([name, *(_decision(one, name) for one in every)])
    rows.append(["Objective", *(objective_text(one) for one in every)])
    for name in _union((part.name for part in one.constraints) for one in every):
        rows.append([f"{name}: worst value", *(worst_text(one, name) for one in every)])
        rows.append([f"{name}: shadow price of the bound", *(_shadow_price(one, name) for one in every)])
    broken = [[part.name for part in one.violated] for one in every]
    held = [[name for name in one.active if name not in names] for one, names in zip(every, broken, strict=True)]
    rows.append(["Active", *(words(names, "nothing") for names in held)])
    if any(broken):
        rows.append(["Violated", *(words(names, "nothing") for names in broken)])
    rows += _violation_rows(list(solutions), evidence)
    return Table(
        "Decisions, limits and violations",
        ["", *solutions],
        rows,
        "Shadow price: the decrease of the objective per unit by which the bound is relaxed.",
    )


def _violation_rows(names: Sequence[str], evidence: Mapping[str, Evidence]) -> list[list[str]]:
    if not evidence:
        return []
    found = [evidence.get(name) for name in names]
    limits = _union(one.violations for one in found if one)
    rows = [
        [f"Systems that violate {limit}", *(share_text(one.violations.get(limit)) if one else "–" for one in found)]
        for limit in limits
    ]
    if not limits:
        return []
    return [*rows, ["Systems that violate any limit", *(share_text(one.joint) if one else "–" for one in found)]]


def _decision(solution: Solution, name: str) -> str:
    if name not in solution.decisions:
        return "–"
    text = values_text(solution.decisions[name], 5, unit_of_decision(name, solution.problem))
    return f"{text} (at its bound)" if solution.is_at_bound(name) else text


def decision_text(solution: Solution, name: str) -> str:
    """A decision with its unit, of an array from where to where it goes."""
    value, unit = np.asarray(solution.decisions[name], float), unit_of_decision(name, solution.problem)
    at = " (at its bound)" if solution.is_at_bound(name) else ""
    if value.ndim == 0:
        return number(float(value), 5, unit) + at
    return f"{value.size} numbers from {number(value.min(), 4)} to {number(value.max(), 4, unit)}{at}"


def objective_text(solution: Solution) -> str:
    return number(solution.objective, 5, unit_of_objective(solution.problem))


def _parts(solution: Solution, name: str) -> list[tuple[ConstraintResult, str]]:
    """The constraints of one name with their units."""
    pairs = zip(solution.constraints, solution.problem.constraints, strict=True)
    return [
        (one, unit_of_expression(declared.expression, solution.problem)) for one, declared in pairs if one.name == name
    ]


def worst_text(solution: Solution, name: str) -> str:
    """The value closest to or furthest beyond a bound, and that bound."""
    parts = _parts(solution, name)
    if not parts:
        return "–"
    one, unit = max(parts, key=lambda part: float(np.max(part[0].excess)))
    value = one.worst
    upper = one.lower == one.upper or value - one.upper >= one.lower - value
    relation, bound = ("=" if one.lower == one.upper else "≤", one.upper) if upper else ("≥", one.lower)
    when = "" if one.worst_time is None else f" at {number(one.worst_time, 4, 's')}"
    broken = ", violated" if one in solution.violated else ""
    return f"{number(value, 5)} {relation} {given(bound, unit)}{when}{broken}"


def limit_rows(solution: Solution) -> list[tuple[str, str]]:
    """The name of each limit, with its worst value, its bound, and the shadow price of this where it is active."""
    rows = []
    for name in dict.fromkeys(one.name for one in solution.constraints):
        price = solution.multiplier(name)
        rows.append((name, worst_text(solution, name) + (f", shadow price {number(price, 4)}" if price else "")))
    return rows


def _shadow_price(solution: Solution, name: str) -> str:
    return number(solution.multiplier(name), 4) if any(one.name == name for one in solution.constraints) else "–"


def violations_table(evidence: Mapping[str, Evidence]) -> Table:
    """How many systems break each limit, a column for each design."""
    rows = _violation_rows(list(evidence), evidence)
    return Table("Systems that violate limits", ["", *evidence], rows, "In brackets: 95 % confidence.")


def certificate_table(solutions: Mapping[str, Solution]) -> Table:
    """The certificate of each design: residuals of the optimality conditions, what was checked, and the effort."""
    every = list(solutions.values())
    certificates, efforts = [one.certificate for one in every], [one.effort for one in every]
    residuals = ("violation", "stationarity", "complementarity")
    said = [_checked(one) for one in certificates]
    errors = [one.expansion.leave_one_out if one.expansion.points > 1 else {} for one in certificates]
    rows = [
        ["Status", *map(status_words, every)],
        ["Solver", *(one.solver for one in efforts)],
        ["States", *map(_found, every)],
        *(
            [f"{name.capitalize()} (scaled)", *(residual(getattr(one, name)) for one in certificates)]
            for name in residuals
        ),
        *([label, *(one.get(label, NOTHING) for one in said)] for label in _union(said)),
        *(
            [f"Leave-one-out error, {text}", *(residual(one[text]) if text in one else NOTHING for one in errors)]
            for text in _union(errors)
        ),
        ["Iterations / evaluations", *(f"{one.iterations} / {one.evaluations}" for one in efforts)],
        ["Search", *(str(one.searched or NOTHING) for one in efforts)],
        [
            "Time to compile / to solve",
            *(f"{seconds(one.times.compile_)} / {seconds(one.times.solve)}" for one in efforts),
        ],
    ]
    shown = [row for row in rows if any(text not in (NOTHING, "integrated") for text in row[1:])]
    tolerances = words(sorted({f"{given(100 * one.expansion.tolerance)} %" for one in certificates}))
    note = (
        "Residuals are computed from the point and its multipliers, not taken from the solver. The leave-one-out error"
        " is the rms error of predicting each collocation point from all others, relative to the standard deviation:"
        f" up to {tolerances} it counts as resolved."
    )
    return Table("Certificate", ["", *solutions], shown, note)


# Where the label of the printed certificate is short for want of room.
_LABELS = {"between": "limits between the instants", "grid": "error of the grid", "fresh": "fresh systems"}


def _checked(certificate: Certificate) -> dict[str, str]:
    """What else was checked, as in the printed certificate."""
    said: dict[str, str] = {}
    for label, text in certificate.rows():
        if label != "certificate":  # residuals, which have rows of their own
            name = _LABELS.get(label, label).capitalize()
            said[name] = f"{said[name]}; {text}" if name in said else text
    return said


def _found(solution: Solution) -> str:
    """How the states of a design were found."""
    if solution.mesh is None:
        return "integrated"
    return f"variables, {solution.mesh.intervals} intervals of {solution.mesh.scheme}"


def evidence_table(evidence: Mapping[str, Evidence]) -> Table:
    """Sampled statistics compared with the expansion's, and percentiles."""
    rows = []
    for name, one in evidence.items():
        units = units_of_moments(one.solution.problem)
        for text, sampled in one.functionals.items():
            if np.ndim(sampled.mean) or sampled.percentiles is None:
                continue
            p5, p50, p95 = (sampled.percentiles[i] for i in (1, 3, 5))
            rows.append(
                [
                    (f"{name}, {text}" if name else text) + (f" ({units[text]})" if units.get(text) else ""),
                    f"{number(float(sampled.mean), 5)} ± {number(float(sampled.standard_error), 2)}",
                    number(float(sampled.expanded_mean), 5),
                    number(float(sampled.std), 4),
                    number(float(sampled.expanded_std), 4),
                    number(p5, 4),
                    number(p50, 4),
                    number(p95, 4),
                ]
            )
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
            if checked.statistic.is_moment:
                continue
            unit = unit_of_statistic(checked.statistic, one.solution.problem)
            rows.append(
                [
                    f"{name}, {text}" + (f" ({unit})" if unit else ""),
                    _estimated(checked),
                    number(checked.expanded, 5),
                ]
            )
    note = "± is one standard error of the sampled number."
    return Table("Other statistics", ["", "Sampled", "Expansion"], rows, note) if rows else None


def _estimated(one: Checked) -> str:
    error = "" if np.isnan(one.standard_error) else f" ± {number(one.standard_error, 2)}"
    return f"{number(one.estimate, 5)}{error}"


def unresolved(solutions: Mapping[str, Solution]) -> dict[str, tuple[str, float]]:
    """The designs whose expansion misses too much of a functional's variance, with the functional and the error."""
    found = {}
    for name, one in solutions.items():
        quality = one.certificate.expansion
        if quality.points > 1 and quality.unresolved:
            worst = max(quality.unresolved, key=lambda text: quality.leave_one_out[text])
            found[name] = (f"{worst}{quality.since(worst)}", quality.leave_one_out[worst])
    return found
