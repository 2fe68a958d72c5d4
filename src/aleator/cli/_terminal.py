"""What a command says: results on stdout, errors on stderr; or one JSON document on stdout, and all else on stderr."""

import io
import os
import sys
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn, final

import typer
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from aleator._core.errors import AleatorError, AleatorWarning
from aleator.reporting import Table, json_text

FAILED, USAGE = 1, 2

# What rich draws around the cells of each column, and at the end of a row.
_AROUND, _END = 3, 1
# Narrower than this no column is wrapped for the sake of its neighbours.
_COMFORT = 16


@final
class Terminal:
    """Where one command speaks; `as_json` asks for one JSON document, of what is noted in the meantime.

    - `console`: for words, tables and progress.
    """

    def __init__(self, command: str, as_json: bool = False):
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):  # of whatever encoding, perhaps one without μ and ξ
                stream.reconfigure(errors="backslashreplace")
        # Text is printed literally, without markup.
        self._stderr = Console(stderr=True, markup=False, emoji=False, highlight=False)
        self.console = self._stderr if as_json else Console(markup=False, emoji=False, highlight=False)
        self.is_json, self._document, self._errors = as_json, {"command": command}, list[str]()

    def tell(self, sentence: str) -> None:
        """Print a sentence."""
        self.console.print(sentence, soft_wrap=True)

    def title(self, heading: str) -> None:
        """Print a heading."""
        self.console.print(Text(heading, style="bold"))

    def table(self, table: Table) -> None:
        """Print a table."""
        for block in fitted(table, self.console.width):
            self.console.print(block)

    def look_at(self, sentence: str) -> None:
        """Print what deserves a look."""
        self.console.print(Text.assemble(("look at", "bold yellow"), f": {sentence}"), soft_wrap=True)

    def complain(self, what: str, error: Exception | str) -> None:
        """Print an error."""
        self._errors.append(f"{error}")
        self._stderr.print(Text.assemble((what, "bold red"), f": {error}"), soft_wrap=True)

    def last_words(self, sentence: str) -> None:
        """Print on stderr what an interrupted run has kept."""
        self._errors.append(sentence)
        self._stderr.print(sentence, soft_wrap=True)

    def ended_at_once(self, sentence: str, code: int) -> str:
        """The last word of a process that another thread ends at once, after its JSON document, if there is one."""
        self._errors.append(sentence)
        if self.is_json:
            with os.fdopen(os.dup(1), "w", encoding="utf-8") as stdout:
                stdout.write(self._text(code))
        return sentence

    def note(self, **facts: Any) -> None:
        """Add to the JSON document."""
        self._document.update(facts)

    def print_document(self, code: int) -> None:
        """Print the JSON document, if it is asked for, with the exit code."""
        if self.is_json:
            typer.echo(self._text(code), nl=False)

    def _text(self, code: int) -> str:
        return json_text({**self._document, "exit_code": code, "errors": self._errors})

    def conclude(self, code: int) -> NoReturn:
        """Print the JSON document, if it is asked for, and end with an exit code."""
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
            show_others = warnings.showwarning

            def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
                if issubclass(category, AleatorWarning):
                    self._stderr.print(Text.assemble(("warning", "bold yellow"), f": {message}"), soft_wrap=True)
                else:
                    show_others(message, category, *place)

            warnings.showwarning = show
            yield


def fitted(table: Table, width: int) -> Iterator[RichTable]:
    """A table of a report as tables that fit a width, with no number cut: lines are wrapped between words alone.

    As many columns as fit make a block, two at least; each block repeats the first column. The caption stands above
    the first block, the note below the last.
    """
    columns = [list(column) for column in zip(table.header, *(map(str, row) for row in table.rows), strict=True)]
    first, *others = columns
    blocks: list[list[list[str]]] = [[first]]
    for column in others:
        if len(blocks[-1]) > 1 and sum(_least(one) + _AROUND for one in (*blocks[-1], column)) + _END > width:
            blocks.append([first])
        blocks[-1].append(column)
    for i, block in enumerate(blocks):
        drawn = RichTable(caption_justify="left")
        drawn.title = table.caption if i == 0 else None
        drawn.caption = table.note if i == len(blocks) - 1 else None
        cells = [
            ["\n".join(_wrapped(cell, room)) for cell in column]
            for column, room in zip(block, _widths(block, width), strict=True)
        ]
        for header, *_ in cells:
            drawn.add_column(header, overflow="fold")
        for row in zip(*(column[1:] for column in cells), strict=True):
            drawn.add_row(*row)
        yield drawn


def _natural(column: Sequence[str]) -> int:
    return max(cell_len(line) for cell in column for line in cell.split("\n"))


def _least(column: Sequence[str]) -> int:
    """That of the longest word. Numbers and units are joined by a space at which lines are not broken."""
    longest = max((cell_len(word) for cell in column for word in cell.replace("\n", " ").split(" ")), default=0)
    return max(longest, min(_natural(column), _COMFORT))


def _widths(columns: Sequence[Sequence[str]], width: int) -> list[int]:
    """A width for each column: its own, those with most to spare narrowed until all fit, or as far as words allow."""
    widths, least = [_natural(column) for column in columns], [_least(column) for column in columns]
    for _ in range(sum(widths) + _AROUND * len(columns) + _END - width):
        spare = [one - other for one, other in zip(widths, least, strict=True)]
        if max(spare) <= 0:  # only words longer than a line are cut
            least = [min(one, _COMFORT) for one in least]
        widths[spare.index(max(spare))] -= 1
    return [max(one, 1) for one in widths]


def _wrapped(cell: str, room: int) -> list[str]:
    """The lines of a cell; a word is broken only where it is longer than its column."""
    return [part for line in cell.split("\n") for part in (textwrap.wrap(line, room, break_on_hyphens=False) or [""])]
