"""What a terminal of any width shows: tables that fit it, with no number cut, and the progress of a run.

Tables are wrapped between words, in blocks of columns. Progress is bars on a terminal, plain lines elsewhere.
"""

import abc
import re
import textwrap
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import cycle
from typing import final

from rich.cells import cell_len
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table as RichTable
from typing_extensions import override

from aleator.reporting import Table

# What rich draws around the cells of each column, and at the end of a row.
_AROUND, _END = 3, 1
# Narrower than this no column is wrapped for the sake of its neighbours.
_COMFORT = 16
# Ordinary spaces: not those between the digits of a number, or before its unit.
_WORDS = re.compile(r"[ \n]+")
# Plain lines: one for each step of work with few steps, such as points of a front; otherwise one now and then, seconds.
_FEW, _NOW_AND_THEN = 100, 10.0


def fitted(table: Table, width: int) -> Iterator[RichTable]:
    """A table of a report as tables that fit a width: the first column is repeated where the others need several.

    The caption stands above the first block, the note below the last.
    """
    columns = [list(column) for column in zip(table.header, *(map(str, row) for row in table.rows), strict=True)]
    blocks = list(_blocks(columns, width))
    for i, block in enumerate(blocks):
        title, note = table.caption if i == 0 else None, table.note if i == len(blocks) - 1 else None
        yield _drawn([columns[j] for j in block], width, title, note)


def _blocks(columns: Sequence[Sequence[str]], width: int) -> Iterator[list[int]]:
    """The columns of each block, by their numbers: as many as fit without a word cut, two at least."""
    needs = [_needed(column) + _AROUND for column in columns]
    block = [0][: len(columns)]
    for j in range(1, len(columns)):
        if len(block) > 1 and sum(needs[k] for k in (*block, j)) + _END > width:
            yield block
            block = [0]
        block.append(j)
    yield block


def _natural(column: Sequence[str]) -> int:
    return max(cell_len(line) for text in column for line in text.split("\n"))


def _needed(column: Sequence[str]) -> int:
    """The least width: that of the longest word. Numbers and units are joined by a space that is not broken."""
    longest = max((cell_len(word) for text in column for word in _WORDS.split(text)), default=0)
    return max(longest, min(_natural(column), _COMFORT))


def _drawn(columns: Sequence[list[str]], width: int, title: str | None, note: str | None) -> RichTable:
    widths = _widths(columns, width - _AROUND * len(columns) - _END)
    pairs = zip(columns, widths, strict=True)
    wrapped = [["\n".join(_lines(text, room)) for text in column] for column, room in pairs]
    drawn = RichTable(title=title, caption=note, caption_justify="left")
    for header, *_ in wrapped:
        drawn.add_column(header, overflow="fold")
    for row in zip(*(column[1:] for column in wrapped), strict=True):
        drawn.add_row(*row)
    return drawn


def _widths(columns: Sequence[Sequence[str]], room: int) -> list[int]:
    """A width for each column: all that it asks for if there is room, or else what it needs, and a part of the rest."""
    natural = [_natural(column) for column in columns]
    widths = [min(_needed(column), wish) for column, wish in zip(columns, natural, strict=True)]
    if len(columns) > 1 and sum(widths) > room:  # two columns of long words: the first is that of labels
        widths[0] = max(min(widths[0], max(room - widths[1], room // 3)), 1)
        widths[1] = max(min(widths[1], room - widths[0]), 1)
    for j in cycle(range(len(columns))):
        if sum(widths) >= room or all(width >= wish for width, wish in zip(widths, natural, strict=True)):
            return widths
        widths[j] += widths[j] < natural[j]
    return widths


def _lines(text: str, room: int) -> list[str]:
    """The lines of a cell; a word is broken only where it is longer than its column."""
    return [part for line in text.split("\n") for part in (textwrap.wrap(line, room, break_on_hyphens=False) or [""])]


class AbstractShown(abc.ABC):
    """How the progress of a run is shown."""

    @abc.abstractmethod
    def show(self, task: str, done: int, total: int) -> None:
        """Show the work inside the present stage: see `aleator._core.border`."""

    @abc.abstractmethod
    def begin(self, stage: str) -> None:
        """A stage begins."""

    @abc.abstractmethod
    def end(self, stage: str, share: float, told: str) -> None:
        """A stage has ended; `share` is its part of all, `told` how long it took."""


@contextmanager
def shown(console: Console, total: float | None) -> Iterator[AbstractShown]:
    """Show progress within a block, of stages whose shares add up to `total`, if that is known."""
    if not console.is_terminal:
        yield _Lines(console)
        return
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn())
    clocks = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, *clocks, console=console) as bars:
        yield _Bars(bars, total)


@final
class _Bars(AbstractShown):
    """Bars for all stages, and for the work inside the present one. Points of a front stay as lines above them."""

    def __init__(self, bars: Progress, total: float | None):
        self._bars, self._overall = bars, bars.add_task("all stages", total=total)
        self._stage, self._inner, self._task = "", self._overall, ""

    @override
    def begin(self, stage: str) -> None:
        self._stage, self._inner, self._task = stage, self._bars.add_task(f"  {stage}", total=None), ""

    @override
    def show(self, task: str, done: int, total: int) -> None:
        if done and task != self._task and total <= _FEW:
            self._bars.console.print(f"  {task}")
            self._task = task
        brief = task.partition(": ")[0]
        told = self._stage if brief == self._stage else f"{self._stage}: {brief}"
        self._bars.update(self._inner, description=f"  {told}", completed=done, total=total)

    @override
    def end(self, stage: str, share: float, told: str) -> None:
        self._bars.remove_task(self._inner)
        self._bars.console.print(f"{stage}: {told}")
        self._bars.advance(self._overall, share)


@final
class _Lines(AbstractShown):
    """Lines without control characters, for files and pipes."""

    def __init__(self, console: Console, clock: Callable[[], float] = time.monotonic):
        self._console, self._clock = console, clock
        self.begin("")

    @override
    def begin(self, stage: str) -> None:
        self._begun = self._last = self._clock()
        self._told, self._steps = (0, ""), (0, 0)

    @override
    def show(self, task: str, done: int, total: int) -> None:
        now = self._clock()
        if total != self._steps[1] or done < self._steps[0]:  # other work, within the same stage
            self._begun = now
        self._steps = (done, total)
        is_step = total <= _FEW or done == total
        if done and (done, task) != self._told and (is_step or now > self._last + _NOW_AND_THEN):
            left = (now - self._begun) / done * (total - done)
            estimate = f", about {_duration(left)} left" if done < total else ""
            self._console.print(f"  {task}, {done} of {total}{estimate}", soft_wrap=True)
            self._last, self._told = now, (done, task)

    @override
    def end(self, stage: str, share: float, told: str) -> None:
        self._console.print(f"{stage}: {told}", soft_wrap=True)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
