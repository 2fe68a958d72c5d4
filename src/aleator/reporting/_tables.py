"""Tables of designs, certificates and evidence."""

from collections.abc import Iterable, Mapping

import numpy as np

from aleator.reporting._documents import Row, evidence_document, evidence_rows, rows_of, solution_document
from aleator.reporting._numbers import (
    NOTHING,
    count,
    given,
    number,
    unit_of,
    units_of_moments,
    words,
)
from aleator.reporting._page import Table
from aleator.solution import Solution
from aleator.validation import Evidence

# What a row is called in a table of whole designs; certificates and what is sampled beside them have their own.
_LABELS = {
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
    return {_LABELS[one.kind].format(one.label): one.text for one in rows if one.kind in _LABELS}


def designs_table(solutions: Mapping[str, Solution], evidence: Mapping[str, Evidence]) -> Table:
    """The designs side by side: decisions, objective, constraints, active limits, and violations by Monte Carlo."""
    documents = {name: solution_document(one, evidence.get(name)) for name, one in solutions.items()}
    note = "Shadow price: the decrease of the objective per unit by which the bound is relaxed."
    return documents_table("Decisions, limits and violations", documents, note)


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
