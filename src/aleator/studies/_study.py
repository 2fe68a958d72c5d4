"""`AbstractStudy`: what a case study declares; running, saving and the frame of its page follow."""

import abc
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol

from aleator._core.progress import Progress, silent
from aleator.reporting import (
    HOW_TO_READ,
    PAGE,
    Page,
    Section,
    Table,
    Text,
    Verdict,
    footer,
    save_study,
    words,
    write_page,
)


class Stage(NamedTuple):
    """A part of a study: its work, and roughly how long that takes compared with the other stages."""

    work: Callable[[Progress], None]
    share: float


class AbstractStudy(abc.ABC):
    """A case study: named stages that are run in order, and what there is to say of whatever they have found.

    Results are saved after each stage; after the last one, an interruption or a failure, the page is written and the
    tables are printed. So each method works with what there is.

    - `title`, `subtitle`: of the page;
    - `glossary`: its terms and their meanings;
    - `finished`: the stages that have come to their end.
    """

    title: ClassVar[str] = "A case study"
    subtitle: ClassVar[str] = ""
    glossary: ClassVar[Sequence[tuple[str, str]]] = ()
    finished: tuple[str, ...] = ()

    @property
    @abc.abstractmethod
    def stages(self) -> Mapping[str, Stage]:
        """The stages by name, in order."""

    @abc.abstractmethod
    def results(self) -> Mapping[str, Any]:
        """What was found, as `aleator.extending.save` takes it: solutions, evidence, fronts, and mappings of these.

        What has not been reached is None or empty.
        """

    @abc.abstractmethod
    def verdict(self) -> Verdict:
        """The first screen of the page: what to build and why, as far as the study has come."""

    @abc.abstractmethod
    def sections(self) -> Sequence[Section]:
        """The chapters of the page; those without blocks are left out."""

    @abc.abstractmethod
    def tables(self) -> list[Table]:
        """The tables to print at the end."""

    @property
    def left_out(self) -> str:
        """What this run leaves out to be quick, in words: by default nothing."""
        return ""

    def cut_short(self) -> Iterator[str]:
        """What there is of the parts that were interrupted, in sentences: by default none."""
        yield from ()

    def run(self, stage: str, progress: Progress = silent) -> None:
        """Run one stage and keep its results."""
        self.stages[stage].work(progress)
        self.finished = (*self.finished, stage)

    def save(self, folder: Path) -> list[Path]:
        """Write all results as netCDF and JSON files; returns their paths."""
        return list(save_study(folder, **self.results()))

    def page(self) -> Page:
        """The page as data: verdict, what this run did not come to, the study's chapters, and how to read them."""
        glossary = [Table("Glossary", ["Term", "Meaning"], self.glossary)] if self.glossary else []
        sections = [
            Section("This run", self._unfinished()),
            *self.sections(),
            Section("How to read this", [Text(HOW_TO_READ), *glossary]),
        ]
        return Page(
            title=self.title,
            subtitle=self.subtitle,
            verdict=self._whole_verdict(),
            sections=[one for one in sections if one.blocks],
            footer=footer(),
        )

    def write_page(self, folder: Path) -> Path:
        """Write the page; returns its path."""
        return write_page(self.page(), folder / PAGE)

    def headline(self) -> str:
        """The verdict in a sentence."""
        said = self._whole_verdict()
        return f"{said.word}: {said.headline}"

    def _whole_verdict(self) -> Verdict:
        """The verdict, and what the run leaves out."""
        said = self.verdict()
        if not self.left_out:
            return said
        return replace(said, headline=f"{said.headline} A quick run: left out are {self.left_out}.")

    def _unfinished(self) -> list[Text]:
        missing = [stage for stage in self.stages if stage not in self.finished]
        if not missing:
            return []
        said = f"Not reached, or not to its end: {words(missing)}."
        return [Text([said, *self.cut_short()], lead="The study was stopped early.")]


class Interruptible(Protocol):
    """What Ctrl-C may cut short, with what it has found so far: a search, a front, a calibration."""

    @property
    def interrupted(self) -> bool:
        """Whether it was cut short."""
        ...


def stop_if_interrupted(found: Interruptible) -> None:
    """End a stage where Ctrl-C has cut its work short; to be called once what was found is kept.

    Raises `KeyboardInterrupt`.
    """
    if found.interrupted:
        raise KeyboardInterrupt
