"""`aleator check` and `validate`: what a study will do, and how often the limits of its designs break."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from aleator import studies
from aleator._core.border import meant
from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._folder import RECORD, Record, staleness
from aleator.cli._terminal import FAILED, Terminal
from aleator.design import Problem
from aleator.journalling import Journal, journal
from aleator.reporting import documents_table, evidence_document, evidence_table, solution_document
from aleator.solution import Solution, in_brief
from aleator.solving import solve
from aleator.studies import AbstractStudy, Check, executor_of, problems_of
from aleator.validation import Evidence
from aleator.validation import validate as validated


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
