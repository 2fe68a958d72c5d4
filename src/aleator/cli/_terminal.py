"""What a command says: results on stdout, errors on stderr; or one JSON document on stdout, and all else on stderr."""

import io
import os
import sys
import textwrap
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, final

from rich.cells import cell_len
from rich.console import Console
from rich.status import Status
from rich.table import Table as RichTable
from rich.text import Text

from aleator._core.errors import AleatorError, AleatorWarning
from aleator.reporting import Table, json_text

FAILED, USAGE, INTERRUPTED = 1, 2, 130


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
        self._is_json, self._document, self._errors = as_json, {"command": command}, list[str]()

    def do(self, work: Callable[[], int]) -> int:
        """Do the work of a command, print the JSON document if it is asked for, and return the exit code.

        What is refused is an error in a sentence, and wrong usage. A mistake in a study's own code keeps its traceback.
        """
        code = FAILED
        try:
            with self._warning():
                code = work()
        except KeyboardInterrupt:
            code = INTERRUPTED
            self.complain("Interrupted.", label="")
        except (AleatorError, OSError) as error:
            code = USAGE
            self.complain(error)
        finally:
            if self._is_json:
                sys.stdout.write(self._text(code))
        return code

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
        self.console.print(_labelled("look at", "bold yellow", sentence), soft_wrap=True)

    def complain(self, error: Exception | str, label: str = "error") -> None:
        """Print an error, or what an interrupted run has kept."""
        self._errors.append(f"{error}")
        self._stderr.print(_labelled(label, "bold red", f"{error}"), soft_wrap=True)

    def note(self, **facts: Any) -> None:
        """Add to the JSON document."""
        self._document.update(facts)

    def end_at_once(self, sentence: str, code: int) -> None:
        """End the process from another thread, with a last word and its JSON document. Nothing else runs."""
        self._errors.append(sentence)
        if self._is_json:
            os.write(1, self._text(code).encode())
        os.write(2, f"{chr(10) + _SHOW_CURSOR if self.console.is_terminal else ''}{sentence}\n".encode())
        os._exit(code)

    def _text(self, code: int) -> str:
        return json_text({**self._document, "exit_code": code, "errors": self._errors})

    @contextmanager
    def _warning(self) -> Iterator[None]:
        """Show our warnings within a block as sentences, without their place in the code."""
        with warnings.catch_warnings():
            show_others = warnings.showwarning

            def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
                if issubclass(category, AleatorWarning):
                    self._stderr.print(_labelled("warning", "bold yellow", f"{message}"), soft_wrap=True)
                else:
                    show_others(message, category, *place)

            warnings.showwarning = show
            yield


# What shows a cursor that progress hides.
_SHOW_CURSOR = "\x1b[?25h"


def _labelled(label: str, style: str, sentence: str) -> Text:
    return Text.assemble((label, style), f": {sentence}") if label else Text(sentence)


# --- Tables ----------------------------------------------------------------------------------------------------------

# What rich draws around the cells of each column, and at the end of a row.
_AROUND, _END = 3, 1
# No cell is made narrower than this for the sake of its neighbours.
_COMFORT = 16


def fitted(table: Table, width: int) -> Iterator[RichTable]:
    """A table of a report as tables that fit a width, with no number cut: lines are wrapped between words alone.

    As many columns as fit make a block, two at least; each block repeats the first column. The caption stands above
    the first block, the note below the last.
    """
    cells = [table.header, *([str(cell) for cell in row] for row in table.rows)]
    for room in range(width, _COMFORT - 1, -1):  # Until all columns fit, the widest cells become narrower.
        first, *others = zip(*([_wrapped(cell, room) for cell in row] for row in cells), strict=True)
        if _width_of([first, *others]) <= width:
            break
    blocks: list[list[Sequence[str]]] = [[first]]
    for column in others:
        if len(blocks[-1]) > 1 and _width_of([*blocks[-1], column]) > width:
            blocks.append([first])
        blocks[-1].append(column)
    for i, block in enumerate(blocks):
        drawn = RichTable(
            title=table.caption if i == 0 else None,
            caption=table.note if i == len(blocks) - 1 else None,
            caption_justify="left",
        )
        for column in block:
            drawn.add_column(column[0], overflow="fold", no_wrap=column is not first)
        for row in zip(*(column[1:] for column in block), strict=True):
            drawn.add_row(*row)
        yield drawn


def _wrapped(cell: str, room: int) -> str:
    """A cell of lines that fit, where no word is longer. Numbers and units are joined by another space than words."""
    lines = (textwrap.wrap(line, room, break_long_words=False, break_on_hyphens=False) for line in cell.split("\n"))
    return "\n".join("\n".join(line) for line in lines)


def _width_of(columns: Sequence[Sequence[str]]) -> int:
    return sum(max(map(cell_len, "\n".join(column).split("\n"))) + _AROUND for column in columns) + _END


# --- Progress --------------------------------------------------------------------------------------------------------

_NOW_AND_THEN = 10.0  # seconds between two lines


@final
class Progress:
    """The present step in a line, which a terminal overwrites, and others print now and then."""

    def __init__(self, console: Console):
        self._console = console
        self._status = Status("", console=console) if console.is_terminal else None
        self.begin("")

    def __enter__(self) -> "Progress":
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(self, *ended: object) -> None:
        if self._status is not None:
            self._status.stop()

    def begin(self, step: str) -> None:
        """A step begins."""
        self._step, self._begun, self._last = step, time.monotonic(), (0, 0)
        self._work_begun, self._printed = self._begun, 0.0

    def show(self, task: str, done: int, total: int) -> None:
        """Show the work inside the present step: see `aleator._core.border`."""
        now = time.monotonic()
        if total != self._last[1] or done < self._last[0]:  # other work, within the same step
            self._work_begun, self._printed = now, 0.0
        is_new, self._last = (done, total) != self._last, (done, total)
        left = f", about {_duration((now - self._work_begun) / done * (total - done))} left" if 0 < done < total else ""
        line = f"  {task}, {done} of {total}{left}"
        if self._status is not None:
            self._status.update(Text(line))
        elif done and is_new and (done == total or not self._printed or now > self._printed + _NOW_AND_THEN):
            self._console.print(line, soft_wrap=True)
            self._printed = now

    def end(self, step: str) -> None:
        """A step has ended."""
        self._console.print(f"{step}: {time.monotonic() - self._begun:.1f} s", soft_wrap=True)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
