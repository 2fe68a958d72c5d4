"""The course of a study: stages in order, saved one by one, its page and its tables, whatever ends it."""

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, final

from aleator._core.border import one_of
from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._folder import RECORD, Record, is_stale
from aleator.cli._interruption import Interruptions
from aleator.cli._progress import shown
from aleator.cli._terminal import FAILED, USAGE, Terminal
from aleator.journalling import Journal, journal
from aleator.reporting import (
    PAGE,
    Table,
    by_place,
    check_writable,
    designs_document,
    only_writer,
    savable,
    save_study,
    words,
)
from aleator.solution import Solution
from aleator.studies import AbstractStudy, PartlySavedError, tables_of
from aleator.sweep import Front, point_name
from aleator.validation import Evidence


def run_study(study: AbstractStudy, folder: str | Path) -> int:
    """Run your own study as `aleator run` runs the built-in ones; returns the exit code.

    Stages run in order, with progress bars. Finished results are saved into `folder` after each stage, and on Ctrl-C;
    then the page is written and the tables are printed.
    """
    return executed(Terminal("run"), lambda: study, Path(folder))


def executed(
    terminal: Terminal,
    made: Callable[[], AbstractStudy],
    out: Path,
    *,
    afresh: bool | None = None,
    record: Record | None = None,
) -> int:
    """Make a study and run it while no other run writes into its folder, which notes the command that began it.

    `afresh`: whether to compute everything anew; None for a command without this option.
    Returns the exit code.
    """
    course = _Course(terminal)
    with ExitStack() as held:
        held.enter_context(course.interruptions)
        try:
            job = one_of("run_study: the study", made(), AbstractStudy)
            job.check_declaration()
            folder = check_writable(out)
            held.enter_context(only_writer(folder))
            if record is not None:
                record.check_owns(folder)
            results = held.enter_context(journal(folder, afresh=bool(afresh)))
            if is_stale(folder):  # so that no design of an earlier form goes by the name of this run's
                results.append(*(replace(entry, name="") for entry in results.entries if entry.name))
            if record is None:
                (folder / RECORD).unlink(missing_ok=True)
            else:
                record.write(folder)
        except ProblemError as error:
            terminal.complain("error", error)
            return USAGE
        try:
            code = course.execute(job, folder, results)
            if taken := len(results.taken):
                subject = "1 result was" if taken == 1 else f"{taken} results were"
                hint = "" if afresh is None else "; --afresh computes anew"
                terminal.tell(f"{subject} taken from an earlier run{hint}.")
            return code
        except BrokenPipeError:
            raise
        except OSError as error:
            terminal.complain("error", error)
            return FAILED
        except Exception:  # a mistake in a study's own code, reported already, whose traceback follows
            terminal.print_document(FAILED)
            raise


@final
class _Course:
    """One run of a study: its finished stages, which are on disk, and its messages."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal
        self.interruptions = Interruptions(self._end_at_once)
        self._stage, self._folder = "", Path()
        self._finished, self._paths, self._reduced = list[str](), list[Path](), list[Path]()
        self._tables: Sequence[Table] = ()
        self._complaints = list[str]()
        self._mistake: Exception | None = None
        # How many results the journal has, and had before the present stage.
        self._count: Callable[[], int] = lambda: 0
        self._before = 0

    def execute(self, job: AbstractStudy, folder: Path, results: Journal) -> int:
        """Run all stages, saving after each, write the page, and print the tables; returns the exit code."""
        self._folder, self._journal = folder, results
        self._count = lambda: sum(entry.is_finished for entry in results.entries)
        with self._terminal.warning():
            code = self._run_through(job)
        self._terminal.note(**self._facts(job), recalled=len(results.taken))
        return code

    def _run_through(self, job: AbstractStudy) -> int:
        code = self._attempt(job, "saving", lambda: self._run_stages(job))
        code = self._attempt(job, "the tables", lambda: self._ask_tables(job)) or code
        if self._finished or self._tables or job.failed_parts:
            code = self._attempt(job, "saving", lambda: self._save_rest(job)) or code
            code = self._attempt(job, "the page", lambda: self._write_page(job)) or code
        if not self._interrupted(code):
            self.interruptions.rest()
            code = self._attempt(job, "the last word", lambda: self._print_results(job)) or code
        if not self._interrupted(code):
            if self._mistake is not None:
                raise self._mistake
            return self._judged(job, code)
        self.interruptions.conclude()
        self._terminal.last_words(self._last_words())
        return self.interruptions.exit_code

    def _judged(self, job: AbstractStudy, code: int) -> int:
        """The exit code of a run that went through: that of a failure where something has no solution."""
        if code or not job.unsolved:
            return code
        self._terminal.complain("error", job.unsolved)
        return FAILED

    def _interrupted(self, code: int) -> bool:
        return self.interruptions.received is not None or code == self.interruptions.exit_code

    def _attempt(self, job: AbstractStudy, where: str, part: Callable[[], None]) -> int:
        """Do a part of the run; returns the exit code. The study records failures for its page."""
        try:
            part()
        except KeyboardInterrupt:
            return self.interruptions.exit_code
        except Exception as error:
            # Libraries may have turned an interrupt into another exception.
            if self.interruptions.received is not None:
                job.failed_parts = ()
                return self.interruptions.exit_code
            if isinstance(error, BrokenPipeError):
                raise
            job.note_failure(where, error)
            self._tell(error)
            return FAILED
        return 0

    def _tell(self, error: Exception) -> None:
        """Report an error, once. One in a study's own code is raised again after writing, for its traceback."""
        said = f"{error}"
        if not isinstance(error, AleatorError | MemoryError | OSError):
            self._mistake = self._mistake or error
            said = f"{type(error).__name__}: {error}"
        if said not in self._complaints:
            self._complaints.append(said)
            self._terminal.complain(f"error{self._during()}", said)

    def _during(self) -> str:
        return f" during '{self._stage}'" if self._stage else ""

    def _last_words(self) -> str:
        """What an interrupted run has saved."""
        more = self._count() - self._before if self._stage else 0
        saved = [f"'{name}'" for name in self._finished]
        if more > 0:
            saved.append(f"{more} result{'s' if more > 1 else ''} of '{self._stage}'")
        none = "" if self._paths else "no stage was finished; "
        if none and not saved:
            return f"Interrupted{self._during()}: {none}nothing was written."
        verb = "are" if len(saved) > 1 or more > 1 else "is"
        report = ", without a report" if self._paths and PAGE not in [path.name for path in self._paths] else ""
        subject = words(saved, "what was found")
        return f"Interrupted{self._during()}: {none}{subject} {verb} kept in {self._folder}{report}."

    def _end_at_once(self) -> str:
        return self._terminal.ended_at_once(self._last_words(), self.interruptions.exit_code)

    def _run_stages(self, job: AbstractStudy) -> None:
        total = sum(stage.share for stage in job.stages.values())
        with shown(self._terminal.console, total) as progress:
            for name, stage in job.stages.items():
                self._stage, started, self._before = name, time.perf_counter(), self._count()
                recalled, begun = self._journal.recalled, self._journal.begun
                progress.begin(name)
                with self.interruptions.work():
                    job.run(name, progress.show)
                self._save(job, [*self._finished, name])
                counts = self._journal.recalled - recalled, self._journal.begun - begun
                progress.end(name, stage.share, _duration(time.perf_counter() - started, *counts))
        self._stage = ""

    def _save(self, job: AbstractStudy, finished: list[str]) -> None:
        try:
            self._paths, self._finished = job.save(self._folder), finished
        except PartlySavedError as error:
            self._paths, self._finished = error.paths, finished
            raise
        results = by_place(job.results())
        designs = {place: result for place, result in results.items() if isinstance(result, Solution | Evidence)}
        # The last name is that of the result: what a study calls a design comes before its place along a front.
        self._journal.call({**_points(results), **dict(reversed(designs.items()))})

    def _ask_tables(self, job: AbstractStudy) -> None:
        self._tables = tables_of(job)

    def _save_rest(self, job: AbstractStudy) -> None:
        """Save the results of a stage that was not completed."""
        if len(self._finished) < len(job.stages):
            self._save(job, self._finished)

    def _write_page(self, job: AbstractStudy) -> None:
        """Write the page, never beside results of an earlier run; a reduced one where the study's own fails."""
        if not self._paths:
            self._paths = list(save_study(self._folder, {}))
        try:
            page = job.write_page(self._folder)
        except Exception as error:
            if self.interruptions.received is None:
                job.note_failure("the page", error)
                self._reduced = [job.write_what_is_left(self._folder)]
                self._paths = [*self._paths, *self._reduced]
            raise
        self._paths = [*self._paths, page]

    def _print_results(self, job: AbstractStudy) -> None:
        for table in self._tables:
            self._terminal.table(table)
        self._terminal.title(job.headline())
        for path in dict.fromkeys(self._paths):
            if path.exists():
                self._terminal.tell(f"wrote {path}{', without the parts that failed' if path in self._reduced else ''}")

    def _facts(self, job: AbstractStudy) -> Mapping[str, Any]:
        """The run for its JSON document, whatever of it is there."""
        if not self._terminal.is_json:
            return {}
        facts = {"folder": str(self._folder), "finished": self._finished, "files": [str(path) for path in self._paths]}
        return {**facts, **_facts(job)}


def _points(results: Mapping[str, Any]) -> dict[str, Solution]:
    """The points of fronts by the names that they had while they were waiting: none of an earlier run has these now.

    Without what several fronts call so.
    """
    named = [
        (point_name(front.bound, value), point)
        for front in results.values()
        if isinstance(front, Front)
        for value, point in zip(front.values.tolist(), front.points, strict=True)
        if isinstance(point, Solution)
    ]
    often = Counter(name for name, _ in named)
    return {name: point for name, point in named if often[name] == 1}


def _duration(seconds: float, recalled: int, begun: int) -> str:
    """How a stage came to its end: by computing, or with results of an earlier run."""
    if not recalled:
        return f"{seconds:.1f} s"
    return f"{seconds:.1f} s, {recalled} of {recalled + begun} recalled" if begun else "recalled from an earlier run"


def _facts(job: AbstractStudy) -> dict[str, Any]:
    """A study's verdict, designs and fronts, whatever of them is available."""
    try:
        results, verdict = savable("results", job.results())[0], job.headline()
    except ProblemError:  # reported already, where it was saved and printed
        results, verdict = {}, None
    named = {"title": job.title, "verdict": verdict}
    fronts = {place: _front_facts(front) for place, front in by_place(results).items() if isinstance(front, Front)}
    return {**named, "designs": designs_document(results), "fronts": fronts}


def _front_facts(front: Front) -> dict[str, Any]:
    """A front, point by point."""
    columns = zip(front.values, front.points, front.objectives, front.shadow_prices, front.violations, strict=True)
    return {
        "bound": front.bound,
        "interrupted": front.interrupted,
        "points": [
            {
                "value": value,
                "status": point.status.value,
                "objective": objective,
                "shadow_price": price,
                "violation": violation,
                "decisions": dict(point.decisions) if isinstance(point, Solution) and point.ok else {},
                "why": None if point.ok else point.why(),
            }
            for value, point, objective, price, violation in columns
        ],
    }
