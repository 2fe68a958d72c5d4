"""`aleator compare`: the designs of several runs side by side."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from aleator._core.errors import ProblemError
from aleator.cli._designs import designs_and_evidence, documents_table, rows_of, written_designs
from aleator.cli._folder import study_of
from aleator.cli._terminal import Terminal
from aleator.journalling import FILE, Recalled
from aleator.reporting import NOTHING, Table, json_text, solution_document, words


def compare(folders: list[Path], as_json: bool) -> NoReturn:
    """Print the designs of several runs side by side, and in what they differ."""
    terminal = Terminal("compare", as_json)
    with terminal.refusing():
        if len(folders) < 2:
            raise ProblemError("compare: expected two folders or more; received one.")
        runs = {label: _designs(folder) for label, folder in zip(_labels(folders), folders, strict=True)}
    rows: dict[tuple[str | None, ...], str] = {}  # the names of a design in all runs, and the first of these
    for name in (name for designs in runs.values() for name in designs):
        rows.setdefault(tuple(_name_in(designs, name, runs.values()) for designs in runs.values()), name)
    compared, differences = dict[str, Any](), dict[str, Any]()
    for names, name in rows.items():
        row = {label: runs[label].get(own or "") for label, own in zip(runs, names, strict=True)}
        terminal.table(_table(name, names, row))
        (reference, first), *others = row.items()
        compared[name] = row
        differences[name] = {label: first and other and _differing(first, other) for label, other in others}
        for label, differing in differences[name].items():
            terminal.tell(f"{name}: {_sentence(reference, label, differing, [one for one in row if not row[one]])}")
    terminal.note(folders=[str(folder) for folder in folders], designs=compared, differences=differences)
    terminal.conclude(0)


def _labels(folders: Sequence[Path]) -> list[str]:
    """The last parts of the folders' names where these differ, the whole names elsewhere."""
    short = [folder.resolve().name for folder in folders]
    return short if len(set(short)) == len(short) else [str(folder) for folder in folders]


def _designs(folder: Path) -> Mapping[str, Any]:
    """A run's designs as documents by name: as the run has written them, or as its journal has them."""
    if written := written_designs(folder):
        return written
    if not (folder / FILE).is_file():
        raise ProblemError(
            f"compare: there are no results in '{folder}': expected a folder in which `aleator run` or a script within "
            "`al.journal(folder)` has kept results."
        )
    study_of(folder)  # so that its models' modules are there, if they are
    designs, evidence = designs_and_evidence(Recalled(folder).finished())
    return json.loads(
        json_text({name: solution_document(design, evidence.get(name)) for name, design in designs.items()})
    )


def _name_in(designs: Mapping[str, Any], name: str, runs: Iterable[Mapping[str, Any]]) -> str | None:
    """What a run calls a design that some run calls `name`: the same, or else the name of the same problem."""
    if name in designs:
        return name
    problems = [run[name]["problem"] for run in runs if name in run]
    return next((own for own, design in designs.items() if design["problem"] in problems), None)


def _table(name: str, names: Sequence[str | None], designs: Mapping[str, Any]) -> Table:
    """One design in every run."""
    table = documents_table(name, designs)
    there = [["There as", *(own or NOTHING for own in names)]] if set(names) - {None, name} else []
    return replace(table, rows=[*there, *table.rows])


def _differing(first: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """What differs between two designs, down to the last digit."""
    whole, another = (
        {label: exact for label, _, exact in rows_of(one)}
        | {"constraints": one["constraints"], "the problem": one["problem"]}
        for one in (first, other)
    )
    labels = [label for label in {**whole, **another} if whole.get(label) != another.get(label)]
    # The digest is of decisions, objective and equations together.
    return labels or ["the equations of the model"] * (first["digest"] != other["digest"])


def _sentence(first: str, other: str, differing: list[str] | None, without: Sequence[str]) -> str:
    if differing is None:
        absent = [label for label in (first, other) if label in without]
        return f"{words(absent)} {'does' if len(absent) == 1 else 'do'} not have it."
    return f"{first} and {other} {f'differ in {words(differing)}' if differing else 'are equal'}."
