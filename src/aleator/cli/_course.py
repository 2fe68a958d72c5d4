"""The course of a study: its chapter, its results, its page and its tables, whatever ends it."""

import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, final

from aleator._core.border import one_of
from aleator._core.errors import AleatorError, ProblemError
from aleator._core.identity import joined
from aleator.cli._folder import RECORD, Record, is_stale
from aleator.cli._interruption import Interruptions
from aleator.cli._terminal import FAILED, USAGE, Terminal, shown
from aleator.journalling import Journal, journal
from aleator.reporting import KINDS, PAGE, by_place, check_writable, designs_document, only_writer, save_study, words
from aleator.solution import Solution
from aleator.studies import AbstractStudy, Draft
from aleator.sweep import Front, point_name
from aleator.validation import Evidence


def run_study(study: AbstractStudy, folder: str | Path) -> int:
    """Run your own study as `aleator run` runs the built-in ones; returns the exit code.

    The chapter runs with progress bars; the journal keeps each result as soon as it is there. Then, and on Ctrl-C,
    all results are saved into `folder`, the page is written and the tables are printed.
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
            study = one_of("run_study: the study", made(), AbstractStudy)
            study.check_declaration()
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
                record = record.write(folder)
        except ProblemError as error:
            terminal.complain("error", error)
            return USAGE
        try:
            code = course.execute(Draft(study), folder, results, record)
            if taken := len(results.taken):
                subject = "1 result was" if taken == 1 else f"{taken} results were"
                hint = "" if afresh is None else "; --afresh computes anew"
                terminal.tell(f"{subject} taken from an earlier run{hint}.")
            return code
        except BrokenPipeError:
            raise
        except Exception:  # a mistake in a study's own code, reported already, whose traceback follows
            terminal.print_document(FAILED)
            raise


@final
class _Course:
    """One run of a study, and its messages; until `execute` there is no page."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal
        self.interruptions = Interruptions(
            lambda: terminal.ended_at_once(self._last_words(), self.interruptions.exit_code)
        )
        self._page: Draft | None = None
        self._paths, self._complaints = list[Path](), list[str]()
        self._mistake: Exception | None = None

    def execute(self, page: Draft, folder: Path, results: Journal, record: Record | None) -> int:
        """Run the chapter, save its results, write the page, and print the tables; returns the exit code."""
        self._folder, self._journal, self._page, self._record = folder, results, page, record
        self._begin_step()
        with self._terminal.warning():
            code = self._run_through(page)
        if self._terminal.is_json:
            kept = by_place(page.kept)
            self._terminal.note(
                folder=str(folder),
                finished=page.finished,
                files=[str(path) for path in self._paths],
                title=page.study.title,
                verdict=page.headline(),
                designs=designs_document(page.kept),
                fronts={place: _front_document(one) for place, one in kept.items() if isinstance(one, Front)},
                recalled=len(results.taken),
            )
        return code

    def _run_through(self, page: Draft) -> int:
        code = self._attempt(page, "the chapter", self._fill)
        if page.finished or page.kept or page.failures:
            code = self._attempt(page, "saving", self._save) or code
            code = self._attempt(page, "the page", self._write_page) or code
        if not self._interrupted(code):
            self.interruptions.rest()
            code = self._attempt(page, "the last word", self._print_results) or code
        if self._interrupted(code):
            self.interruptions.conclude()
            self._terminal.last_words(self._last_words())
            return self.interruptions.exit_code
        if self._mistake is not None:
            raise self._mistake
        if page.unsolved and not code:
            self._terminal.complain("error", "; ".join(page.unsolved))
            return FAILED
        return code

    def _interrupted(self, code: int) -> bool:
        return self.interruptions.received is not None or code == self.interruptions.exit_code

    def _attempt(self, page: Draft, where: str, part: Callable[[Draft], None]) -> int:
        """Do a part of the run; returns the exit code. Failures are noted for the page and told once.

        One in a study's own code is raised again after writing, for its traceback.
        """
        try:
            part(page)
        except KeyboardInterrupt:
            return self.interruptions.exit_code
        except Exception as error:
            # Libraries may have turned an interrupt into another exception.
            if self.interruptions.received is not None:
                page.stop()
                return self.interruptions.exit_code
            if isinstance(error, BrokenPipeError):
                raise
            page.fail(where, error)
            said = f"{error}"
            if not isinstance(error, AleatorError | MemoryError | OSError):
                self._mistake = self._mistake or error
                said = f"{type(error).__name__}: {error}"
            if said not in self._complaints:
                self._complaints.append(said)
                self._terminal.complain(f"error{self._during()}", said)
            return FAILED
        return 0

    def _during(self) -> str:
        return f" during '{self._page.present}'" if self._page and self._page.present else ""

    def _last_words(self) -> str:
        """What an interrupted run has saved."""
        if self._page is None:
            return "Interrupted: no part was finished; nothing was written."
        present, finished = self._page.present, self._page.finished
        more = self._available() - self._before if present else 0
        saved = [f"'{name}'" for name in finished]
        if more > 0:
            saved.append(f"{more} result{'s' if more > 1 else ''} of '{present}'")
        none = "" if finished else "no part was finished; "
        if not saved:
            return f"Interrupted{self._during()}: {none}nothing was written."
        verb = "are" if len(saved) > 1 or more > 1 else "is"
        report = ", without a report" if finished and PAGE not in [path.name for path in self._paths] else ""
        return f"Interrupted{self._during()}: {none}{words(saved)} {verb} kept in {self._folder}{report}."

    def _available(self) -> int:
        return sum(entry.is_finished for entry in self._journal.entries)

    def _begin_step(self) -> None:
        self._before, self._started = self._available(), time.perf_counter()
        self._counts = self._journal.recalled, self._journal.begun

    def _fill(self, page: Draft) -> None:
        with shown(self._terminal.console, None) as progress, self.interruptions.work():

            def begun(name: str) -> None:
                self._begin_step()
                progress.begin(name)

            def ended(name: str) -> None:
                self._name_results(page)
                progress.end(name, self._step_in_words())

            page.fill(progress.show, begun, ended)

    def _step_in_words(self) -> str:
        """How a step came to its end: by computing, or with results of an earlier run."""
        recalled, begun = self._journal.recalled - self._counts[0], self._journal.begun - self._counts[1]
        if recalled and not begun:
            return "recalled from an earlier run"
        part = f", {recalled} of {recalled + begun} recalled" if recalled else ""
        return f"{time.perf_counter() - self._started:.1f} s{part}"

    def _name_results(self, page: Draft) -> None:
        """Let the journal know what the study calls its results, for `aleator validate` and `al.load`.

        Points of fronts have the names that they had while they were waiting: none of an earlier run has these now.
        """
        results = by_place(page.kept)
        points = [
            (point_name(front.bound, value), point)
            for front in results.values()
            if isinstance(front, Front)
            for value, point in zip(front.values.tolist(), front.points, strict=True)
            if isinstance(point, Solution)
        ]
        often = Counter(name for name, _ in points)  # without what several fronts call so
        designs = {place: result for place, result in results.items() if isinstance(result, Solution | Evidence)}
        # The last name is that of the result: what a study calls a design comes before its place along a front.
        self._journal.call({name: one for name, one in points if often[name] == 1} | dict(reversed(designs.items())))

    def _save(self, page: Draft) -> None:
        self._name_results(page)
        # What a study keeps follows from its source and its journal, unless it was ended or has datasets of its own.
        is_whole = not (page.stopped or page.failures) and self._record is not None
        follows = is_whole and all(isinstance(result, KINDS) for result in by_place(page.kept).values())
        contents = self._journal.contents() if follows else ""
        self._paths = page.save(self._folder, contents and joined([f"{self._record!r}", contents]))

    def _write_page(self, page: Draft) -> None:
        """Write the page, never beside results of an earlier run."""
        self._paths = [*(self._paths or save_study(self._folder, {})), page.write(self._folder)]

    def _print_results(self, page: Draft) -> None:
        for table in page.tables:
            self._terminal.table(table)
        self._terminal.title(page.headline())
        for path in dict.fromkeys(self._paths):
            if path.exists():
                self._terminal.tell(f"wrote {path}")


def _front_document(front: Front) -> dict[str, Any]:
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
