"""What `aleator check`, `run`, `resume`, `sweep`, `validate` and `list` do, as functions of their arguments."""

import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from aleator import studies
from aleator._core.border import meant, refusal
from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._course import executed
from aleator.cli._folder import Record, folder_of, folder_over, is_stale, recorded, stale, study_of
from aleator.cli._interruption import Interruptions
from aleator.cli._results import designs_and_evidence
from aleator.cli._terminal import FAILED, Terminal, shown
from aleator.design import Problem
from aleator.journalling import Entry, Journal, examined, journal, listing, names_of
from aleator.reporting import documents_table, evidence_document, evidence_table, solution_document, violations_table
from aleator.solution import Solution, in_brief
from aleator.solving import solve
from aleator.studies import AbstractStudy, Check, executor_of, problems_of
from aleator.validation import Evidence
from aleator.validation import validate as validated

_NAME_IT = "Name the study to solve it first."
_KEPT = "Interrupted: finished evidence is kept."


def check(study: str, as_json: bool) -> NoReturn:
    """Print what a study will do."""
    terminal = Terminal("check", as_json)
    interruptions = Interruptions(lambda: terminal.ended_at_once("Interrupted.", interruptions.exit_code))
    with interruptions, terminal.refusing():
        checked = Check(studies.load(study))
    for problem in checked.mathematics():
        terminal.title(problem.heading)
        terminal.tell(problem.text)
    if (numbers := checked.numbers()) is not None:
        terminal.table(numbers)
    terminal.table(checked.table())
    for trouble in checked.troubles:
        terminal.look_at(trouble)
    terminal.note(study=study, problems=checked.document(), look_at=checked.troubles)
    terminal.conclude(0)


def run(
    study: str, *, quick: bool = False, out: Path | None = None, workers: int = 0, afresh: bool, as_json: bool
) -> NoReturn:
    """Run a study; `workers`: 0 for as many as it says."""
    terminal, record = Terminal("run", as_json), Record(study, quick=quick, workers=workers)
    terminal.conclude(executed(terminal, record.made, out or folder_of(study), afresh=afresh, record=record))


def resume(folder: Path, workers: int, as_json: bool) -> NoReturn:
    """Go on with the run of a folder."""
    terminal = Terminal("resume", as_json)
    with terminal.refusing():
        record = recorded(folder)
        record = replace(record, workers=workers or record.workers)
    terminal.conclude(executed(terminal, record.made, folder, record=record))


def sweep(
    study: str, bound: str, values: str, workers: int, design: str, *, out: Path | None, afresh: bool, as_json: bool
) -> NoReturn:
    """Solve one design of a study for each value of a bound."""
    terminal = Terminal("sweep", as_json)
    with terminal.refusing():
        record = Record(study, bound=bound, values=_numbers(values), design=design, workers=workers)
    folder = out or folder_over(folder_of(study), bound)
    terminal.conclude(executed(terminal, record.made, folder, afresh=afresh, record=record))


def _numbers(text: str) -> tuple[float, ...]:
    """Numbers with commas between them. Raises `ProblemError` for anything else."""
    try:
        return tuple(float(number) for number in text.split(",") if number.strip())
    except ValueError:
        raise refusal("sweep: --values", "numbers with commas between them, such as 1,1.2,1.4", text) from None


def list_results(folder: Path, as_json: bool) -> NoReturn:
    """List the results in a run's folder."""
    terminal = Terminal("list", as_json)
    with terminal.refusing():
        entries = examined(folder)
    names, is_edited = names_of(entries), is_stale(folder)
    terminal.tell(listing(folder, entries))
    if is_edited:
        terminal.look_at(stale(folder))
    results = [_row(entry, names.get(entry.key)) for entry in entries]
    terminal.note(folder=str(folder), stale=is_edited, results=results)
    terminal.conclude(0)


def _row(entry: Entry, name: str | None) -> dict[str, Any]:
    shown = ("name", "what", "why", "file", "host", "process", "since")
    facts = {field: getattr(entry, field) for field in shown}
    return {**facts, "load": name, "state": entry.state.value, "seconds": entry.seconds or None}


# --- Evidence --------------------------------------------------------------------------------------------------------


def validate(place: str, samples: int, seed: int, design: str | None, workers: int | None, as_json: bool) -> NoReturn:
    """Count on fresh random systems how often the designs of a study or a folder break their limits.

    Designs are solved where needed, and sampled in order. The document of each says whether it is solved (`status`, and
    `why` there is no evidence if it is not), whether it was solved just now (`solved_anew`), and how often its limits
    break (`violations`).
    """
    terminal, code = Terminal("validate", as_json), 0
    interruptions = Interruptions(lambda: terminal.ended_at_once(_KEPT, interruptions.exit_code))
    evidence, documents = dict[str, Evidence](), dict[str, dict[str, Any]]()
    with ExitStack() as held:
        executor = held.enter_context(executor_of(workers))
        held.enter_context(interruptions)
        held.enter_context(terminal.warning())
        with terminal.refusing():
            study, folder, why = _study_and_folder(place)
            run = held.enter_context(journal(folder))
            designs = _selected(study, why, run, design)
        solving = {} if study is None else study.solving
        try:
            with shown(terminal.console, len(designs)) as progress, interruptions.work():
                for name, one in designs.items():
                    started, part = time.perf_counter(), f"evidence on {name}"
                    progress.begin(part)
                    try:
                        solution, documents[name] = _solution(terminal, name, one, run, solving)
                        progress.show(f"{name}: {in_brief(solution)}", 0, samples)
                        if not solution.ok:
                            raise ProblemError(solution.why())
                        how: dict[str, Any] = {"seed": seed, "executor": executor, "progress": progress.show}
                        evidence[name] = validated(solution, samples, **how)
                        documents[name] |= evidence_document(evidence[name])
                    except AleatorError as error:  # the others go on
                        code = FAILED
                        documents.setdefault(name, {})["why"] = f"{error}"
                        terminal.complain(f"error with '{name}'", error)
                    progress.end(part, f"{time.perf_counter() - started:.1f} s")
            interruptions.rest()
        except KeyboardInterrupt:
            interruptions.conclude()
            terminal.last_words(_KEPT)
            code = interruptions.exit_code
    terminal.note(folder=str(folder), samples=samples, seed=seed, designs=documents)
    if evidence:
        shown_designs = {name: solution_document(one.solution) for name, one in evidence.items()}
        for table in (documents_table("Designs", shown_designs), violations_table(evidence), evidence_table(evidence)):
            terminal.table(table)
    terminal.conclude(code)


def _solution(
    terminal: Terminal, name: str, design: Solution | Problem, run: Journal, solving: Mapping[str, Any]
) -> tuple[Solution, dict[str, Any]]:
    """A design of the folder, or of a solve of now, which has this name there from now on; and its document."""
    begun = run.begun
    solution = design if isinstance(design, Solution) else solve(design, **solving, throw=False)
    is_new, document = run.begun > begun, solution_document(solution)
    if is_new:
        run.call({name: solution})
    origin = "solved, because the folder does not have it" if is_new else "taken from the folder"
    terminal.tell(f"design {name}: {origin}.")
    return solution, {"solved_anew": is_new, **{key: document[key] for key in ("status", "decisions", "objective")}}


def _study_and_folder(place: str) -> tuple[AbstractStudy | None, Path, str]:
    """The study and the folder of a name, and why a folder's study cannot be loaded, if so."""
    folder = Path(place)
    if folder.is_dir():
        study, why = study_of(folder)
    else:
        study, folder, why = studies.load(place), folder_of(place), ""
        Record(place).check_owns(folder)
    if is_stale(folder):
        raise ProblemError(f"validate: {stale(folder)}")
    return study, folder, why


def _selected(
    study: AbstractStudy | None, why: str, run: Journal, design: str | None
) -> Mapping[str, Solution | Problem]:
    """Designs of a folder, and problems that are to be solved first, by name."""
    # A solution without a name in the folder of a study is no design of its run.
    designs: dict[str, Solution | Problem] = {
        name: solution
        for name, solution in designs_and_evidence(run.finished())[0].items()
        if solution.ok and (study is None or not name.startswith("solve "))
    }
    if study is not None and (not designs or (design is not None and design not in designs)):
        designs = {**problems_of(study), **designs}
    if design is not None and design not in designs:
        known = f"expected one of {list(designs)}.{meant(design, designs)}"
        raise ProblemError(f"validate: there is no design '{design}' in '{run.folder}'; {known}")
    if not designs:
        raise ProblemError(
            f"validate: there is no finished design in '{run.folder}' that can be read. {why or _NAME_IT}"
        )
    return designs if design is None else {design: designs[design]}
