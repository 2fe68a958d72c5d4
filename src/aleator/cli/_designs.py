"""Commands on designs that a folder has: `aleator report` writes its page, `aleator compare` sets several side by side.

Designs are objects of a journal, with the evidence on each, or documents of `designs.json`, which need no code of a
model.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from aleator._core.border import content_of, json_of
from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._folder import staleness, study_of
from aleator.cli._terminal import Terminal
from aleator.journalling import Journal, recalling
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
    json_text,
    percent,
    proposal,
    sections,
    side_by_side,
    solution_document,
    values_text,
    whole_page,
    words,
    write_page,
)
from aleator.solution import Solution
from aleator.studies import Draft
from aleator.validation import Evidence

_SO_FAR = "report-so-far.html"
_NUMBERS_ONLY = (
    "Without the model's code there are no figures and certificates: the page shows what designs.json says. Histories "
    "are in results.nc."
)


def report(terminal: Terminal, folder: Path, out: Path | None) -> int:
    """Write the page of what is in a run's folder, without computing anything, and say what is missing.

    A complete page is not replaced by one from which something is missing.
    """
    missing = list[str]()
    terminal.note(folder=str(folder), files=[], missing=missing, verdict=None)
    with recalling(folder) as results:
        page = _page(folder, results, missing)
    path = write_page(page, out or folder / (_SO_FAR if missing and (folder / PAGE).exists() else PAGE))
    for sentence in missing:
        terminal.look_at(sentence)
    if path.name == _SO_FAR:
        terminal.look_at(f"{folder / PAGE} stays as it is, because the page of now is without what is missing.")
    terminal.tell(f"wrote {path}")
    terminal.note(files=[str(path)], verdict=page.verdict.headline)
    return 0


def _page(folder: Path, results: Journal, missing: list[str]) -> Page:
    """The page of a study that takes its results from a folder; what is missing from it is added, a sentence each.

    Where there is no study, or nothing on its page, it is one of all designs and all evidence; where no result can be
    read without the model's code, of the designs that the run has written down.
    """
    study, why = study_of(folder)
    missing += filter(None, [why or staleness(folder)])
    if study is not None:
        page = Draft(study)
        try:
            page.fill()
        except KeyboardInterrupt:  # what is not there ends the chapter
            absent = " ".join(dict.fromkeys(results.missing))
            missing.append(f"'{page.present}' is not finished, nor what follows it: {absent}")
        except AleatorError as error:
            missing.append(f"'{page.present}' failed: {error}")
        results.missing.clear()
        if by_place(page.kept):
            return page.page()
    designs, evidence = designs_and_evidence(results.finished())
    missing += dict.fromkeys(results.missing)
    if designs:
        about, chapters = proposal(designs, evidence), sections(designs, evidence, {})
    else:
        written = _written(folder)
        if not written:
            raise ProblemError(f"report: nothing is finished yet in '{folder}' that can be shown. {' '.join(missing)}")
        missing.append(_NUMBERS_ONLY)
        about = Verdict("caution", "Numbers only", _NUMBERS_ONLY)
        chapters = [
            Section(name, [designs_table(name, {"Value": one}), Code("The problem", "\n".join(one["problem"]))])
            for name, one in written.items()
        ]
    title = folder.resolve().name if study is None else study.title
    absent = [Section("Missing", [Text(missing)])] if missing else []
    return whole_page(title, f"Kept in {folder.resolve().name}", about, [*chapters, *absent])


def compare(terminal: Terminal, folders: list[Path]) -> int:
    """Print the designs of several runs side by side, and in what they differ."""
    if len(folders) < 2 or len({folder.resolve() for folder in folders}) < len(folders):
        received = words([str(folder) for folder in folders])
        raise ProblemError(f"compare: expected two folders or more, each once; received {received}.")
    first, *others = runs = {str(folder): _documents(folder) for folder in folders}
    rows: dict[tuple[str | None, ...], str] = {}  # the names of a design in all runs, and the first of these
    for name in (name for designs in runs.values() for name in designs):
        rows.setdefault(tuple(_name_in(designs, name, runs) for designs in runs.values()), name)
    compared, differences = dict[str, Any](), dict[str, dict[str, list[str] | None]]()
    for names, name in rows.items():
        own = dict(zip(runs, names, strict=True))
        row = compared[name] = {label: runs[label].get(own[label] or "") for label in runs}
        called = {f"{label}: {own[label]}" if own[label] not in (None, name) else label: row[label] for label in runs}
        terminal.table(designs_table(name, called))
        differences[name] = {other: _differing(row[first], row[other]) for other in others}
        for other, differing in differences[name].items():
            if differing is None:
                absent = [label for label in (first, other) if row[label] is None]
                terminal.tell(f"{name}: {words(absent)} {'does' if len(absent) == 1 else 'do'} not have it.")
            else:
                how = f"differ in {words(differing)}" if differing else "are equal"
                terminal.tell(f"{name}: {first} and {other} {how}.")
    terminal.note(folders=[*runs], designs=compared, differences=differences)
    return 0


def _documents(folder: Path) -> Mapping[str, Any]:
    """A run's designs as documents by name: as the run has written them, or as its journal has them."""
    if written := _written(folder):
        return written
    study_of(folder)  # so that its models' modules are there, if they are
    with recalling(folder) as results:
        designs, evidence = designs_and_evidence(results.finished())
    return json.loads(
        json_text({name: solution_document(design, evidence.get(name)) for name, design in designs.items()})
    )


def _name_in(designs: Mapping[str, Any], name: str, runs: Mapping[str, Mapping[str, Any]]) -> str | None:
    """What a run calls a design that some run calls `name`: the same, or else the name of the same problem."""
    if name in designs:
        return name
    problems = [run[name]["problem"] for run in runs.values() if name in run]
    return next((own for own, design in designs.items() if design["problem"] in problems), None)


def _differing(first: Mapping[str, Any] | None, other: Mapping[str, Any] | None) -> list[str] | None:
    """What differs between two designs, down to the last digit; None if one is missing."""
    if first is None or other is None:
        return None
    whole, another = (
        {label: exact for label, _, exact in _rows_of(one)}
        | {"constraints": one["constraints"], "the problem": one["problem"]}
        for one in (first, other)
    )
    labels = [label for label in {**whole, **another} if whole.get(label) != another.get(label)]
    # The digest is of decisions, objective and equations together.
    return labels or ["the equations of the model"] * (first["digest"] != other["digest"])


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


def _written(folder: Path) -> Mapping[str, Any]:
    """The designs of a run as documents, by name; none if there is no file. Raises `ProblemError` for nonsense."""
    path = folder / "designs.json"
    if not path.is_file():
        return {}
    try:
        designs = json_of(content_of(path))
        return {name: design for name, design in designs.items() if isinstance(design["decisions"], dict)}
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise ProblemError(
            f"'{path}' cannot be read as the designs of a run ({type(error).__name__}: {error})."
        ) from error


def designs_table(caption: str, designs: Mapping[str, Mapping[str, Any] | None]) -> Table:
    """Documents of designs side by side; None where there is no design."""
    columns = {name: {label: text for label, text, _ in _rows_of(one)} if one else {} for name, one in designs.items()}
    return side_by_side(caption, columns)


def _rows_of(design: Mapping[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Status, decisions, objective, and how often limits break: the label of each, as text and exactly."""
    yield "Status", design["status"].partition(":")[0], design["status"]
    for name, number in [*design["decisions"].items(), ("Objective", design["objective"])]:
        value, unit = number["value"], number["unit"]
        yield name, NOTHING if value is None else values_text(value, 6, unit), (value, unit)
    for limit, share in design.get("evidence", {}).get("violations", {}).items():
        text = f"{percent(share['estimate'])} [{percent(share['lower'])} to {percent(share['upper'])}]"
        yield f"Systems that violate {'any limit' if limit == 'any' else limit}", text, share
