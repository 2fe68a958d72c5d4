"""`AbstractStagedStudy`: a study as named stages, each of whose methods works with incomplete results.

The studies that are not chapters yet; it goes with the last of them.
"""

import abc
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from typing_extensions import override

from aleator._core.border import Progress, silent
from aleator.reporting import Section, Table, Verdict
from aleator.studies._study import AbstractStudy, Draft


class Stage(NamedTuple):
    """A part of a study: its work, and its approximate duration relative to the other stages."""

    work: Callable[[Progress], None]
    share: float


class AbstractStagedStudy(AbstractStudy):
    """A case study: named stages that are run in order, and the presentation of their results."""

    finished: tuple[str, ...] = ()

    @property
    @abc.abstractmethod
    def stages(self) -> Mapping[str, Stage]:
        """The stages by name, in order."""

    @abc.abstractmethod
    def results(self) -> Mapping[str, Any]:
        """The results in a form for `aleator.extending.save`; those not available yet are None or empty."""

    @abc.abstractmethod
    def verdict(self) -> Verdict:
        """The first screen of the page: what to build and why, from the results available so far."""

    @abc.abstractmethod
    def sections(self) -> Sequence[Section]:
        """The chapters of the page; those without blocks are omitted."""

    @abc.abstractmethod
    def tables(self) -> list[Table]:
        """The tables to print at the end."""

    def cut_short(self) -> Iterator[str]:
        """Sentences on what is available of interrupted parts; none by default."""
        yield from ()

    def run(self, stage: str, progress: Progress = silent) -> None:
        """Run one stage and keep its results."""
        self.stages[stage].work(progress)
        self.finished = (*self.finished, stage)

    @override
    def chapter(self, page: Draft) -> None:
        try:
            for name in self.stages:
                page.step(name)
                self.run(name, page.progress)
        finally:
            page.recommend(self.verdict())
            page.tables.extend(self.tables())
            page.append(*self.sections())
            for name, one in self.results().items():
                page.keep(name, one)


class Interruptible(Protocol):
    """Work that Ctrl-C may interrupt, with its results so far: a search, a front, a calibration."""

    @property
    def interrupted(self) -> bool:
        """Whether it was interrupted."""
        ...


def stop_if_interrupted(found: Interruptible) -> None:
    """End a stage whose work was interrupted by Ctrl-C; call it after storing the results.

    Raises `KeyboardInterrupt`.
    """
    if found.interrupted:
        raise KeyboardInterrupt
