"""What `aleator check`, `run`, `resume`, `sweep` and `list` do, as functions of their arguments."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from aleator import studies
from aleator._core.border import refusal
from aleator.cli._course import executed
from aleator.cli._folder import Record, folder_of, folder_over, is_stale, recorded, stale
from aleator.cli._interruption import Interruptions
from aleator.cli._terminal import Terminal
from aleator.journalling import Entry, examined, listing, names_of
from aleator.studies import Check


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
