"""Tables: designs side by side, certificates, what was sampled; and where numbers come from: digests, seeds,
times, versions and the machine, by which each can be traced to its run.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from aleator.reporting._datasets import leaves
from aleator.reporting._documents import (
    design_digest,
    digest,
    environment,
    evidence_document,
    evidence_rows,
    rows_of,
    solution_document,
)
from aleator.reporting._numbers import NOTHING, count, given, number, unit_of, units_of_moments, words
from aleator.reporting._page import Block, Section, Table
from aleator.solution import Solution
from aleator.sweep import Calibration, Front, TradeOff
from aleator.validation import Evidence

_SIGNED_BY = ("Prepared", "Checked", "Released")


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


def documents_table(caption: str, documents: Mapping[str, Mapping[str, Any] | None], note: str = "") -> Table:
    """Documents of designs side by side; None where there is no design."""
    columns = {name: designed(one) if one else {} for name, one in documents.items()}
    return side_by_side(caption, columns, note)


def designed(document: Mapping[str, Any]) -> dict[str, str]:
    """What a design is, what it achieves, and how often its limits break, in words by label."""
    return {row.label: row.text for row in rows_of(document) if row.label}


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
        name: {row.name: row.text for row in evidence_rows(evidence_document(one))} for name, one in evidence.items()
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
        name: {row.name: row.text for row in rows_of(solution_document(one)) if row.heading == "Certificate"}
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


# --- Where numbers come from -----------------------------------------------------------------------------------------


def provenance(results: Mapping[str, Any]) -> Section:
    """The section of a page on where its numbers come from, with lines to sign; empty without results."""
    rows = [row for names, one in leaves(results) for row in _rows(": ".join(names), one)]
    note = (
        "A design's digest changes with its equations, its decisions or its objective, and stands in designs.json as "
        "well. The same seed draws the same systems."
    )
    header = ["Result", "Digest of its design", "Computed by", "Seed", "Seconds"]
    blocks: list[Block] = [
        Table("Results", header, rows, note),
        Table("Program and machine", ["", ""], [[name, said] for name, said in environment().items()]),
        Table("Sign-off", ["", "Name", "Date", "Signature"], [[one, "", "", ""] for one in _SIGNED_BY]),
    ]
    return Section("Where this comes from", blocks if rows else [])


def _rows(name: str, one: Any) -> Iterator[list[str]]:
    if isinstance(one, Solution):
        yield [name, design_digest(one), one.effort.solver, NOTHING, _seconds(one)]
    elif isinstance(one, Evidence):
        sample = [f"{count(one.samples)} fresh systems", str(one.seed), number(one.seconds, 3)]
        yield [name, design_digest(one.solution), *sample]
    elif isinstance(one, Calibration):
        known = one.evidence
        fresh = [NOTHING] * 2 if known is None else [str(known.seed), number(known.seconds, 3)]
        yield [name, design_digest(one.solution), f"{count(len(one.trials))} trials", *fresh]
    elif isinstance(one, Front | TradeOff) and one.solutions:
        together = digest("".join(map(design_digest, one.solutions)).encode())
        solvers = ", ".join(dict.fromkeys(each.effort.solver for each in one.solutions))
        yield [name, together, f"{count(len(one.solutions))} designs: {solvers}", NOTHING, _seconds(*one.solutions)]


def _seconds(*solutions: Solution) -> str:
    """How long solves took, with their compilations."""
    return number(sum(one.effort.times.compile_ + one.effort.times.solve for one in solutions), 3)
