"""Progress of a run: bars on a terminal, plain lines elsewhere."""

import abc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import final

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from typing_extensions import override

# Plain lines: one for each step of work with few steps, such as points of a front; otherwise one now and then, seconds.
_FEW, _NOW_AND_THEN = 100, 10.0


class AbstractShown(abc.ABC):
    """How the progress of a run is shown."""

    @abc.abstractmethod
    def show(self, task: str, done: int, total: int) -> None:
        """Show the work inside the present stage: see `aleator._core.progress`."""

    @abc.abstractmethod
    def begin(self, stage: str) -> None:
        """A stage begins."""

    @abc.abstractmethod
    def end(self, stage: str, share: float, told: str) -> None:
        """A stage has ended; `share` is its part of all, `told` how long it took."""


@contextmanager
def shown(console: Console, total: float) -> Iterator[AbstractShown]:
    """Show progress within a block, of stages whose shares add up to `total`."""
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

    def __init__(self, bars: Progress, total: float):
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
