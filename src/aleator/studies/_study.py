"""`AbstractStudy`: a case study is one chapter, read from top to bottom; `Draft`: the page that the chapter writes."""

import abc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, final, get_args

from typing_extensions import override

from aleator import reporting
from aleator._core.border import Progress, a_name, one_of, silent
from aleator._core.errors import AleatorError, ProblemError
from aleator.design import Problem
from aleator.nlp import Status
from aleator.reporting import Block, Page, Section, Table, Text, Verdict

_TERMS, _LEFT_OUT = ("Term", "Meaning"), "Left out"


class AbstractStudy(abc.ABC):
    """A case study: a title, the problems behind its designs, and a chapter that solves them and writes the page.

    - `title`, `subtitle`: of the page; `glossary`: its terms and their meanings;
    - `left_out`: the parts that a quick run skips, in words;
    - `problems`: those behind its designs by name, for `aleator check`, `sweep` and `validate`; `solving`: how they are
      solved, arguments of `al.solve` by name;
    - `workers`: how many processes share its solves (`al.workers`); None if this one does all.

    The chapter is run again on what is in a folder (`aleator resume`, `aleator report`): what takes long in it goes
    through a verb that a journal keeps, such as `solve` and `validate`, or through `aleator.extending.kept`.
    """

    title: str = "A case study"
    subtitle: str = ""
    glossary: Sequence[tuple[str, str]] = ()
    left_out: str = ""
    problems: Mapping[str, Problem] = MappingProxyType({})
    solving: Mapping[str, Any] = MappingProxyType({})
    workers: int | None = None

    @abc.abstractmethod
    def chapter(self, page: "Draft") -> None:
        """Solve, sample and sweep in the order of the page, and append what is found to it.

        Nothing in it deals with incomplete results: Ctrl-C and exceptions end it, and the page so far is written.
        """

    def with_workers(self, count: int) -> "AbstractStudy":
        """The same study, whose solves are shared by `count` processes. Raises `ProblemError` if it shares none."""
        raise ProblemError(
            f"--workers {count}: the study '{self.title}' has nothing to share among processes: expected `sweeps` or "
            "`wishes`, of an `al.Study` or a study file. A single solve takes all cores of the machine by itself."
        )

    def check_declaration(self) -> None:
        """Refuse an invalid declaration before anything is computed. Raises `ProblemError`, naming the member."""
        name = type(self).__name__
        for member in ("title", "subtitle", "left_out"):
            one_of(f"{name}.{member}", getattr(self, member), str)
        Table(f"{name}.glossary", _TERMS, self.glossary)


@final
class CaseStudy(AbstractStudy):
    """A study of the list: a module with `problems()`, `chapter(page, quick)`, and texts.

    - `TITLE`, `SUBTITLE`, `GLOSSARY`: of the page; `LEFT_OUT`: what a quick run skips.
    """

    def __init__(self, module: Any, *, quick: bool = False):
        self._module, self._quick = module, quick
        self.title, self.subtitle, self.glossary = module.TITLE, module.SUBTITLE, module.GLOSSARY
        self.left_out, self.problems = module.LEFT_OUT if quick else "", module.problems()

    @override
    def chapter(self, page: "Draft") -> None:
        self._module.chapter(page, self._quick)


def _unwatched(heading: str) -> None:
    """Nobody watches a section begin or end."""


@final
class Draft:
    """The page of a study in the making; it only grows, so that what is on it stands whatever ends the chapter.

    - `study`: whose page it is; `progress`: for the verbs that take one;
    - `kept`: results by name, as `aleator.extending.save` takes them; `tables`: those to print at the end;
    - `finished`: completed sections and steps; `present`: the one in work, empty between them;
    - `stopped`: whether Ctrl-C, or a result that is not there, ended the chapter; `failures`: a sentence for each
      exception;
    - `unsolved`: what has no solution, a sentence each: the command exits with 1.
    """

    def __init__(self, study: AbstractStudy):
        self.study, self._sections = study, list[Section]()
        self._recommended: Verdict | None = None
        self._begun = self._ended = _unwatched
        self.progress: Progress = silent
        self.kept: dict[str, Any] = {}
        self.tables, self.finished, self.failures = list[Table](), list[str](), list[str]()
        self.unsolved = list[str]()
        self.stopped, self.present = False, ""

    # --- What a chapter calls ------------------------------------------------------------------------------------

    def step(self, name: str) -> None:
        """Begin a part of the work, which ends the one before: a line of progress, nothing on the page."""
        if self.present:
            self.finished.append(self.present)
            self._ended(self.present)
        self.present = name
        if name:
            self._begun(name)

    def section(self, heading: str, *blocks: Block | str, folded: bool = False, printed: bool = False) -> None:
        """Begin a section, and a step of its name, with what is there already; a reader opens it if it is `folded`."""
        self.step(heading)
        self.append(Section(heading, [], folded))
        self.add(*blocks, printed=printed)

    def append(self, *sections: Section) -> None:
        """Append sections that are there already."""
        self._sections.extend(one_of("page.append", section, Section) for section in sections)

    def add(self, *blocks: Block | str, printed: bool = False) -> None:
        """Append texts, tables, figures to the present section; tables are `printed` on the terminal as well."""
        if not self._sections:
            self.section("Overview")
        for block in blocks:
            block = Text([block]) if isinstance(block, str) else one_of("page.add", block, get_args(Block), "a Table")
            self._sections[-1] = replace(self._sections[-1], blocks=[*self._sections[-1].blocks, block])
            if printed and isinstance(block, Table):
                self.tables.append(block)

    def keep(self, name: str, result: Any) -> None:
        """Keep a result under a name, or results by name, for the study's files.

        Raises `ProblemError` for what cannot be saved, and `KeyboardInterrupt` where Ctrl-C has cut a result short.
        """
        kept, refused = reporting.savable("page.keep", {a_name("page.keep: the name", name): result})
        self.kept = _joined(self.kept, kept)
        if refused:
            raise refused[0]
        for one in reporting.by_place(kept).values():  # verbs return what they have found until Ctrl-C
            if getattr(one, "interrupted", False) is True or getattr(one, "status", None) is Status.INTERRUPTED:
                raise KeyboardInterrupt

    def recommend(self, verdict: Verdict) -> None:
        """Say what to build, on the first screen; see `aleator.extending.recommendation`."""
        self._recommended = one_of("page.recommend", verdict, Verdict)

    # --- What a command calls ------------------------------------------------------------------------------------

    def fill(
        self,
        progress: Progress = silent,
        begun: Callable[[str], None] = _unwatched,
        ended: Callable[[str], None] = _unwatched,
    ) -> None:
        """Run the chapter; raises what ends it early, after noting that."""
        self.progress, self._begun, self._ended = progress, begun, ended
        try:
            self.study.check_declaration()
            self.study.chapter(self)
            self.step("")
        except KeyboardInterrupt:
            self.stopped = True
            raise
        except Exception as error:
            self.fail(f"'{self.present}'" if self.present else "the chapter", error)
            raise

    def fail(self, where: str, error: Exception) -> None:
        """Note a failure for the page, once; the messages of our own exceptions suffice."""
        kind = "" if isinstance(error, AleatorError) else f"{type(error).__name__}: "
        if not any(failure.endswith(f": {kind}{error}") for failure in self.failures):
            self.failures.append(f"In {where}: {kind}{error}")

    def stop(self) -> None:
        """Note that it was Ctrl-C that ended the chapter, where a library has made another exception of it."""
        self.stopped, self.failures = True, []

    def save(self, folder: Path) -> list[Path]:
        """Write all results as netCDF and JSON files; returns their paths. An earlier page is removed."""
        return list(reporting.save_all(folder, self.kept, reporting.PAGE))

    def write(self, folder: Path) -> Path:
        """Write the page; returns its path."""
        return reporting.write_page(self.page(), folder / reporting.PAGE)

    def headline(self) -> str:
        """The first screen in a sentence, with what is left out."""
        verdict = self._verdict()
        return " ".join(
            [f"{verdict.word}: {verdict.headline}", *(text for name, text in verdict.rows if name == _LEFT_OUT)]
        )

    def page(self) -> Page:
        """The page so far: the recommendation, how the run ended, the sections, and how to read them."""
        glossary = [Table("Glossary", _TERMS, self.study.glossary)] if self.study.glossary else []
        ended = Section("This run", [Text([self._end()])] if self.stopped or self.failures else [])
        about = self.study.title, self.study.subtitle, self._verdict()
        return reporting.whole_page(*about, [ended, *self._sections], self.kept, glossary)

    def _end(self) -> str:
        where = f" in '{self.present}'" if self.present else ""
        how = "An error ended the study" if self.failures else "The study was stopped early"
        return f"{how}{where}; what follows it is missing. `aleator resume` goes on from here."

    def _verdict(self) -> Verdict:
        """The recommendation; none after a failure, and none where the study was stopped before it."""
        if self.failures:
            return Verdict("bad", "Failed", "No recommendation, because of an error.", self.failures)
        if self._recommended is None:
            word, why = "No recommendation", "The study makes none."
            if self.stopped:
                word, why = "Stopped early", self._end()
            return Verdict("caution", word, f"Nothing to build yet. {why}")
        skipped = f"This was a quick run, without {self.study.left_out}."
        more = [(_LEFT_OUT, skipped)] if self.study.left_out else []
        return replace(self._recommended, rows=[*self._recommended.rows, *more])


def _joined(earlier: Mapping[str, Any], later: Mapping[str, Any]) -> dict[str, Any]:
    """Results by name, with later ones beside earlier ones of the same group."""
    joined = dict(earlier)
    for name, one in later.items():
        before = joined.get(name)
        joined[name] = _joined(before, one) if reporting.is_group(before) and reporting.is_group(one) else one
    return joined
