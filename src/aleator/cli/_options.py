"""Arguments and options that commands share."""

import re
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from aleator.studies import STUDIES


def names_of_studies(incomplete: str) -> list[str]:
    """Names of studies, and study files, that begin with what was typed."""
    files = [*Path().glob(f"{_literal(incomplete)}*")] if not Path(incomplete).is_absolute() else []
    own = [f"{one}/" if one.is_dir() else f"{one}" for one in files if one.is_dir() or one.suffix in (".py", ".toml")]
    return sorted([name for name in STUDIES if name.startswith(incomplete)] + own)


def _literal(text: str) -> str:
    return "".join(f"[{one}]" if one in "*?[" else one for one in text)


STUDY_HELP = "Name of a case study (see `aleator list`), or a file or module of your own."

StudyName: TypeAlias = Annotated[
    str, typer.Argument(help=STUDY_HELP, autocompletion=names_of_studies, show_default=False)
]
StudyOrFolder: TypeAlias = Annotated[
    str,
    typer.Argument(
        help="A study, or a run's folder.", metavar="STUDY|FOLDER", autocompletion=names_of_studies, show_default=False
    ),
]
Folder: TypeAlias = Annotated[Path, typer.Argument(help="A run's folder.", show_default=False)]
AsJson: TypeAlias = Annotated[
    bool, typer.Option("--json", help="Print one JSON document on stdout, and all else on stderr.")
]
Afresh: TypeAlias = Annotated[bool, typer.Option("--afresh", help="Compute everything anew.")]
Workers: TypeAlias = Annotated[
    int | None,
    typer.Option("--workers", min=1, help="Processes that share the work.", show_default="as many as the study says"),
]
Design: TypeAlias = Annotated[
    str | None, typer.Option("--design", help="Name of one of its designs.", show_default=False)
]


def folder_of(study: str) -> Path:
    """Where the results of a study go by default: `results/` and the last part of its name, file or module."""
    place = Path(study).stem if study.endswith((".py", ".toml")) else study.rpartition(":")[2]
    return Path("results") / place.rpartition(".")[2]


def folder_over(folder: Path, bound: str) -> Path:
    """Where a sweep goes by default: beside the results of its study."""
    of_the_bound = re.sub(r"[^\w.-]+", "-", bound).strip("-")
    return folder.with_name(f"{folder.name}-over-{of_the_bound}")
