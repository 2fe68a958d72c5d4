"""`aleator list`: the studies, or the results of a run."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table as RichTable

from aleator.cli._options import AsJson
from aleator.cli._terminal import Terminal
from aleator.journalling import Entry, examined, listing, names_of
from aleator.studies import STUDIES


def list_studies(
    folder: Annotated[
        Path | None, typer.Argument(help="A run's folder, to list its results instead.", show_default=False)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the case studies, or the results in a run's folder with their states."""
    terminal = Terminal("list", as_json)
    if folder is None:
        _tell_studies(terminal)
    else:
        with terminal.refusing():
            found = examined(folder)
        names = names_of(found)
        terminal.tell(listing(folder, found))
        terminal.note(folder=str(folder), results=[_row(one, names.get(one.key)) for one in found])
    terminal.conclude(0)


def _tell_studies(terminal: Terminal) -> None:
    table = RichTable("study", "about", box=None)
    for name, entry in STUDIES.items():
        table.add_row(name, entry.about)
    terminal.console.print(table)
    terminal.note(studies=[{"name": name, "about": entry.about} for name, entry in STUDIES.items()])


def _row(one: Entry, called: str | None) -> dict[str, Any]:
    told = {
        "name": one.name,
        "load": called,
        "what": one.what,
        "state": one.state.value,
        "why": one.why,
        "file": one.file,
    }
    return {**told, "host": one.host, "process": one.process, "since": one.since, "seconds": one.seconds or None}
