"""The subcommands of `aleator` as a table: what each is for, examples, and its arguments."""

import argparse
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, TypeAlias, final

from typing_extensions import override

Argument: TypeAlias = tuple[tuple[str, ...], dict[str, Any]]


class Command(NamedTuple):
    """A subcommand: its help, a paragraph each, examples, and its arguments."""

    about: Sequence[str]
    examples: Sequence[str]
    arguments: Sequence[Argument]


class UsageError(Exception):
    """Arguments that are refused, with the `usage` of the command."""

    def __init__(self, message: str, usage: str = ""):
        super().__init__(message)
        self.usage = usage


@final
class _Parser(argparse.ArgumentParser):
    """Refuses by an exception."""

    def __init__(self, **how: Any):
        super().__init__(**how, allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter)
        self._negative_number_matcher = re.compile(r"-[\d.]")  # so that --values -1,0 is no option

    @override
    def error(self, message: str) -> NoReturn:
        raise UsageError(message, self.format_usage())


def parsed(words: Sequence[str]) -> dict[str, Any]:
    """The arguments of a command, with its name as `command`. Raises `UsageError`."""
    parser = _Parser(prog="aleator", description="Optimal design of uncertain dynamical systems.")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, command in COMMANDS.items():
        about = "\n\n".join(textwrap.fill(paragraph, 100) for paragraph in command.about)
        examples = "\n  ".join(["examples:", *command.examples])
        summary = command.about[0].replace("%", "%%")
        own = commands.add_parser(name, help=summary, description=about, epilog=examples)
        for names, how in command.arguments:
            own.add_argument(*names, **how)
    return vars(parser.parse_args(words))


def _argument(*names: str, **how: Any) -> Argument:
    return names, how


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(number) for number in text.split(",") if number.strip())
    except ValueError:
        raise argparse.ArgumentTypeError(
            "expected numbers with commas between them, in the unit of the limit: 1,1.2"
        ) from None


_STUDY = _argument("study", help="name of a case study (see `aleator list`), or a file or module of your own")
_FOLDER = _argument("folder", type=Path, help="a run's folder")
_DESIGN = _argument("--design", metavar="NAME", help="name of one of its designs")
_OUT = _argument("--out", type=Path, metavar="FOLDER", help="folder for the results (a folder in results/)")
_WORKERS = _argument("--workers", type=int, metavar="COUNT", help="processes that share the work")
_AFRESH = _argument("--afresh", action="store_true", help="compute everything anew")
_JSON = _argument(
    "--json", dest="as_json", action="store_true", help="print one JSON document on stdout, and all else on stderr"
)

COMMANDS = {
    "new": Command(
        ["Begin a study of your own: write a commented file that runs as it is."],
        ["aleator new bracket.py"],
        [_argument("file", type=Path, help="Python file to write, such as bracket.py")],
    ),
    "check": Command(
        ["Print what a study will do, before anything is spent: sizes, points, derivatives, times."],
        ["aleator check bracket.py", "aleator check suspension --json"],
        [_STUDY, _JSON],
    ),
    "run": Command(
        [
            "Run a study: solve, check by Monte Carlo, sweep, and write the report.",
            "Each result is kept as soon as it is there: the same command goes on where a run was ended. Processes "
            "(--workers) share the points of fronts and the evidence along them.",
        ],
        [
            "aleator run suspension --quick",
            "aleator run bracket.py --out results/first",
            "aleator run bracket.toml --afresh",
            "aleator run bracket.py --workers 4",
            "aleator run package.module:problem --json",
        ],
        [
            _STUDY,
            _argument("--quick", action="store_true", help="fewer samples and points: a first look in a minute"),
            _OUT,
            _WORKERS,
            _AFRESH,
            _JSON,
        ],
    ),
    "resume": Command(
        [
            "Go on with the run of a folder, whatever ended it: the folder says which study it was, and with which "
            "options.",
            "What is finished is taken from the folder, down to the last bit. As many processes share the work as "
            "before, or --workers.",
        ],
        ["aleator resume results/bracket", "aleator resume results/bracket --workers 2"],
        [_FOLDER, _WORKERS, _JSON],
    ),
    "sweep": Command(
        [
            "Solve one design of a study again for each value of a bound, and write the front with its page.",
            "The last design is taken if none is named. Each point is kept as soon as it is there.",
        ],
        [
            "aleator sweep bracket.py --bound force --values 0.6,0.8,1",
            "aleator sweep clutch --bound rejects --values 0.01,0.001 --workers 2",
        ],
        [
            _STUDY,
            _argument("--bound", required=True, metavar="NAME", help="name of the limit whose bound is varied"),
            _argument(
                "--values",
                required=True,
                type=_numbers,
                metavar="NUMBERS",
                help="its bounds: numbers with commas between them",
            ),
            _DESIGN,
            _OUT,
            _WORKERS,
            _AFRESH,
            _JSON,
        ],
    ),
    "validate": Command(
        [
            "Count on fresh random systems how often designs break their limits, with 95 % intervals.",
            "Designs are taken from the folder (of a study: results/STUDY), and solved first where they are not there. "
            "A folder whose study has been edited since is refused. The evidence is kept there too; the study's page "
            "stays as it is.",
        ],
        [
            "aleator validate results/bracket --samples 100000",
            "aleator validate bracket.py --seed 7 --design robust",
            "aleator validate results/bracket --samples 10000000 --workers 4",
        ],
        [
            _argument("place", metavar="STUDY|FOLDER", help="a study, or a run's folder"),
            _argument(
                "--samples", type=int, default=20_000, metavar="COUNT", help="random systems for each design (20000)"
            ),
            _argument("--seed", type=int, default=0, metavar="NUMBER", help="of the random systems (0)"),
            _DESIGN,
            _WORKERS,
            _JSON,
        ],
    ),
    "report": Command(
        [
            "Write the page of a run from what is in its folder, without computing anything, and say what is missing.",
            "Another process may be running there. A page that is there is not replaced by one from which something is "
            "missing: this one is written beside it, as report-so-far.html.",
        ],
        ["aleator report results/bracket", "aleator report results/bracket --out so-far.html"],
        [
            _FOLDER,
            _argument("--out", type=Path, metavar="FILE", help="file for the page (report.html in the folder)"),
            _JSON,
        ],
    ),
    "compare": Command(
        [
            "Print the designs of several runs side by side, and in what they differ.",
            "Compared are decisions, objective, evidence with its intervals, constraints, and the problem with its "
            "equations, all down to the last digit.",
        ],
        ["aleator compare results/first results/second"],
        [_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="runs' folders, two or more"), _JSON],
    ),
    "list": Command(
        ["List the case studies, or the results in a run's folder with their states."],
        ["aleator list", "aleator list results/bracket"],
        [_argument("folder", nargs="?", type=Path, help="a run's folder, to list its results instead"), _JSON],
    ),
    "schema": Command(
        ["Print the JSON Schema of study files (.toml), by which editors complete and check them."],
        ["aleator schema > study.schema.json"],
        [],
    ),
}
