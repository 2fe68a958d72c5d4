"""Commands on what a folder has: `aleator report` writes its page, `aleator compare` sets several side by side.

Designs are objects of a journal, with the evidence on each, or documents of `designs.json`, which need no code of a
model.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from aleator._core.border import content_of, json_of
from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._folder import is_stale, stale, study_of
from aleator.cli._terminal import Terminal
from aleator.journalling import FILE, Recalled, recalling
from aleator.reporting import (
    NOTHING,
    PAGE,
    Code,
    Page,
    Section,
    Table,
    Text,
    Verdict,
    by_place,
    documents_table,
    json_text,
    proposal,
    rows_of,
    sections,
    solution_document,
    whole_page,
    words,
    write_page,
)
from aleator.solution import Solution
from aleator.studies import AbstractStudy, Draft
from aleator.validation import Evidence

_SO_FAR = "report-so-far.html"
_FOLLOWS_FROM = "what it follows from is missing."
_WITHOUT_THE_STUDY = (
    "So the study's title, chapters, fronts and tables are missing; the page shows the designs and the evidence that "
    "the folder keeps."
)
_WITHOUT_THE_MODEL = (
    "Without the model's code there are no figures and certificates: the page shows what designs.json says. Histories "
    "are in results.nc."
)


# --- Report ----------------------------------------------------------------------------------------------------------


def report(folder: Path, out: Path | None, as_json: bool) -> NoReturn:
    """Write the page of what is in a run's folder, without computing anything, and say what is missing.

    A complete page is not replaced by one from which something is missing.
    """
    terminal, missing = Terminal("report", as_json), list[str]()
    terminal.note(folder=str(folder), files=[], missing=missing, verdict=None)
    with terminal.refusing(), terminal.warning():
        with recalling(folder) as run:
            page = _page(folder, run, missing)
        path = write_page(page, out or folder / (_SO_FAR if missing and (folder / PAGE).exists() else PAGE))
    for sentence in missing:
        terminal.look_at(sentence)
    if path.name == _SO_FAR:
        terminal.look_at(f"{folder / PAGE} stays as it is, because the page of now is without what is missing.")
    terminal.tell(f"wrote {path}")
    terminal.note(files=[str(path)], verdict=page.verdict.headline)
    terminal.conclude(0)


def _page(folder: Path, run: Recalled, missing: list[str]) -> Page:
    """The page; what is missing from it is added, a sentence each."""
    study, why = study_of(folder)
    if why:
        missing.append(f"{why} {_WITHOUT_THE_STUDY}")
    elif is_stale(folder):
        missing.append(stale(folder))
    if study is not None:
        page = Draft(study)
        missing += _recalled(page, run)
        if by_place(page.kept):
            return page.page()
    return _page_of_designs(folder, run, study, missing)


def _recalled(page: Draft, run: Recalled) -> list[str]:
    """Let a study take its results from a folder; what is not there, a sentence."""
    try:
        page.fill()
    except KeyboardInterrupt:
        absent = " ".join(dict.fromkeys(run.missing)) or _FOLLOWS_FROM
        return [f"'{page.present}' is not finished, nor what follows it: {absent}"]
    except AleatorError as error:
        return [f"'{page.present}' failed: {error}"]
    finally:
        run.missing.clear()
    return []


def _page_of_designs(folder: Path, run: Recalled, study: AbstractStudy | None, missing: list[str]) -> Page:
    """A page of all designs and all evidence in a folder, whatever computed them; adds what is missing from it.

    Where no result can be read without the model's code, it shows the designs that the run has written down.
    """
    designs, evidence = designs_and_evidence(run.finished())
    missing += dict.fromkeys(run.missing)
    title = folder.resolve().name
    if designs:
        names, about = list(designs), proposal(designs, evidence)
        title = study.title if study is not None else title
        chapters = sections(designs, evidence, {})
    else:
        if not run.missing:
            raise ProblemError(f"report: nothing is finished yet in '{folder}': there is no design to show.")
        if not (written := written_designs(folder)):
            raise ProblemError(f"report: no design in '{folder}' can be read: {run.missing[0]}")
        missing.append(_WITHOUT_THE_MODEL)
        numbers = "The model's code cannot be read: these are the numbers of its run."
        names, about = list(written), Verdict("caution", "Numbers only", numbers)
        chapters = [
            Section(name, [documents_table(name, {"Value": one}), Code("The problem", "\n".join(one["problem"]))])
            for name, one in written.items()
        ]
    absent = [Section("Missing", [Text(missing)])] if missing else []
    return whole_page(title, f"Kept in {folder.resolve().name}: {words(names)}", about, [*chapters, *absent])


# --- Compare ---------------------------------------------------------------------------------------------------------


def compare(folders: list[Path], as_json: bool) -> NoReturn:
    """Print the designs of several runs side by side, and in what they differ."""
    terminal = Terminal("compare", as_json)
    with terminal.refusing():
        if len(folders) < 2 or len({folder.resolve() for folder in folders}) < len(folders):
            received = words([str(folder) for folder in folders])
            raise ProblemError(f"compare: expected two folders or more, each once; received {received}.")
        runs = {label: _documents(folder) for label, folder in zip(_labels(folders), folders, strict=True)}
    rows: dict[tuple[str | None, ...], str] = {}  # the names of a design in all runs, and the first of these
    for name in (name for designs in runs.values() for name in designs):
        rows.setdefault(tuple(_name_in(designs, name, runs.values()) for designs in runs.values()), name)
    compared, differences = dict[str, Any](), dict[str, Any]()
    for names, name in rows.items():
        row = {label: runs[label].get(own or "") for label, own in zip(runs, names, strict=True)}
        terminal.table(_beside(name, names, row))
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


def _documents(folder: Path) -> Mapping[str, Any]:
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


def _beside(name: str, names: Sequence[str | None], designs: Mapping[str, Any]) -> Table:
    """One design in every run."""
    table = documents_table(name, designs)
    there = [["There as", *(own or NOTHING for own in names)]] if set(names) - {None, name} else []
    return replace(table, rows=[*there, *table.rows])


def _differing(first: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """What differs between two designs, down to the last digit."""
    whole, another = (
        {row.label: row.exact for row in rows_of(one) if row.exact is not None}
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


# --- Designs ---------------------------------------------------------------------------------------------------------


_DESIGNS = "designs.json"


def designs_and_evidence(results: Mapping[str, Any]) -> tuple[dict[str, Solution], dict[str, Evidence]]:
    """The designs among results, and the last evidence on each of them, by the names of the designs.

    Where a study names its designs (`designs/robust`), only these count, by the last part of their names.
    """
    solutions = {name: result for name, result in results.items() if isinstance(result, Solution)}
    named = {name.rpartition("/")[2]: solution for name, solution in solutions.items() if "/" in name}
    designs = named or solutions
    evidence = [result for result in results.values() if isinstance(result, Evidence)]
    return designs, {name: last for name, design in designs.items() for last in evidence if _is_on(last, design)}


def _is_on(evidence: Evidence, design: Solution) -> bool:
    sampled = evidence.solution
    return (
        type(sampled.problem.system) is type(design.problem.system)
        and np.array_equal(sampled.vector, design.vector)
        and sampled.problem_text == design.problem_text
    )


def written_designs(folder: Path) -> Mapping[str, Any]:
    """The designs of a run as documents, by name; none if there is no file. Raises `ProblemError` for nonsense."""
    path = folder / _DESIGNS
    if not path.is_file():
        return {}
    try:
        designs = json_of(content_of(path))
        return {name: design for name, design in designs.items() if isinstance(design["decisions"], dict)}
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise ProblemError(
            f"'{path}' cannot be read as the designs of a run ({type(error).__name__}: {error})."
        ) from error
