"""The progress of a run: bars that overwrite themselves on a terminal, elsewhere a plain line now and then."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import final

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

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
