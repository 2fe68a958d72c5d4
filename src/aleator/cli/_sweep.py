"""`aleator sweep`: a front over one bound of any study."""

from pathlib import Path
from typing import Annotated

import typer

from aleator._core.given import refusal
from aleator.cli._course import executed
from aleator.cli._options import Afresh, AsJson, Design, StudyName, Workers, folder_of, folder_over
from aleator.cli._record import Record
from aleator.cli._terminal import Terminal


def sweep(
    study: StudyName,
    bound: Annotated[str, typer.Option(help="Name of the limit whose bound is varied.", show_default=False)],
    values: Annotated[str, typer.Option(help="Its bounds: numbers with commas between them.", show_default=False)],
    workers: Workers = None,
    design: Design = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results.", show_default="results/STUDY-over-BOUND")
    ] = None,
    afresh: Afresh = False,
    as_json: AsJson = False,
) -> None:
    """Solve one design of a study again for each value of a bound, and write the front with its page.

    The last design is taken if none is named. Each point is kept as soon as it is there.
    """
    terminal = Terminal("sweep", as_json)
    with terminal.refusing():
        record = Record(study, bound=bound, values=numbers(values), design=design or "", workers=workers or 0)
    folder = out or folder_over(folder_of(study), bound)
    terminal.conclude(executed(terminal, record.made, folder, afresh=afresh, record=record))


def numbers(text: str) -> tuple[float, ...]:
    """Numbers with commas between them. Raises `ProblemError` for anything else."""
    try:
        return tuple(float(one) for one in text.split(",") if one.strip())
    except ValueError:
        raise refusal("sweep: --values", "numbers with commas between them, such as 1,1.2,1.4", text) from None
