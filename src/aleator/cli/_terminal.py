"""What a command says: results on stdout, errors on stderr; or one JSON document on stdout, and all else on stderr.

Progress is bars that overwrite themselves on a terminal, elsewhere a plain line now and then.
"""

import io
import os
import sys
import textwrap
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn, final

import typer
from rich.cells import cell_len
from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
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


# --- Tables ----------------------------------------------------------------------------------------------------------


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


# --- Progress --------------------------------------------------------------------------------------------------------

_NOW_AND_THEN = 10.0  # seconds between two lines


@final
class Shown:
    """The progress of parts, `total` of them where that is known, and of the work inside the present one."""

    def __init__(self, console: Console, bars: Bars, total: float | None):
        self._console, self._bars = console, bars if console.is_terminal else None
        self._parts = bars.add_task("all parts", total=total)
        self.begin("")

    def begin(self, part: str) -> None:
        """A part begins."""
        self._part, self._begun, self._printed, self._last = part, time.monotonic(), 0.0, ("", 0, 0)
        self._work = self._bars.add_task(f"  {part}", total=None) if self._bars and part else None

    def show(self, task: str, done: int, total: int) -> None:
        """Show the work inside the present part: see `aleator._core.border`."""
        if self._bars and self._work is not None:
            text = task if task.startswith(self._part) else f"{self._part}: {task}"
            self._bars.update(self._work, description=f"  {text}", completed=done, total=total)
            return
        now, (_, done_before, total_before) = time.monotonic(), self._last
        if total != total_before or done < done_before:  # other work, within the same part
            self._begun, self._printed = now, 0.0
        is_new, self._last = (task, done, total) != self._last, (task, done, total)
        if done and is_new and (done == total or not self._printed or now > self._printed + _NOW_AND_THEN):
            left = (now - self._begun) / done * (total - done)
            estimate = f", about {_duration(left)} left" if done < total else ""
            self._console.print(f"  {task}, {done} of {total}{estimate}", soft_wrap=True)
            self._printed = now

    def end(self, part: str, told: str) -> None:
        """A part has ended; `told` says how long it took."""
        if self._bars and self._work is not None:
            self._bars.remove_task(self._work)
            self._bars.advance(self._parts)
        self._console.print(f"{part}: {told}", soft_wrap=True)


@contextmanager
def shown(console: Console, total: float | None) -> Iterator[Shown]:
    """Show progress within a block, of `total` parts, if that is known."""
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn())
    clocks = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    with Bars(*columns, *clocks, console=console, disable=not console.is_terminal) as bars:
        yield Shown(console, bars, total)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
