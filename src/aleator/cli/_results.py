"""`aleator check`, `list` and `validate`: what a study will do, what a folder has, and how often its limits break."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from aleator import studies
from aleator._core.border import meant
from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._designs import designs_and_evidence, designs_table
from aleator.cli._folder import Record, staleness, study_of
from aleator.cli._terminal import FAILED, Progress, Terminal
from aleator.design import Problem
from aleator.journalling import Journal, examined, journal, listing, numbered
from aleator.reporting import evidence_document, evidence_table, solution_document
from aleator.solution import Solution, in_brief
from aleator.solving import solve
from aleator.studies import AbstractStudy, Check, executor_of, problems_of
from aleator.validation import Evidence
from aleator.validation import validate as validated


def check(terminal: Terminal, study: str) -> int:
    """Print what a study will do."""
    checked = Check(studies.load(study))
    for problem in checked.mathematics():
        terminal.title(problem.heading)
        terminal.tell(problem.text)
    for table in filter(None, [checked.numbers(), checked.table()]):
        terminal.table(table)
    for trouble in checked.troubles:
        terminal.look_at(trouble)
    terminal.note(study=study, problems=checked.document(), look_at=checked.troubles)
    return 0


def listed(terminal: Terminal, folder: Path) -> int:
    """List the results in a run's folder."""
    entries, is_stale = examined(folder), staleness(folder)
    names = {entry.key: name for name, entry in numbered(entries).items()}
    terminal.tell(listing(folder, entries))
    if is_stale:
        terminal.look_at(is_stale)
    told = ("name", "what", "why", "file", "host", "process", "since")
    results = [
        {name: value for name, value in asdict(entry).items() if name in told}
        | {"load": names.get(entry.key), "state": entry.state.value, "seconds": entry.seconds or None}
        for entry in entries
    ]
    terminal.note(folder=str(folder), stale=bool(is_stale), results=results)
    return 0


def validate(terminal: Terminal, place: str, samples: int, seed: int, design: str | None, workers: int | None) -> int:
    """Count on fresh random systems how often the designs of a study or a folder break their limits.

    Designs are solved where needed, and sampled in order. The document of each says whether it is solved (`status`, and
    `why` there is no evidence if it is not), whether it was solved just now (`solved_anew`), and how often its limits
    break (`violations`).
    """
    folder, record = Path(place), Record(place)
    if folder.is_dir():
        study, why = study_of(folder)
    else:
        study, folder, why = record.made(), record.folder, ""
        record.check_owns(folder)
    if is_stale := staleness(folder):
        raise ProblemError(f"validate: {is_stale}")
    evidence, documents = dict[str, Evidence](), dict[str, dict[str, Any]]()
    with executor_of(workers) as executor, journal(folder) as results, Progress(terminal.console) as progress:
        for name, one in _selected(study, why, results, design).items():
            step, begun = f"evidence on {name}", results.begun
            progress.begin(step)
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
                how: dict[str, Any] = {"seed": seed, "executor": executor, "progress": progress.show}
                evidence[name] = validated(solution, samples, **how)
                documents[name] |= evidence_document(evidence[name])
            except AleatorError as error:  # the others go on
                documents.setdefault(name, {})["why"] = f"{error}"
                terminal.complain(error, f"error with '{name}'")
            progress.end(step)
    terminal.note(folder=str(folder), samples=samples, seed=seed, designs=documents)
    if evidence:
        sampled = {name: solution_document(one.solution, one) for name, one in evidence.items()}
        terminal.table(designs_table("Designs", sampled))
        terminal.table(evidence_table(evidence))
    return 0 if len(evidence) == len(documents) else FAILED


def _selected(
    study: AbstractStudy | None, why: str, results: Journal, design: str | None
) -> Mapping[str, Solution | Problem]:
    """Designs of a folder, and problems that are to be solved first, by name."""
    # A solution without a name in the folder of a study is no design of its run.
    designs: dict[str, Solution | Problem] = {
        name: solution
        for name, solution in designs_and_evidence(results.finished())[0].items()
        if solution.ok and (study is None or not name.startswith("solve "))
    }
    if study is not None and (not designs or (design is not None and design not in designs)):
        designs = {**problems_of(study), **designs}
    if not designs:
        raise ProblemError(f"validate: there is no finished design in '{results.folder}' that can be read. {why}")
    if design is None:
        return designs
    if design not in designs:
        known = f"expected one of {list(designs)}.{meant(design, designs)}"
        raise ProblemError(f"validate: there is no design '{design}' in '{results.folder}'; {known}")
    return {design: designs[design]}
