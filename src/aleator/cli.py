"""The command line: `aleator list` and `aleator run STUDY`.

Exit codes: 0 done, 1 a solve or a simulation failed, 2 wrong usage, 130 interrupted. Finished results are written in
every case.
"""

import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table as RichTable

from aleator._core.errors import AleatorError, ProblemError
from aleator.report import Table, check_writable
from aleator.studies import STUDIES, AbstractStudy, load

FAILED, USAGE, INTERRUPTED = 1, 2, 130

application = typer.Typer(
    help="Optimal design of uncertain dynamical systems.", no_args_is_help=True, add_completion=False
)


@application.command("list")
def list_studies() -> None:
    """List the case studies."""
    table = RichTable("study", "about", box=None)
    for name, entry in STUDIES.items():
        table.add_row(name, entry.about)
    Console().print(table)


@application.command()
def run(
    study: Annotated[str, typer.Argument(help="Name of the study: see `aleator list`.")],
    quick: Annotated[bool, typer.Option("--quick", help="Fewer samples and points: a first look in a minute.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the results.", show_default="results/STUDY")] = None,
) -> None:
    """Run a case study: solve, check by Monte Carlo, sweep, and write the report."""
    console, errors = Console(), Console(stderr=True)
    try:
        job = load(study, quick=quick)
        folder = check_writable(out if out is not None else Path("results") / study)
    except ProblemError as error:
        errors.print(f"[bold red]error:[/] {error}", highlight=False)
        raise typer.Exit(USAGE) from None
    code = _run_stages(job, folder, console, errors)
    _print_results(job, console)
    raise typer.Exit(_write_results(job, folder, console, errors) or code)


def _run_stages(job: AbstractStudy, folder: Path, console: Console, errors: Console) -> int:
    """Run all stages, saving after each; returns the exit code."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    bars = Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=console)
    with bars:
        overall = bars.add_task("all stages", total=sum(job.stages.values()))
        for stage, share in job.stages.items():
            try:
                _run_stage(job, stage, bars)
                job.save(folder)
            except KeyboardInterrupt:
                errors.print(f"Interrupted during '{stage}'; what was finished before is kept.")
                return INTERRUPTED
            except AleatorError as error:
                errors.print(f"[bold red]error[/] during '{stage}': {error}", highlight=False)
                return FAILED
            bars.advance(overall, share)
    return 0


def _write_results(job: AbstractStudy, folder: Path, console: Console, errors: Console) -> int:
    """Write files and report; returns the exit code."""
    try:
        for path in [*job.save(folder), job.write_page(folder)]:
            console.print(f"wrote {path}", highlight=False, soft_wrap=True)
    except AleatorError as error:
        errors.print(f"[bold red]error:[/] {error}", highlight=False)
        return FAILED
    return 0


def _run_stage(job: AbstractStudy, stage: str, bars: Progress) -> None:
    """Run one stage, with a bar for the work inside it that is removed at the end."""
    inner, started = bars.add_task(f"  {stage}", total=None), time.perf_counter()

    def show(task: str, done: int, total: int) -> None:
        bars.update(inner, description=f"  {stage}: {task}", completed=done, total=total)

    job.run(stage, show)
    bars.remove_task(inner)
    bars.console.print(f"{stage}: {time.perf_counter() - started:.1f} s", highlight=False)


def _print_results(job: AbstractStudy, console: Console) -> None:
    for table in job.tables():
        console.print(_rich(table))
    console.print(f"[bold]{job.headline()}[/]", highlight=False)


def _rich(table: Table) -> RichTable:
    """A report's table for the terminal."""
    header = map(escape, table.header)
    shown = RichTable(*header, title=escape(table.caption), caption=escape(table.note), caption_justify="left")
    for row in table.rows:
        shown.add_row(*map(escape, row))
    return shown


def main() -> None:
    """Entry point of the `aleator` command."""
    application()
