"""The command line: `aleator list`, `aleator new FILE`, `aleator check STUDY` and `aleator run STUDY`.

Exit codes: 0 success, 1 a solve, a simulation or writing failed, 2 wrong usage, 130 interrupted, 143 terminated.
Finished results are written in every case.
"""

import json
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, final

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table as RichTable
from rich.text import Text

from aleator._core.errors import AleatorError, AleatorWarning, ProblemError
from aleator._core.given import one_of
from aleator._core.interruption import Interruptions
from aleator.journalling import forget, journal
from aleator.journalling import load as load_results
from aleator.reporting import PAGE, Table, check_writable, only_writer, save_study, words
from aleator.studies import STUDIES, AbstractStudy, Check, PartlySavedError, Study, begin_file, load, schema, tables_of

FAILED, USAGE = 1, 2

application = typer.Typer(
    help="Optimal design of uncertain dynamical systems.", no_args_is_help=True, add_completion=False
)


@application.command("list")
def list_studies(
    folder: Annotated[
        Path | None, typer.Argument(help="A run's folder, to list its results instead.", show_default=False)
    ] = None,
) -> None:
    """List the case studies, or the results in a run's folder with their states."""
    if folder is not None:
        try:
            _console().print(f"{load_results(folder)}", soft_wrap=True)
        except ProblemError as error:
            _console(stderr=True).print(Text.assemble(("error", "bold red"), f": {error}"), soft_wrap=True)
            raise typer.Exit(USAGE) from None
        return
    table = RichTable("study", "about", box=None)
    for name, entry in STUDIES.items():
        table.add_row(name, entry.about)
    _console().print(table)


@application.command()
def new(
    file: Annotated[Path, typer.Argument(help="Python file to write, such as bracket.py.", show_default=False)],
) -> None:
    """Begin a study of your own: write a commented file that runs as it is."""
    try:
        written = begin_file(file)
    except (ProblemError, OSError) as error:
        _console(stderr=True).print(Text.assemble(("error", "bold red"), f": {error}"))
        raise typer.Exit(USAGE) from None
    console = _console()
    console.print(f"wrote {written}", soft_wrap=True)
    console.print(f"next: aleator check {written}, then aleator run {written}", soft_wrap=True)


@application.command()
def check(
    study: Annotated[str, typer.Argument(help="Python file with a study of your own.")],
) -> None:
    """Print what a study will do, before anything is spent: sizes, points, derivatives, times."""
    with ExitStack() as held:
        course = _Run()
        held.enter_context(course.interruptions)
        try:
            looked = Check(one_of("check: the study", load(study), Study, "a file with problems, or an al.Study"))
            table, troubles = looked.table()
        except (AleatorError, OSError) as error:
            course.complain("error", f"{error}")
            raise typer.Exit(USAGE) from None
        console = _console()
        for one in looked.mathematics():
            console.print(Text(one.heading, style="bold"))
            console.print(one.text, soft_wrap=True)
        console.print(_rich(table))
        for one in troubles:
            console.print(Text.assemble(("look at", "bold yellow"), f": {one}"), soft_wrap=True)


@application.command("schema")
def print_schema() -> None:
    """Print the JSON Schema of study files (.toml), by which editors complete and check them."""
    typer.echo(json.dumps(schema(), indent=2, ensure_ascii=False))


@application.command()
def run(
    study: Annotated[str, typer.Argument(help="Name of a case study (see `aleator list`), or a file of your own.")],
    quick: Annotated[bool, typer.Option("--quick", help="Fewer samples and points: a first look in a minute.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the results.", show_default="results/STUDY")] = None,
    afresh: Annotated[bool, typer.Option("--afresh", help="Compute everything anew.")] = False,
) -> None:
    """Run a study: solve, check by Monte Carlo, sweep, and write the report.

    Each result is kept as soon as it is there: the same command goes on where a run was ended.
    """
    folder = out if out is not None else Path("results") / _folder_name(study)
    raise typer.Exit(_executed(lambda: load(study, quick=quick), folder, afresh=afresh))


def _folder_name(study: str) -> str:
    """The last part of a study's name, file or module."""
    place = Path(study).stem if study.endswith((".py", ".toml")) else study.rpartition(":")[2]
    return place.rpartition(".")[2]


def run_study(study: AbstractStudy, folder: str | Path) -> int:
    """Run your own study as `aleator run` runs the built-in ones; returns the exit code.

    Stages run in order, with progress bars. Finished results are saved into `folder` after each stage, and on Ctrl-C;
    then the page is written and the tables are printed.
    """
    return _executed(lambda: study, Path(folder))


def _executed(loaded: Callable[[], AbstractStudy], out: Path, *, afresh: bool = False) -> int:
    """Load a study and run it while no other run writes into its folder; returns the exit code."""
    course = _Run()
    with ExitStack() as held:
        held.enter_context(course.interruptions)
        try:
            job = one_of("run_study: the study", loaded(), AbstractStudy)
            job.check_declaration()
            folder = check_writable(out)
            held.enter_context(only_writer(folder))
            if afresh:
                forget(folder)
            kept = held.enter_context(journal(folder))
        except ProblemError as error:
            course.complain("error", error)
            return USAGE
        try:
            code = course.execute(job, folder)
            if kept.recalled:
                course.tell(f"{kept.recalled} results were taken from an earlier run; --afresh computes them anew.")
            return code
        except BrokenPipeError:
            raise
        except OSError as error:
            course.complain("error", error)
            return FAILED


@final
class _Run:
    """One run of a study: its finished stages, which are on disk, and its messages."""

    def __init__(self) -> None:
        self._console, self._errors = _console(), _console(stderr=True)
        self.interruptions = Interruptions(self._last_words)
        self._stage, self._folder = "", Path()
        self._finished, self._paths = list[str](), list[Path]()
        self._tables: Sequence[Table] = ()
        self._told = list[str]()
        self._mistake: Exception | None = None

    def execute(self, job: AbstractStudy, folder: Path) -> int:
        """Run all stages, saving after each, write the page, and print the tables; returns the exit code.

        Our warnings are shown to the user as sentences, without their place in the code.
        """
        with warnings.catch_warnings():
            elsewhere = warnings.showwarning

            def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
                if issubclass(category, AleatorWarning):
                    self._errors.print(Text.assemble(("warning", "bold yellow"), f": {message}"), soft_wrap=True)
                else:
                    elsewhere(message, category, *place)

            warnings.showwarning = show
            return self._run_through(job, folder)

    def _run_through(self, job: AbstractStudy, folder: Path) -> int:
        self._folder = folder
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
            return code
        self.interruptions.conclude()
        self._errors.print(self._last_words(), soft_wrap=True)
        return self.interruptions.exit_code

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
        if said not in self._told:
            self._told.append(said)
            self.complain(f"error{self._during()}", said)

    def _during(self) -> str:
        return f" during '{self._stage}'" if self._stage else ""

    def tell(self, said: str) -> None:
        """Print a sentence."""
        self._console.print(said, soft_wrap=True)

    def complain(self, what: str, error: Exception | str) -> None:
        """Print an error."""
        self._errors.print(Text.assemble((what, "bold red"), f": {error}"), soft_wrap=True)

    def _last_words(self) -> str:
        """What an interrupted run has saved."""
        if not self._paths:
            return f"Interrupted{self._during()}: no stage was finished; nothing was written."
        kept = words([f"'{name}'" for name in self._finished], "what was found")
        verb = "are" if len(self._finished) > 1 else "is"
        report = "" if PAGE in [path.name for path in self._paths] else ", without a report"
        return f"Interrupted{self._during()}: {kept} {verb} kept in {self._folder}{report}."

    def _run_stages(self, job: AbstractStudy) -> None:
        columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn())
        clocks = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
        with Progress(*columns, *clocks, console=self._console) as bars:
            overall = bars.add_task("all stages", total=sum(stage.share for stage in job.stages.values()))
            for name, stage in job.stages.items():
                self._stage, started = name, time.perf_counter()
                with self.interruptions.work():
                    _run_stage(job, name, bars)
                self._save(job, [*self._finished, name])
                self._console.print(f"{name}: {time.perf_counter() - started:.1f} s")
                bars.advance(overall, stage.share)
        self._stage = ""

    def _save(self, job: AbstractStudy, finished: list[str]) -> None:
        try:
            self._paths, self._finished = job.save(self._folder), finished
        except PartlySavedError as error:
            self._paths, self._finished = error.paths, finished
            raise

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
                self._paths = [*self._paths, job.write_what_is_left(self._folder)]
            raise
        self._paths = [*self._paths, page]

    def _print_results(self, job: AbstractStudy) -> None:
        for table in self._tables:
            self._console.print(_rich(table))
        self._console.print(Text(job.headline(), style="bold"))
        for path in self._paths:
            self._console.print(f"wrote {path}", soft_wrap=True)


def _run_stage(job: AbstractStudy, stage: str, bars: Progress) -> None:
    """Run one stage, with a bar for the work inside it that is removed at the end."""
    inner = bars.add_task(f"  {stage}", total=None)

    def show(task: str, done: int, total: int) -> None:
        bars.update(inner, description=f"  {stage}: {task}", completed=done, total=total)

    job.run(stage, show)
    bars.remove_task(inner)


def _console(*, stderr: bool = False) -> Console:
    """A console that prints text literally, without markup."""
    return Console(stderr=stderr, markup=False, emoji=False, highlight=False)


def _rich(table: Table) -> RichTable:
    """A table of a report for the terminal."""
    shown = RichTable(*table.header, title=table.caption, caption=table.note, caption_justify="left")
    for row in table.rows:
        shown.add_row(*map(str, row))
    return shown


def main() -> None:
    """Entry point of the command, after the package is imported."""
    application()
