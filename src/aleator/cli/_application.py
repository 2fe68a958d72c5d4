"""The `aleator` command: its subcommands, their order, and the examples that `--help` shows."""

from collections.abc import Callable

import typer

from aleator.cli._check import check
from aleator.cli._commands import Commands
from aleator.cli._compare import compare
from aleator.cli._list import list_studies
from aleator.cli._new import new
from aleator.cli._report import report
from aleator.cli._resume import resume
from aleator.cli._run import run
from aleator.cli._schema import print_schema
from aleator.cli._sweep import sweep
from aleator.cli._validate import validate

application = typer.Typer(cls=Commands, help="Optimal design of uncertain dynamical systems.", no_args_is_help=True)

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
