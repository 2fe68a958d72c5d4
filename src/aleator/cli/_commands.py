"""The `aleator` command: its subcommands and their examples. Those of some length are in modules of their own."""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast, final

import typer
from rich.table import Table as RichTable
from typer.core import TyperGroup
from typing_extensions import override

from aleator import studies
from aleator._core.border import refusal
from aleator.cli._course import executed
from aleator.cli._folder import Record, folder_of, folder_over, is_stale, recorded, stale
from aleator.cli._interruption import Interruptions
from aleator.cli._pages import compare, report
from aleator.cli._terminal import USAGE, Afresh, AsJson, Design, Folder, StudyName, Terminal, Workers
from aleator.cli._validate import validate
from aleator.journalling import Entry, examined, listing, names_of
from aleator.studies import STUDIES, Check, begin_file, schema


def new(
    file: Annotated[Path, typer.Argument(help="Python file to write, such as bracket.py.", show_default=False)],
) -> None:
    """Begin a study of your own: write a commented file that runs as it is."""
    terminal = Terminal("new")
    with terminal.refusing():
        written = begin_file(file)
    terminal.tell(f"wrote {written}")
    terminal.tell(f"next: aleator check {written}, then aleator run {written}")


def check(study: StudyName, as_json: AsJson = False) -> None:
    """Print what a study will do, before anything is spent: sizes, points, derivatives, times."""
    terminal = Terminal("check", as_json)
    interruptions = Interruptions(lambda: terminal.ended_at_once("Interrupted.", interruptions.exit_code))
    with interruptions, terminal.refusing():
        checked = Check(studies.load(study))
    for problem in checked.mathematics():
        terminal.title(problem.heading)
        terminal.tell(problem.text)
    if (numbers := checked.numbers()) is not None:
        terminal.table(numbers)
    terminal.table(checked.table())
    for trouble in checked.troubles:
        terminal.look_at(trouble)
    terminal.note(study=study, problems=checked.document(), look_at=checked.troubles)
    terminal.conclude(0)


def run(
    study: StudyName,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer samples and points: a first look in a minute.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the results.", show_default="results/STUDY")] = None,
    workers: Workers = None,
    afresh: Afresh = False,
    as_json: AsJson = False,
) -> None:
    """Run a study: solve, check by Monte Carlo, sweep, and write the report.

    Each result is kept as soon as it is there: the same command goes on where a run was ended. Processes (--workers)
    share the points of fronts and the evidence along them.
    """
    terminal, record = Terminal("run", as_json), Record(study, quick=quick, workers=workers or 0)
    terminal.conclude(executed(terminal, record.made, out or folder_of(study), afresh=afresh, record=record))


def resume(folder: Folder, workers: Workers = None, as_json: AsJson = False) -> None:
    """Go on with the run of a folder, whatever ended it: the folder says which study it was, and with which options.

    What is finished is taken from the folder, down to the last bit. As many processes share the work as before, or
    --workers.
    """
    terminal = Terminal("resume", as_json)
    with terminal.refusing():
        record = recorded(folder)
        record = replace(record, workers=workers or record.workers)
    terminal.conclude(executed(terminal, record.made, folder, record=record))


def sweep(
    study: StudyName,
    bound: Annotated[str, typer.Option(help="Name of the limit whose bound is varied.", show_default=False)],
    values: Annotated[str, typer.Option(help="Its bounds: numbers with commas between them.", show_default=False)],
    workers: Workers = None,
    design: Design = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results.", show_default="results/STUDY-over-BOUND")
    ] = None,
    afresh: Afresh = False,
    as_json: AsJson = False,
) -> None:
    """Solve one design of a study again for each value of a bound, and write the front with its page.

    The last design is taken if none is named. Each point is kept as soon as it is there.
    """
    terminal = Terminal("sweep", as_json)
    with terminal.refusing():
        record = Record(study, bound=bound, values=_numbers(values), design=design or "", workers=workers or 0)
    folder = out or folder_over(folder_of(study), bound)
    terminal.conclude(executed(terminal, record.made, folder, afresh=afresh, record=record))


def _numbers(text: str) -> tuple[float, ...]:
    """Numbers with commas between them. Raises `ProblemError` for anything else."""
    try:
        return tuple(float(number) for number in text.split(",") if number.strip())
    except ValueError:
        raise refusal("sweep: --values", "numbers with commas between them, such as 1,1.2,1.4", text) from None


def list_studies(
    folder: Annotated[
        Path | None, typer.Argument(help="A run's folder, to list its results instead.", show_default=False)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the case studies, or the results in a run's folder with their states."""
    terminal = Terminal("list", as_json)
    if folder is None:
        _tell_studies(terminal)
    else:
        with terminal.refusing():
            entries = examined(folder)
        names, is_edited = names_of(entries), is_stale(folder)
        terminal.tell(listing(folder, entries))
        if is_edited:
            terminal.look_at(stale(folder))
        results = [_row(entry, names.get(entry.key)) for entry in entries]
        terminal.note(folder=str(folder), stale=is_edited, results=results)
    terminal.conclude(0)


def _tell_studies(terminal: Terminal) -> None:
    table = RichTable("study", "about", box=None)
    for name, entry in STUDIES.items():
        table.add_row(name, entry.about)
    terminal.console.print(table)
    terminal.note(studies=[{"name": name, "about": entry.about} for name, entry in STUDIES.items()])


def _row(entry: Entry, name: str | None) -> dict[str, Any]:
    return {
        "name": entry.name,
        "load": name,
        "what": entry.what,
        "state": entry.state.value,
        "why": entry.why,
        "file": entry.file,
        "host": entry.host,
        "process": entry.process,
        "since": entry.since,
        "seconds": entry.seconds or None,
    }


def print_schema() -> None:
    """Print the JSON Schema of study files (.toml), by which editors complete and check them."""
    typer.echo(json.dumps(schema(), indent=2, ensure_ascii=False))


# Click's `UsageError`, which some versions of typer take from click, and others have within themselves.
_UsageError = cast(type[typer.BadParameter], typer.BadParameter.__mro__[1])


_WORDS = "aleator.words"


@final
class _Commands(TyperGroup):
    """Subcommands. What typer itself refuses is told on stderr, and on stdout as a document."""

    @override
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        ctx.meta[_WORDS] = words = tuple(args)
        with _documented(words):
            return super().parse_args(ctx, args)

    @override
    def invoke(self, ctx: Any) -> Any:
        with _documented(ctx.meta[_WORDS]):
            return super().invoke(ctx)


@contextmanager
def _documented(words: Sequence[str]) -> Iterator[None]:
    try:
        yield
    except _UsageError as error:
        command = next((word for word in words if not word.startswith("-")), "")
        Terminal(command, "--json" in words).print_refusal(error.format_message(), USAGE)
        raise


application = typer.Typer(cls=_Commands, help="Optimal design of uncertain dynamical systems.", no_args_is_help=True)

_COMMANDS: dict[str, tuple[Callable[..., None], tuple[str, ...]]] = {
    "new": (new, ("aleator new bracket.py",)),
    "check": (check, ("aleator check bracket.py", "aleator check suspension --json")),
    "run": (
        run,
        (
            "aleator run suspension --quick",
            "aleator run bracket.py --out results/first",
            "aleator run bracket.toml --afresh",
            "aleator run bracket.py --workers 4",
            "aleator run package.module:problem --json",
        ),
    ),
    "resume": (resume, ("aleator resume results/bracket", "aleator resume results/bracket --workers 2")),
    "sweep": (
        sweep,
        (
            "aleator sweep bracket.py --bound force --values 0.6,0.8,1",
            "aleator sweep clutch --bound rejects --values 0.01,0.001 --workers 2",
        ),
    ),
    "validate": (
        validate,
        (
            "aleator validate results/bracket --samples 100000",
            "aleator validate bracket.py --seed 7 --design robust",
            "aleator validate results/bracket --samples 10000000 --workers 4",
        ),
    ),
    "report": (report, ("aleator report results/bracket", "aleator report results/bracket --out so-far.html")),
    "compare": (compare, ("aleator compare results/first results/second",)),
    "list": (list_studies, ("aleator list", "aleator list results/bracket")),
    "schema": (print_schema, ("aleator schema > study.schema.json",)),
}


def _examples(lines: tuple[str, ...]) -> str:
    """Examples for `--help`, a paragraph each, so that none is joined to the next."""
    return "\n\n".join([f"{'Example' if len(lines) == 1 else 'Examples'}:", *lines])


for _name, (_command, _lines) in _COMMANDS.items():
    application.command(_name, epilog=_examples(_lines))(_command)


def main() -> None:
    """Entry point of the command, after the package is imported."""
    application()
