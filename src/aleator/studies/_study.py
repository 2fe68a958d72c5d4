"""`AbstractStudy`: what a case study declares; running, saving and the frame of its page follow."""

import abc
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from aleator._core.given import one_of, refusal
from aleator._core.progress import Progress, check_progress, silent
from aleator.reporting import (
    HOW_TO_READ,
    PAGE,
    Card,
    Page,
    Section,
    Table,
    Text,
    Verdict,
    footer,
    savable,
    save_study,
    words,
    write_page,
)
from aleator.studies import _declared
from aleator.studies._declared import Failure, PartlySavedError, Stage

Part = TypeVar("Part")

_TERMS = ("Term", "Meaning")


class AbstractStudy(abc.ABC):
    """A case study: named stages that are run in order, and what there is to say of whatever they have found.

    Results are saved after each stage; after the last one, an interruption or a failure, the page is written and the
    tables are printed. So each method works with what there is. A page that is written after a failure says what failed
    and where, and recommends nothing.

    - `title`, `subtitle`: of the page;
    - `glossary`: its terms and their meanings;
    - `finished`: the stages that have come to their end;
    - `failed_parts`: what failed, and why.
    """

    title: ClassVar[str] = "A case study"
    subtitle: ClassVar[str] = ""
    glossary: ClassVar[Sequence[tuple[str, str]]] = ()
    finished: tuple[str, ...] = ()
    failed_parts: tuple[Failure, ...] = ()

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

    def check_declaration(self) -> None:
        """Refuse what can be told to be wrong before anything is computed.

        Raises `ProblemError`, naming the study's class and the member.
        """
        name = type(self).__name__
        _declared.stages(f"{name}.stages", self.stages)
        one_of(f"{name}.title", self.title, str)
        one_of(f"{name}.subtitle", self.subtitle, str)
        one_of(f"{name}.left_out", self.left_out, str)
        Table(f"{name}.glossary", _TERMS, self.glossary)

    def run(self, stage: str, progress: Progress = silent) -> None:
        """Run one stage and keep its results."""
        self.check_declaration()
        check_progress(f"{type(self).__name__}.run", progress)
        if stage not in self.stages:
            raise refusal(f"{type(self).__name__}.run", f"one of the stages {words(list(self.stages))}", stage)
        try:
            self.stages[stage].work(progress)
        except Exception as error:
            self.note_failure(f"the stage '{stage}'", error)
            raise
        self.finished = (*self.finished, stage)

    def note_failure(self, where: str, error: Exception) -> None:
        """Keep what failed, for the page; each failure once."""
        failure = Failure.of(where, error)
        if failure.why not in [one.why for one in self.failed_parts]:
            self.failed_parts = (*self.failed_parts, failure)

    def save(self, folder: Path) -> list[Path]:
        """Write all results as netCDF and JSON files; returns their paths.

        Raises `ProblemError` for what cannot be saved, once all else is.
        """
        kept, refused = savable(*_declared.asked(self, "results"))
        paths = list(save_study(folder, kept))
        if refused:
            raise PartlySavedError(f"{refused[0]} All other results are saved.", paths)
        return paths

    def page(self) -> Page:
        """The page as data: verdict, what this run did not come to, the study's chapters, and how to read them."""
        glossary = [Table("Glossary", _TERMS, self.glossary)] if self.glossary else []
        sections = [
            Section("This run", self._unfinished()),
            *_declared.sections_of(self),
            Section("How to read this", [Text(HOW_TO_READ), *glossary]),
        ]
        return self._framed(self._whole_verdict(), [one for one in sections if one.blocks])

    def write_page(self, folder: Path) -> Path:
        """Write the page; returns its path."""
        return write_page(self.page(), folder / PAGE)

    def write_what_is_left(self, folder: Path) -> Path:
        """Write a page without what cannot be made of it, once that is among the failures; returns its path."""
        verdict = _or_else(self._whole_verdict, self._no_verdict())
        sections = _or_else(lambda: [one for one in _declared.sections_of(self) if one.blocks], [])
        unfinished = _or_else(self._unfinished, [])
        sections = [*([Section("This run", unfinished)] if unfinished else []), *sections]
        try:
            return write_page(self._framed(verdict, sections), folder / PAGE)
        except Exception:
            return write_page(self._framed(self._no_verdict(), []), folder / PAGE)

    def headline(self) -> str:
        """The verdict in a sentence."""
        said = self._no_verdict() if self.failed_parts else self._whole_verdict()
        return f"{said.word}: {said.headline}"

    def _framed(self, verdict: Verdict, sections: Sequence[Section]) -> Page:
        return Page(title=self.title, subtitle=self.subtitle, verdict=verdict, sections=sections, footer=footer())

    def _whole_verdict(self) -> Verdict:
        """The verdict, and what the run leaves out. After a failure there is none: its numbers alone are kept."""
        said = _declared.verdict_of(self)
        if self.failed_parts:
            return self._no_verdict(said.cards)
        if not self.left_out:
            return said
        return replace(said, headline=f"{said.headline} A quick run: left out are {self.left_out}.")

    def _no_verdict(self, cards: Sequence[Card] = ()) -> Verdict:
        headline = f"No recommendation after an error in {words([one.where for one in self.failed_parts])}."
        return Verdict("bad", "Failed", headline, [one.sentence() for one in self.failed_parts], cards)

    def _unfinished(self) -> list[Text]:
        missing = [stage for stage in self.stages if stage not in self.finished]
        if not missing:
            return []
        said = f"Not reached, or not to its end: {words(missing)}."
        return [Text([said, *_declared.cut_short(self)], lead="The study was stopped early.")]


def _or_else(part: Callable[[], Part], otherwise: Part) -> Part:
    """A part of a page, or what stands for it where a study's own code fails: that has been told."""
    try:
        return part()
    except Exception:
        return otherwise


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
