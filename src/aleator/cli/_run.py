"""`aleator run`: a study from its start to its page."""

from pathlib import Path
from typing import Annotated

import typer

from aleator.cli._course import executed
from aleator.cli._options import Afresh, AsJson, StudyName, Workers, folder_of
from aleator.cli._record import Record
from aleator.cli._terminal import Terminal


def run(
    study: StudyName,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer samples and points: a first look in a minute.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the results.", show_default="results/STUDY")] = None,
    workers: Workers = None,
    afresh: Afresh = False,
    as_json: AsJson = False,
) -> None:
    """Run a study: solve, check by Monte Carlo, sweep, and write the report.

    Each result is kept as soon as it is there: the same command goes on where a run was ended. Processes (--workers)
    share the points of fronts and the evidence along them.
    """
    terminal, record = Terminal("run", as_json), Record(study, quick=quick, workers=workers or 0)
    terminal.conclude(executed(terminal, record.made, out or folder_of(study), afresh=afresh, record=record))
