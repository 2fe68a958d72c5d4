"""`AbstractStudy`: the declaration of a case study; running, saving and the frame of its page follow.

Members are checked where they are used; refusals name the study's class and the member, such as `Filling.stages`.
"""

import abc
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar

from aleator._core.border import Progress, check_progress, members, one_of, positive, refusal, silent
from aleator._core.errors import AleatorError, ProblemError
from aleator.design import Problem
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
    provenance,
    savable,
    save_study,
    words,
    write_page,
)

Part = TypeVar("Part")

_TERMS = ("Term", "Meaning")


class Stage(NamedTuple):
    """A part of a study: its work, and its approximate duration relative to the other stages."""

    work: Callable[[Progress], None]
    share: float


class PartlySavedError(ProblemError):
    """Some results could not be saved; all others are in `paths`."""

    def __init__(self, message: str, paths: list[Path]):
        super().__init__(message)
        self.paths = paths


class Failure(NamedTuple):
    """The part of a study that failed, and why."""

    where: str
    why: str

    @classmethod
    def of(cls, where: str, error: Exception) -> "Failure":
        """A failure from its exception; the messages of our own exceptions suffice."""
        kind = "" if isinstance(error, AleatorError) else f"{type(error).__name__}: "
        return cls(where, f"{kind}{error}")

    def sentence(self) -> str:
        """The failure as a sentence for the page."""
        return f"In {self.where}: {self.why}"


class AbstractStudy(abc.ABC):
    """A case study: named stages that are run in order, and the presentation of their results.

    Results are saved after each stage; after the last one, an interruption or a failure, the page is written and the
    tables are printed. So each method must work with incomplete results. A page written after a failure says what
    failed and where, and recommends nothing.

    - `title`, `subtitle`: of the page;
    - `glossary`: its terms and their meanings;
    - `finished`: the completed stages;
    - `failed_parts`: what failed, and why.

    Its stages are run again on what is in a folder (`aleator resume`, `aleator report`): what takes long in them goes
    through a verb that a journal keeps, such as `solve` and `validate`, or through `aleator.extending.kept`.
    """

    title: str = "A case study"
    subtitle: str = ""
    glossary: ClassVar[Sequence[tuple[str, str]]] = ()
    finished: tuple[str, ...] = ()
    failed_parts: tuple[Failure, ...] = ()

    @property
    def problems(self) -> Mapping[str, Problem]:
        """The problems behind its designs by name, for `aleator check`, `sweep` and `validate`; none by default."""
        return {}

    @property
    def solving(self) -> Mapping[str, Any]:
        """How its problems are solved: arguments of `al.solve` by name, of its solver and transcription."""
        return {}

    @property
    def workers(self) -> int | None:
        """How many processes share its solves (`al.workers`); None if this one does all, as by default."""
        return None

    def with_workers(self, count: int) -> "AbstractStudy":
        """The same study, whose solves are shared by `count` processes. Raises `ProblemError` if it shares none."""
        raise ProblemError(
            f"--workers {count}: the study '{self.title}' solves in its own way, by this process: expected an "
            "`al.Study` or a study file. `aleator sweep` takes --workers for a front of any study."
        )

    @property
    @abc.abstractmethod
    def stages(self) -> Mapping[str, Stage]:
        """The stages by name, in order."""

    @abc.abstractmethod
    def results(self) -> Mapping[str, Any]:
        """The results in a form for `aleator.extending.save`: solutions, evidence, fronts, and mappings of these.

        Results not available yet are None or empty.
        """

    @abc.abstractmethod
    def verdict(self) -> Verdict:
        """The first screen of the page: what to build and why, from the results available so far."""

    @abc.abstractmethod
    def sections(self) -> Sequence[Section]:
        """The chapters of the page; those without blocks are omitted."""

    @abc.abstractmethod
    def tables(self) -> list[Table]:
        """The tables to print at the end."""

    @property
    def left_out(self) -> str:
        """The parts that this run skips to be quick, in words; empty by default."""
        return ""

    @property
    def unsolved(self) -> str:
        """What was asked for and has no solution, in a sentence: the command exits with 1. Empty by default."""
        return ""

    def cut_short(self) -> Iterator[str]:
        """Sentences on what is available of interrupted parts; none by default."""
        yield from ()

    def check_declaration(self) -> None:
        """Refuse an invalid declaration before anything is computed.

        Raises `ProblemError`, naming the study's class and the member.
        """
        name = type(self).__name__
        _check_stages(f"{name}.stages", self.stages)
        one_of(f"{name}.title", self.title, str)
        one_of(f"{name}.subtitle", self.subtitle, str)
        one_of(f"{name}.left_out", self.left_out, str)
        one_of(f"{name}.unsolved", self.unsolved, str)
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
        """Record a failure for the page, once."""
        failure = Failure.of(where, error)
        if failure.why not in [one.why for one in self.failed_parts]:
            self.failed_parts = (*self.failed_parts, failure)

    def save(self, folder: Path) -> list[Path]:
        """Write all results as netCDF and JSON files; returns their paths.

        Raises `ProblemError` for results that cannot be saved, after saving all others.
        """
        kept, refused = savable(*_asked(self, "results"))
        paths = list(save_study(folder, kept))
        if refused:
            raise PartlySavedError(f"{refused[0]} All other results are saved.", paths)
        return paths

    def page(self) -> Page:
        """The page as data: verdict, parts that this run did not reach, the study's chapters, and how to read them."""
        glossary = [Table("Glossary", _TERMS, self.glossary)] if self.glossary else []
        sections = [
            Section("This run", self._unfinished()),
            *_sections_of(self),
            provenance(savable(*_asked(self, "results"))[0]),
            Section("How to read this", [Text(HOW_TO_READ), *glossary]),
        ]
        return self._framed(self._whole_verdict(), [one for one in sections if one.blocks])

    def write_page(self, folder: Path) -> Path:
        """Write the page; returns its path."""
        return write_page(self.page(), folder / PAGE)

    def write_what_is_left(self, folder: Path) -> Path:
        """Write a page without the parts that fail, which are recorded as failures; returns its path."""
        verdict = _or_else(self._whole_verdict, self._no_verdict())
        sections = _or_else(lambda: [one for one in _sections_of(self) if one.blocks], [])
        unfinished = _or_else(self._unfinished, [])
        sections = [*([Section("This run", unfinished)] if unfinished else []), *sections]
        try:
            return write_page(self._framed(verdict, sections), folder / PAGE)
        except Exception:
            return write_page(self._framed(self._no_verdict(), []), folder / PAGE)

    def headline(self) -> str:
        """The verdict as a sentence."""
        said = self._no_verdict() if self.failed_parts else self._whole_verdict()
        return f"{said.word}: {said.headline}"

    def _framed(self, verdict: Verdict, sections: Sequence[Section]) -> Page:
        return Page(title=self.title, subtitle=self.subtitle, verdict=verdict, sections=sections, footer=footer())

    def _whole_verdict(self) -> Verdict:
        """The verdict, with the parts that a quick run skips. After a failure only its key numbers are kept."""
        said = _verdict_of(self)
        if self.failed_parts:
            return self._no_verdict(said.cards)
        if not self.left_out:
            return said
        return replace(said, headline=f"{said.headline} This was a quick run, without {self.left_out}.")

    def _no_verdict(self, cards: Sequence[Card] = ()) -> Verdict:
        headline = f"No recommendation after an error in {words([one.where for one in self.failed_parts])}."
        return Verdict("bad", "Failed", headline, [one.sentence() for one in self.failed_parts], cards)

    def _unfinished(self) -> list[Text]:
        missing = [stage for stage in self.stages if stage not in self.finished]
        if not missing:
            return []
        said = f"Not reached or not completed: {words(missing)}."
        return [Text([said, *_cut_short(self)], lead="The study was stopped early.")]


def _check_stages(what: str, value: Any) -> None:
    """Refuse what is not stages by name, in order."""
    expected = "a mapping of names to Stages, as a property"
    if not isinstance(value, Mapping) or not value:
        raise refusal(what, expected, value)
    for name, stage in value.items():
        one_of(f"{what}: the name of a stage", name, str)
        place = f"{what}: '{name}'"
        one_of(place, stage, Stage, "Stage(self.find, 1.0)")
        positive(f"{place}: share", stage.share)
        _takes_progress(f"{place}: work", stage.work)


def _takes_progress(what: str, work: Any) -> None:
    """Refuse work that cannot be called with its progress."""
    expected = "a function of one argument, the progress"
    if not callable(work):
        raise refusal(what, expected, work)
    try:
        inspect.signature(work).bind(silent)
    except TypeError as error:
        raise refusal(what, f"{expected} ({error})", work) from None
    except ValueError:  # what is not written in Python need not have a signature
        return


def _asked(study: object, member: str) -> tuple[str, Any]:
    """The result of a study's method, and its place in words.

    Exceptions in a study's own code pass through; our refusals are extended by the place.
    """
    what, method = f"{type(study).__name__}.{member}", getattr(study, member)
    if not callable(method):
        raise refusal(what, "a method", method)
    try:
        return what, method()
    except ProblemError as error:
        raise ProblemError(f"{what}: {error}") from error


def _verdict_of(study: object) -> Verdict:
    """A study's verdict."""
    what, value = _asked(study, "verdict")
    return one_of(what, value, Verdict)


def _sections_of(study: object) -> Sequence[Section]:
    """A study's sections."""
    what, value = _asked(study, "sections")
    return members(what, value, Section)


def tables_of(study: object) -> Sequence[Table]:
    """A study's tables."""
    what, value = _asked(study, "tables")
    return members(what, value, Table)


def _cut_short(study: object) -> list[str]:
    """A study's sentences on interrupted parts."""
    what, value = _asked(study, "cut_short")
    try:
        return list(members(what, list(value), str))
    except TypeError:
        raise refusal(what, "texts", value) from None


def _or_else(part: Callable[[], Part], otherwise: Part) -> Part:
    """A part of a page, or a substitute where a study's own code fails, which has been reported."""
    try:
        return part()
    except Exception:
        return otherwise


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
