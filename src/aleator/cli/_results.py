"""Commands on studies and on what folders have: `aleator check` tells what a study will do, `validate` how often its
designs break their limits; `report` writes the page of a run without computing anything, `list` its results; `compare`
sets the designs of several runs side by side.
"""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from aleator import studies
from aleator._core.border import content_of, json_of, meant
from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._run import RECORD, Record, staleness
from aleator.cli._terminal import FAILED, Terminal
from aleator.design import Problem
from aleator.journalling import Journal, journal, load, recalling
from aleator.reporting import (
    PAGE,
    by_place,
    designs_document,
    documents_table,
    evidence_document,
    evidence_table,
    json_text,
    rows_of,
    solution_document,
    words,
    write_page,
)
from aleator.solution import Solution, in_brief
from aleator.solving import solve
from aleator.studies import AbstractStudy, Check, Draft, executor_of, problems_of
from aleator.validation import Evidence
from aleator.validation import validate as validated

_SO_FAR = "report-so-far.html"


def check(terminal: Terminal, study: str) -> int:
    """Print what a study will do."""
    checked = Check(studies.load(study))
    for problem in checked.mathematics():
        terminal.tell(f"{problem.heading}\n{problem.text}")
    for table in filter(None, [checked.numbers(), checked.table()]):
        terminal.table(table)
    for trouble in checked.troubles:
        terminal.tell(f"look at: {trouble}")
    terminal.note(study=study, problems=checked.document(), look_at=checked.troubles)
    return 0


def validate(terminal: Terminal, place: str, samples: int, seed: int, design: str | None, workers: int | None) -> int:
    """Count on fresh random systems how often the designs of a study or a folder break their limits.

    Designs are solved where needed, and sampled in order. The document of each says whether it is solved (`status`, and
    `why` there is no evidence if it is not), whether it was solved just now (`solved_anew`), and how often its limits
    break (`violations`).
    """
    folder, record = Path(place), Record(place)
    if not folder.is_dir():
        folder = record.folder
        record.check_owns(folder)
    elif (folder / RECORD).is_file():
        record = Record.of(folder)
    else:  # of a script
        record = None
    if is_stale := staleness(folder):
        raise ProblemError(f"validate: {is_stale}")
    study = None if record is None else record.made()
    evidence, documents = dict[str, Evidence](), dict[str, dict[str, Any]]()
    with executor_of(workers) as executor, journal(folder) as results:
        for name, one in _selected(study, results, design).items():
            begun = results.begun
            terminal.begin(f"evidence on {name}")
            try:
                solving = {} if study is None else study.solving
                solution = one if isinstance(one, Solution) else solve(one, **solving, throw=False)
                is_new = results.begun > begun
                if is_new:  # it has this name in the folder from now on
                    results.call({name: solution})
                origin = "solved, because the folder does not have it" if is_new else "taken from the folder"
                terminal.tell(f"design {name}: {origin}: {in_brief(solution)}.")
                known = solution_document(solution)
                documents[name] = {part: known[part] for part in ("status", "decisions", "objective")}
                documents[name]["solved_anew"] = is_new
                if not solution.ok:
                    raise ProblemError(solution.why())
                how: dict[str, Any] = {"seed": seed, "executor": executor, "progress": terminal.progress}
                evidence[name] = validated(solution, samples, **how)
                documents[name] |= evidence_document(evidence[name])
            except AleatorError as error:  # the others go on
                documents.setdefault(name, {})["why"] = f"{error}"
                terminal.complain(f"{error}", f"error with '{name}': ")
            terminal.end()
    terminal.note(folder=str(folder), samples=samples, seed=seed, designs=documents)
    if evidence:
        sampled = {name: solution_document(one.solution, one) for name, one in evidence.items()}
        terminal.table(documents_table("Designs", sampled))
        terminal.table(evidence_table(evidence))
    return 0 if len(evidence) == len(documents) else FAILED


def _selected(study: AbstractStudy | None, results: Journal, design: str | None) -> Mapping[str, Solution | Problem]:
    """Designs of a folder, and problems that are to be solved first, by name.

    Where a study names its designs (`designs/robust`), only these count, by the last part of their names.
    """
    solved = {name: one for name, one in results.finished().items() if isinstance(one, Solution) and one.ok}
    designs: dict[str, Solution | Problem] = {
        name.rpartition("/")[2]: one for name, one in solved.items() if "/" in name
    } or {name: one for name, one in solved.items() if study is None or not name.startswith("solve ")}
    if study is not None:
        designs = {**problems_of(study), **designs}
    if not designs:
        raise ProblemError(f"validate: there is no finished design in '{results.folder}' that can be read.")
    if design is None:
        return designs
    if design not in designs:
        known = f"expected one of {list(designs)}.{meant(design, designs)}"
        raise ProblemError(f"validate: there is no design '{design}' in '{results.folder}'; {known}")
    return {design: designs[design]}


def listed(terminal: Terminal, folder: Path) -> int:
    """List the results in a run's folder."""
    found, is_stale = load(folder).examined(), staleness(folder)
    names = {entry.key: name for name, entry in found.results.items()}
    terminal.tell(f"{found}")
    if is_stale:
        terminal.tell(f"look at: {is_stale}")
    told = ("name", "what", "state", "why", "file", "host", "process", "since")
    results = [
        {name: value for name, value in asdict(entry).items() if name in told}
        | {"load": names.get(entry.key), "seconds": entry.seconds or None}
        for entry in found.entries
    ]
    terminal.note(folder=str(folder), stale=bool(is_stale), results=results)
    return 0


def report(terminal: Terminal, folder: Path, out: Path | None) -> int:
    """Write the page of a study from what is in its run's folder, without computing anything; say what is missing.

    A complete page is not replaced by one from which something is missing.
    """
    missing = list(filter(None, [staleness(folder)]))
    terminal.note(folder=str(folder), files=[], missing=missing, verdict=None)
    draft = Draft(Record.of(folder).made())
    with recalling(folder) as results:
        try:
            draft.fill()
        except KeyboardInterrupt:  # what is not there ends the chapter
            absent = " ".join(dict.fromkeys(results.missing))
            missing.append(f"'{draft.present}' is not finished, nor what follows it: {absent}")
        except AleatorError as error:
            missing.append(f"'{draft.present}' failed: {error}")
    if not by_place(draft.kept):
        raise ProblemError(
            f"report: nothing is finished yet in '{folder}' of the study as it is now. {' '.join(missing)}"
        )
    page = draft.page()
    path = write_page(page, out or folder / (_SO_FAR if missing and (folder / PAGE).exists() else PAGE))
    for sentence in missing:
        terminal.tell(f"look at: {sentence}")
    if path.name == _SO_FAR:
        terminal.tell(f"{folder / PAGE} stays as it is, because the page of now is without what is missing.")
    terminal.tell(f"wrote {path}")
    terminal.note(files=[str(path)], verdict=page.verdict.headline)
    return 0


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
        terminal.table(documents_table(name, called))
        differences[name] = {other: _differing(row[first], row[other]) for other in others}
        for other, differing in differences[name].items():
            if differing is None:
                absent = [label for label in (first, other) if row[label] is None]
                terminal.tell(f"{name}: {words(absent)} {'names' if len(absent) == 1 else 'name'} no such design.")
            else:
                how = f"differ in {words(differing)}" if differing else "are equal"
                terminal.tell(f"{name}: {first} and {other} {how}.")
    terminal.note(folders=[*runs], designs=compared, differences=differences)
    return 0


def _documents(folder: Path) -> Mapping[str, Any]:
    """A run's designs as documents by name: as the run has written them, or as its journal has them."""
    path = folder / "designs.json"
    try:
        if path.exists():
            return json_of(content_of(path))
    except (OSError, ValueError) as error:
        raise ProblemError(f"'{path}' cannot be read as the designs of a run ({error}).") from error
    if (folder / RECORD).exists():
        Record.of(folder)  # so that its models' modules can be imported
    results = {name: one for name, one in load(folder).finished().items() if isinstance(one, Solution | Evidence)}
    designs = designs_document(results)
    named = {name: one for name, one in designs.items() if "/" in name}  # by a study
    return json_of(json_text(named or designs))


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
        {row.label: (row.value, row.unit) for row in rows_of(one) if row.value is not None}
        | {"constraints": one["constraints"], "the problem": one["problem"]}
        for one in (first, other)
    )
    labels = [label for label in {**whole, **another} if whole.get(label) != another.get(label)]
    # The digest is of decisions, objective and equations together.
    return labels or ["the equations of the model"] * (first["digest"] != other["digest"])
