"""Tables of designs, certificates and evidence, from result objects."""

from collections.abc import Iterator, Mapping

import numpy as np

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
from aleator.reporting._page import Table
from aleator.solution import Solution
from aleator.sweep import Refused
from aleator.validation import Evidence

# Numbers of an array that are listed at most.
_LISTED = 6


def status_words(point: Solution | Refused) -> str:
    """How a solve ended, or what its certificate says against its answer."""
    objection = point.objection if isinstance(point, Solution) else None
    return point.status.value.partition(":")[0] if objection is None else objection.phrase


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


def designs_table(solutions: Mapping[str, Solution], evidence: Mapping[str, Evidence]) -> Table:
    """The designs side by side: decisions, objective, constraints, active limits, and violations by Monte Carlo."""
    columns = {name: dict(design_rows(one)) | violations(evidence.get(name)) for name, one in solutions.items()}
    note = "Shadow price: the decrease of the objective per unit by which the bound is relaxed."
    return side_by_side("Decisions, limits and violations", columns, note)


def design_rows(solution: Solution) -> Iterator[tuple[str, str]]:
    """What a design is, and what it achieves."""
    yield "Status", status_words(solution)
    yield from ((name, decision_text(solution, name)) for name in solution.decisions)
    yield "Objective", objective_text(solution)
    for name in dict.fromkeys(part.name for part in solution.constraints):
        yield f"{name}: worst value", worst_text(solution, name)
        yield f"{name}: shadow price of the bound", number(solution.multiplier(name), 4)
    broken = [part.name for part in solution.violated]
    yield "Active", words([name for name in solution.active if name not in broken], "nothing")
    if broken:
        yield "Violated", words(broken)


def violations(evidence: Evidence | None) -> dict[str, str]:
    """How often fresh systems break each limit; nothing where no limit is counted."""
    if evidence is None or not evidence.violations:
        return {}
    shares = {**evidence.violations, "any limit": evidence.joint}
    return {f"Systems that violate {limit}": share_text(one) for limit, one in shares.items()}


def violations_table(evidence: Mapping[str, Evidence]) -> Table:
    """How many systems break each limit, a column for each design."""
    columns = {name: violations(one) for name, one in evidence.items()}
    return side_by_side("Systems that violate limits", columns, "In brackets: 95 % confidence.")


def decision_text(solution: Solution, name: str) -> str:
    """A decision with its unit, of a long array from where to where it goes."""
    value, unit = np.asarray(solution.decisions[name], float), unit_of_decision(name, solution.problem)
    text = values_text(value, 5, unit)
    if value.size > _LISTED:
        text = f"{value.size} numbers from {number(value.min(), 4)} to {number(value.max(), 4, unit)}"
    return f"{text} (at its bound)" if solution.is_at_bound(name) else text


def objective_text(solution: Solution) -> str:
    return number(solution.objective, 5, unit_of_objective(solution.problem))


def worst_text(solution: Solution, name: str) -> str:
    """The value closest to or furthest beyond a bound, and that bound."""
    pairs = zip(solution.constraints, solution.problem.constraints, strict=True)
    parts = [(one, declared) for one, declared in pairs if one.name == name]
    one, declared = max(parts, key=lambda part: float(np.max(part[0].excess)))
    value, unit = one.worst, unit_of_expression(declared.expression, solution.problem)
    upper = one.lower == one.upper or value - one.upper >= one.lower - value
    relation, bound = ("=" if one.lower == one.upper else "≤", one.upper) if upper else ("≥", one.lower)
    when = "" if one.worst_time is None else f" at {number(one.worst_time, 4, 's')}"
    broken = ", violated" if one in solution.violated else ""
    return f"{number(value, 5)} {relation} {given(bound, unit)}{when}{broken}"


def certificate_table(solutions: Mapping[str, Solution]) -> Table:
    """The certificate of each design: residuals of the optimality conditions, what was checked, and the effort."""
    tolerances = sorted({f"{given(100 * one.certificate.expansion.tolerance)} %" for one in solutions.values()})
    note = (
        "Residuals are computed from the point and its multipliers, not taken from the solver. The leave-one-out error"
        " is the rms error of predicting each collocation point from all others, relative to the standard deviation:"
        f" up to {words(tolerances)} it counts as resolved."
    )
    return side_by_side("Certificate", {name: dict(certificate_rows(one)) for name, one in solutions.items()}, note)


# Where the label of the printed certificate is short for want of room.
_LABELS = {"between": "limits between the instants", "grid": "error of the grid", "fresh": "fresh systems"}


def certificate_rows(solution: Solution) -> Iterator[tuple[str, str]]:
    """How far a design can be trusted, and what it took."""
    certificate, effort = solution.certificate, solution.effort
    yield "Status", status_words(solution)
    yield "Solver", effort.solver
    if solution.mesh is not None:
        yield "States", f"variables, {solution.mesh.intervals} intervals of {solution.mesh.scheme}"
    for name in ("violation", "stationarity", "complementarity"):
        yield f"{name.capitalize()} (scaled)", residual(getattr(certificate, name))
    said: dict[str, list[str]] = {}
    for label, text in certificate.rows():
        said.setdefault(label, []).append(text)
    del said["certificate"]  # the residuals
    yield from ((_LABELS.get(label, label).capitalize(), "; ".join(texts)) for label, texts in said.items())
    if certificate.expansion.points > 1:
        for text, error in certificate.expansion.leave_one_out.items():
            yield f"Leave-one-out error, {text}", residual(error)
    yield "Iterations / evaluations", f"{effort.iterations} / {effort.evaluations}"
    if effort.searched is not None:
        yield "Search", str(effort.searched)
    yield "Time to compile / to solve", f"{seconds(effort.times.compile_)} / {seconds(effort.times.solve)}"


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
            label = _with_unit(f"{name}, {text}" if name else text, units.get(text, ""))
            rows.append([label, *means, number(std, 4), number(expanded_std, 4), *percentiles])
    header = ["", "Mean, sampled", "Mean, expansion", "σ, sampled", "σ, expansion", "5 %", "Median", "95 %"]
    samples = words(sorted({count(one.samples) for one in evidence.values()}))
    note = (
        f"{samples} fresh random systems for each design, independent of the expansion; ± is one standard error of the"
        " mean."
    )
    return Table("Monte Carlo and the expansion compared", header, rows, note)


def _with_unit(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit else name


def statistics_table(evidence: Mapping[str, Evidence]) -> Table | None:
    """The other statistics in the problems, sampled and by the expansion; None if there are none."""
    rows = []
    for name, one in evidence.items():
        for text, checked in one.statistics.items():
            if not checked.statistic.is_moment:
                unit = unit_of_statistic(checked.statistic, one.solution.problem)
                error = "" if np.isnan(checked.standard_error) else f" ± {number(checked.standard_error, 2)}"
                estimate = f"{number(checked.estimate, 5)}{error}"
                rows.append([_with_unit(f"{name}, {text}", unit), estimate, number(checked.expanded, 5)])
    note = "± is one standard error of the sampled number."
    return Table("Other statistics", ["", "Sampled", "Expansion"], rows, note) if rows else None


def unresolved(solutions: Mapping[str, Solution]) -> dict[str, tuple[str, float]]:
    """The designs whose expansion misses too much of a functional's variance, with the functional and the error."""
    found = {}
    for name, one in solutions.items():
        quality = one.certificate.expansion
        if quality.points > 1 and quality.unresolved:
            worst = max(quality.unresolved, key=lambda text: quality.leave_one_out[text])
            found[name] = (f"{worst}{quality.since(worst)}", quality.leave_one_out[worst])
    return found
