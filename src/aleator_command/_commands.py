"""The subcommands of `aleator` with their arguments, help and examples; each is done by `aleator.cli`."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeAlias, cast, final

import typer
from typer.core import TyperGroup
from typing_extensions import override

from aleator_command._studies import STUDIES
from aleator_command._template import begin_file

_PAGE, _USAGE = "report.html", 2

# Click's `UsageError`, which some versions of typer take from click, and others have within themselves.
_UsageError = cast(type[typer.BadParameter], typer.BadParameter.__mro__[1])


@final
class _Commands(TyperGroup):
    """Subcommands. What typer itself refuses is told on stderr, and with `--json` on stdout as a document."""

    @override
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        ctx.meta["aleator.words"] = tuple(args)
        return super().parse_args(ctx, args)

    @override
    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except _UsageError as error:
            words = ctx.meta["aleator.words"]
            if "--json" in words:
                errors = [error.format_message()]
                typer.echo(json.dumps({"command": words[0], "exit_code": _USAGE, "errors": errors}))
            raise


application = typer.Typer(cls=_Commands, help="Optimal design of uncertain dynamical systems.", no_args_is_help=True)


def _command(name: str, *examples: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declare a subcommand with its examples, a paragraph each, so that none is joined to the next."""
    return application.command(name, epilog="\n\n".join([f"Example{'s'[: len(examples) - 1]}:", *examples]))


def _studies(incomplete: str) -> list[str]:
    """Names of studies, and study files, that begin with what was typed."""
    matches = Path().glob("*") if "/" not in incomplete else Path(incomplete.rpartition("/")[0]).glob("*")
    paths = [f"{path}/" if path.is_dir() else f"{path}" for path in matches]
    files = [path for path in paths if path.endswith(("/", ".py", ".toml"))]
    return sorted(name for name in [*STUDIES, *files] if name.startswith(incomplete))


_Study: TypeAlias = Annotated[
    str,
    typer.Argument(
        help="Name of a case study (see `aleator list`), or a file or module of your own.",
        autocompletion=_studies,
        show_default=False,
    ),
]
_StudyOrFolder: TypeAlias = Annotated[
    str, typer.Argument(help="A study, or a run's folder.", metavar="STUDY|FOLDER", autocompletion=_studies)
]
_Folder: TypeAlias = Annotated[Path, typer.Argument(help="A run's folder.", show_default=False)]
_AsJson: TypeAlias = Annotated[
    bool, typer.Option("--json", help="Print one JSON document on stdout, and all else on stderr.")
]
_Afresh: TypeAlias = Annotated[bool, typer.Option("--afresh", help="Compute everything anew.")]
_Workers: TypeAlias = Annotated[
    int | None,
    typer.Option("--workers", min=1, help="Processes that share the work.", show_default="as many as the study says"),
]
_Design: TypeAlias = Annotated[
    str | None, typer.Option("--design", help="Name of one of its designs.", show_default=False)
]


@_command("new", "aleator new bracket.py")
def _new(
    file: Annotated[Path, typer.Argument(help="Python file to write, such as bracket.py.", show_default=False)],
) -> None:
    """Begin a study of your own: write a commented file that runs as it is."""
    try:
        written = begin_file(file)
    except ValueError as error:
        typer.secho(f"error: {error}", err=True)
        raise typer.Exit(_USAGE) from None
    typer.echo(f"wrote {written}\nnext: aleator check {written}, then aleator run {written}")


@_command("check", "aleator check bracket.py", "aleator check suspension --json")
def _check(study: _Study, as_json: _AsJson = False) -> None:
    """Print what a study will do, before anything is spent: sizes, points, derivatives, times."""
    from aleator import cli

    cli.check(study, as_json)


@_command(
    "run",
    "aleator run suspension --quick",
    "aleator run bracket.py --out results/first",
    "aleator run bracket.toml --afresh",
    "aleator run bracket.py --workers 4",
    "aleator run package.module:problem --json",
)
def _run(
    study: _Study,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer samples and points: a first look in a minute.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the results.", show_default="results/STUDY")] = None,
    workers: _Workers = None,
    afresh: _Afresh = False,
    as_json: _AsJson = False,
) -> None:
    """Run a study: solve, check by Monte Carlo, sweep, and write the report.

    Each result is kept as soon as it is there: the same command goes on where a run was ended. Processes (--workers)
    share the points of fronts and the evidence along them.
    """
    from aleator import cli

    cli.run(study, quick=quick, out=out, workers=workers or 0, afresh=afresh, as_json=as_json)


@_command("resume", "aleator resume results/bracket", "aleator resume results/bracket --workers 2")
def _resume(folder: _Folder, workers: _Workers = None, as_json: _AsJson = False) -> None:
    """Go on with the run of a folder, whatever ended it: the folder says which study it was, and with which options.

    What is finished is taken from the folder, down to the last bit. As many processes share the work as before, or
    --workers.
    """
    from aleator import cli

    cli.resume(folder, workers or 0, as_json)


@_command(
    "sweep",
    "aleator sweep bracket.py --bound force --values 0.6,0.8,1",
    "aleator sweep clutch --bound rejects --values 0.01,0.001 --workers 2",
)
def _sweep(
    study: _Study,
    bound: Annotated[str, typer.Option(help="Name of the limit whose bound is varied.", show_default=False)],
    values: Annotated[str, typer.Option(help="Its bounds: numbers with commas between them.", show_default=False)],
    workers: _Workers = None,
    design: _Design = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results.", show_default="results/STUDY-over-BOUND")
    ] = None,
    afresh: _Afresh = False,
    as_json: _AsJson = False,
) -> None:
    """Solve one design of a study again for each value of a bound, and write the front with its page.

    The last design is taken if none is named. Each point is kept as soon as it is there.
    """
    from aleator import cli

    cli.sweep(study, bound, values, workers or 0, design or "", out=out, afresh=afresh, as_json=as_json)


@_command(
    "validate",
    "aleator validate results/bracket --samples 100000",
    "aleator validate bracket.py --seed 7 --design robust",
    "aleator validate results/bracket --samples 10000000 --workers 4",
)
def _validate(
    place: _StudyOrFolder,
    samples: Annotated[int, typer.Option(min=2, help="Fresh random systems for each design.")] = 20_000,
    seed: Annotated[int, typer.Option(min=0, help="Of the random systems.")] = 0,
    design: _Design = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes that simulate the systems.", show_default="this one")
    ] = None,
    as_json: _AsJson = False,
) -> None:
    """Count on fresh random systems how often designs break their limits, with 95 % intervals.

    Designs are taken from the folder (of a study: results/STUDY), and solved first where they are not there. A folder
    whose study has been edited since is refused. The evidence is kept there too; the study's page stays as it is.
    """
    from aleator import cli

    cli.validate(place, samples, seed, design, workers, as_json)


@_command("report", "aleator report results/bracket", "aleator report results/bracket --out so-far.html")
def _report(
    folder: _Folder,
    out: Annotated[
        Path | None, typer.Option(help="File for the page.", show_default=f"FOLDER/{_PAGE}", metavar="FILE")
    ] = None,
    as_json: _AsJson = False,
) -> None:
    """Write the page of what is in a run's folder, without computing anything, and say what is missing.

    Where the study's file has gone, or cannot be read any more, the page shows the designs that the folder keeps.

    Another process may be running there. A page that is there is not replaced by one from which something is missing:
    this one is written beside it, as report-so-far.html.
    """
    from aleator import cli

    cli.report(folder, out, as_json)


@_command("compare", "aleator compare results/first results/second")
def _compare(
    folders: Annotated[
        list[Path], typer.Argument(help="Runs' folders, two or more.", metavar="FOLDER FOLDER...", show_default=False)
    ],
    as_json: _AsJson = False,
) -> None:
    """Print the designs of several runs side by side, and in what they differ.

    Compared are decisions, objective, evidence with its intervals, constraints, and the problem with its equations, all
    down to the last digit.
    """
    from aleator import cli

    cli.compare(folders, as_json)


@_command("list", "aleator list", "aleator list results/bracket")
def _list(
    folder: Annotated[
        Path | None, typer.Argument(help="A run's folder, to list its results instead.", show_default=False)
    ] = None,
    as_json: _AsJson = False,
) -> None:
    """List the case studies, or the results in a run's folder with their states."""
    if folder is not None:
        from aleator import cli

        cli.list_results(folder, as_json)
    elif as_json:
        studies = [{"name": name, "about": about} for name, about in STUDIES.items()]
        typer.echo(json.dumps({"command": "list", "studies": studies, "exit_code": 0, "errors": []}, indent=2))
    else:
        width = max(map(len, STUDIES))
        typer.echo("\n".join(f"{name:<{width}}  {about}" for name, about in STUDIES.items()))


@_command("schema", "aleator schema > study.schema.json")
def _schema() -> None:
    """Print the JSON Schema of study files (.toml), by which editors complete and check them."""
    from aleator.studies import schema

    typer.echo(json.dumps(schema(), indent=2, ensure_ascii=False))
