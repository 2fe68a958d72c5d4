"""What a command says: results on stdout, errors on stderr; or one JSON document on stdout, and all else on stderr."""

import io
import os
import shutil
import sys
import textwrap
import time
import warnings
from collections.abc import Callable, Sequence
from itertools import zip_longest
from typing import Any, final

from aleator._core.errors import AleatorError, AleatorWarning
from aleator.reporting import Table, json_text

FAILED, USAGE = 1, 2

_NOW_AND_THEN = 10.0  # seconds between two lines of progress


@final
class Terminal:
    """Where one command speaks; `as_json` asks for one JSON document, of what is noted in the meantime.

    Progress is a line that overwrites itself on a terminal, elsewhere a line now and then.
    """

    def __init__(self, command: str, as_json: bool = False):
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):  # of whatever encoding, perhaps one without μ and ξ
                stream.reconfigure(errors="backslashreplace")
        self._is_json, self._document, self._errors = as_json, {"command": command}, list[str]()
        self._width = shutil.get_terminal_size().columns
        self._is_overwriting = False
        self.begin("")

    def do(self, work: Callable[[], int]) -> int:
        """Do the work of a command, print the JSON document if it is asked for, and return the exit code.

        What is refused is an error in a sentence, and wrong usage. A mistake in a study's own code keeps its traceback.
        """
        code = FAILED
        try:
            with warnings.catch_warnings():
                warnings.showwarning = self._warn
                code = work()
        except BrokenPipeError:  # whoever read it has gone
            raise
        except (AleatorError, OSError) as error:
            code = USAGE
            self.complain(f"{error}")
        finally:
            if self._is_json:
                sys.stdout.write(self._text(code))
        return code

    def tell(self, text: str, *, is_error: bool = False) -> None:
        """Print a text."""
        if self._is_overwriting:
            print(f"\r{'':{self._width - 1}}\r", end="", file=self._stream)
            self._is_overwriting = False
        print(text, file=sys.stderr if is_error else self._stream, flush=True)

    def table(self, table: Table) -> None:
        """Print a table."""
        self.tell(f"\n{table_text(table, self._width)}")

    def complain(self, sentence: str, label: str = "error: ") -> None:
        """Print an error, or what an interrupted run has kept."""
        self._errors.append(sentence)
        self.tell(f"{label}{sentence}", is_error=True)

    def note(self, **facts: Any) -> None:
        """Add to the JSON document."""
        self._document.update(facts)

    def end_at_once(self, sentence: str, code: int) -> None:
        """End the process from another thread, with a last word and its JSON document. Nothing else runs."""
        self._errors.append(sentence)
        if self._is_json:
            os.write(1, self._text(code).encode())
        os.write(2, f"{chr(10) * self._is_overwriting}{sentence}\n".encode())
        os._exit(code)

    def begin(self, step: str) -> None:
        """A step of the work begins."""
        self._step, self._begun = step, time.monotonic()
        self._work_begun, self._printed, self._last = self._begun, 0.0, (0, 0)

    def progress(self, task: str, done: int, total: int) -> None:
        """Show the work inside the present step: see `aleator._core.border`."""
        now = time.monotonic()
        if total != self._last[1] or done < self._last[0]:  # other work, within the same step
            self._work_begun, self._printed = now, 0.0
        is_new, self._last = (done, total) != self._last, (done, total)
        left = f", about {_duration((now - self._work_begun) / done * (total - done))} left" if 0 < done < total else ""
        line = f"  {task}, {done} of {total}{left}"
        if self._stream.isatty():
            print(f"\r{line[: self._width - 1]:{self._width - 1}}", end="", file=self._stream, flush=True)
            self._is_overwriting = True
        elif done and is_new and (done == total or not self._printed or now > self._printed + _NOW_AND_THEN):
            self.tell(line)
            self._printed = now

    def end(self) -> None:
        """The present step has ended."""
        self.tell(f"{self._step}: {time.monotonic() - self._begun:.1f} s")

    @property
    def _stream(self) -> Any:
        return sys.stderr if self._is_json else sys.stdout

    def _text(self, code: int) -> str:
        return json_text({**self._document, "exit_code": code, "errors": self._errors})

    def _warn(self, message: Warning | str, category: type[Warning], file: str, line: int, *_: Any) -> None:
        """Show a warning in a sentence; one of ours without its place in the code."""
        place = "" if issubclass(category, AleatorWarning) else f"{file}:{line}: {category.__name__}: "
        self.tell(f"warning: {place}{message}", is_error=True)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


# Between two columns; and no cell is made narrower than this for the sake of its neighbours.
_GAP, _COMFORT = "  ", 16


def table_text(table: Table, width: int) -> str:
    """A table of a report in lines that fit a width, with no number cut: lines are wrapped between words alone.

    As many columns as fit make a block, two at least; each block repeats the first column.
    """
    cells = [table.header, *([str(cell) for cell in row] for row in table.rows)]
    columns: list[list[list[str]]] = []
    for room in range(width, _COMFORT - 1, -1):  # until all columns fit, the widest cells become narrower
        columns = [
            list(column) for column in zip(*([_wrapped(cell, room) for cell in row] for row in cells), strict=True)
        ]
        if sum(map(_width_of, columns)) <= width:
            break
    first, *others = columns
    blocks = [[first]]
    for column in others:
        if len(blocks[-1]) > 1 and sum(map(_width_of, [*blocks[-1], column])) > width:
            blocks.append([first])
        blocks[-1].append(column)
    lines = [table.caption]
    for block in blocks:
        widths = [_width_of(column) - len(_GAP) for column in block]
        rows = list(zip(*block, strict=True))
        rows.insert(1, tuple(["-" * room] for room in widths))
        for row in rows:
            for line in zip_longest(*row, fillvalue=""):
                lines.append(_GAP.join(f"{part:{room}}" for part, room in zip(line, widths, strict=True)).rstrip())
        lines.append("")
    return "\n".join([*lines, *textwrap.wrap(table.note, width)]).rstrip()


def _wrapped(cell: str, room: int) -> list[str]:
    """The lines of a cell, where words alone may be longer. Another space joins numbers and units than words."""
    how: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
    each = (textwrap.wrap(line, room, **how) if len(line) > room else [line] for line in cell.split("\n"))
    return [line for lines in each for line in lines]


def _width_of(column: Sequence[Sequence[str]]) -> int:
    return max(len(line) for cell in column for line in cell) + len(_GAP)
