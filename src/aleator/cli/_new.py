"""`aleator new`: begin a study of one's own."""

from pathlib import Path
from typing import Annotated

import typer

from aleator.cli._terminal import Terminal
from aleator.studies import begin_file


def new(
    file: Annotated[Path, typer.Argument(help="Python file to write, such as bracket.py.", show_default=False)],
) -> None:
    """Begin a study of your own: write a commented file that runs as it is."""
    terminal = Terminal("new")
    with terminal.refusing():
        written = begin_file(file)
    terminal.tell(f"wrote {written}")
    terminal.tell(f"next: aleator check {written}, then aleator run {written}")
