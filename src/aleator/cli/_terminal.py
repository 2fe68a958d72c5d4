"""What a command says, and the arguments that commands share.

Results go to stdout, errors to stderr; or one JSON document to stdout, and all else to stderr.
"""

import io
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeAlias, final

import typer
from rich.console import Console
from rich.text import Text

from aleator._core.errors import AleatorError, AleatorWarning
from aleator.cli._shown import fitted
from aleator.reporting import Table, json_text
from aleator.studies import STUDIES

FAILED, USAGE = 1, 2


@final
class Terminal:
    """Where one command speaks; `as_json` asks for one JSON document, of what is noted in the meantime.

    - `console`: for words, tables and progress.
    """

    def __init__(self, command: str, as_json: bool = False):
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):  # of whatever encoding, perhaps one without μ and ξ
                stream.reconfigure(errors="backslashreplace")
        self._errors = _console(stderr=True)
        self.console = self._errors if as_json else _console()
        self._document: dict[str, Any] | None = {"command": command} if as_json else None
        self._said = list[str]()

    def tell(self, said: str) -> None:
        """Print a sentence."""
        self.console.print(said, soft_wrap=True)

    def title(self, said: str) -> None:
        """Print a heading."""
        self.console.print(Text(said, style="bold"))

    def table(self, table: Table) -> None:
        """Print a table."""
        for block in fitted(table, self.console.width):
            self.console.print(block)

    def look_at(self, said: str) -> None:
        """Print what deserves a look."""
        self.console.print(Text.assemble(("look at", "bold yellow"), f": {said}"), soft_wrap=True)

    def complain(self, what: str, error: Exception | str) -> None:
        """Print an error."""
        self._said.append(f"{error}")
        self._errors.print(Text.assemble((what, "bold red"), f": {error}"), soft_wrap=True)

    def warn(self, said: str) -> None:
        """Print a warning."""
        self._errors.print(Text.assemble(("warning", "bold yellow"), f": {said}"), soft_wrap=True)

    def last_words(self, said: str) -> None:
        """Print on stderr what an interrupted run has kept."""
        self._said.append(said)
        self._errors.print(said, soft_wrap=True)

    def ended_at_once(self, said: str, code: int) -> str:
        """The last word of a process that another thread ends at once, after its JSON document, if there is one."""
        self._said.append(said)
        if self._document is not None:
            with os.fdopen(os.dup(1), "w", encoding="utf-8") as stdout:
                stdout.write(self._finished_document(code))
        return said

    def note(self, **facts: Any) -> None:
        """Add to the JSON document, if there is one."""
        if self._document is not None:
            self._document.update(facts)

    @property
    def is_json(self) -> bool:
        """Whether a JSON document is asked for."""
        return self._document is not None

    def print_document(self, code: int) -> None:
        """Print the JSON document, if there is one, with the exit code."""
        if self._document is not None:
            typer.echo(self._finished_document(code), nl=False)

    def print_refusal(self, said: str, code: int) -> None:
        """Print the JSON document, if there is one, of an error that people have read elsewhere."""
        self._said.append(said)
        self.print_document(code)

    def _finished_document(self, code: int) -> str:
        return json_text({**(self._document or {}), "exit_code": code, "errors": self._said})

    def conclude(self, code: int) -> NoReturn:
        """Print the JSON document, if there is one, and end with an exit code."""
        self.print_document(code)
        raise typer.Exit(code)

    @contextmanager
    def refusing(self) -> Iterator[None]:
        """Turn what is refused within a block into a message and the exit code of wrong usage."""
        try:
            yield
        except (AleatorError, OSError) as error:
            self.complain("error", error)
            self.conclude(USAGE)

    @contextmanager
    def warning(self) -> Iterator[None]:
        """Show our warnings within a block as sentences, without their place in the code."""
        with warnings.catch_warnings():
            elsewhere = warnings.showwarning

            def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
                if issubclass(category, AleatorWarning):
                    self.warn(f"{message}")
                else:
                    elsewhere(message, category, *place)

            warnings.showwarning = show
            yield


def _console(*, stderr: bool = False) -> Console:
    """A console that prints text literally, without markup."""
    return Console(stderr=stderr, markup=False, emoji=False, highlight=False)


def _names_of_studies(incomplete: str) -> list[str]:
    """Names of studies, and study files, that begin with what was typed."""
    paths = [*Path().glob(f"{_literal(incomplete)}*")] if not Path(incomplete).is_absolute() else []
    folders = [f"{path}/" for path in paths if path.is_dir()]
    files = [f"{path}" for path in paths if path.is_file() and path.suffix in (".py", ".toml")]
    return sorted([*(name for name in STUDIES if name.startswith(incomplete)), *folders, *files])


def _literal(text: str) -> str:
    return "".join(f"[{character}]" if character in "*?[" else character for character in text)


StudyName: TypeAlias = Annotated[
    str,
    typer.Argument(
        help="Name of a case study (see `aleator list`), or a file or module of your own.",
        autocompletion=_names_of_studies,
        show_default=False,
    ),
]
StudyOrFolder: TypeAlias = Annotated[
    str,
    typer.Argument(
        help="A study, or a run's folder.", metavar="STUDY|FOLDER", autocompletion=_names_of_studies, show_default=False
    ),
]
Folder: TypeAlias = Annotated[Path, typer.Argument(help="A run's folder.", show_default=False)]
AsJson: TypeAlias = Annotated[
    bool, typer.Option("--json", help="Print one JSON document on stdout, and all else on stderr.")
]
Afresh: TypeAlias = Annotated[bool, typer.Option("--afresh", help="Compute everything anew.")]
Workers: TypeAlias = Annotated[
    int | None,
    typer.Option("--workers", min=1, help="Processes that share the work.", show_default="as many as the study says"),
]
Design: TypeAlias = Annotated[
    str | None, typer.Option("--design", help="Name of one of its designs.", show_default=False)
]
