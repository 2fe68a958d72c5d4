"""A run's folder: what began the run, so that `aleator resume FOLDER` goes on from it alone."""

import hashlib
import os
import re
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import final

import aleator
from aleator import studies
from aleator._core.border import content_of, json_of
from aleator._core.errors import AleatorError, ProblemError
from aleator.reporting import json_text, write_whole
from aleator.studies import AbstractStudy, SweptStudy

RECORD = "command.json"
"""The file in a run's folder that says what began it."""

_FILES = ".py", ".toml"


@final
@dataclass(frozen=True)
class Record:
    """The command that began a run.

    - `study`: its name, file or module, as given; `quick`: of `aleator run`;
    - `directory`: where the command was given; `beside`: the study's file, relative to the run's folder;
    - `workers`: processes that share the work, none if the study shall say;
    - `bound`, `values`, `design`: of `aleator sweep`; empty for `aleator run`;
    - `source`: a digest of the study's file and of the versions that computed; see `is_stale`.
    """

    study: str
    quick: bool = False
    directory: str = ""
    beside: str = ""
    bound: str = ""
    values: tuple[float, ...] = ()
    design: str = ""
    workers: int = 0
    source: str = ""

    @property
    def is_file(self) -> bool:
        """Whether the study is a file, not a name or a module."""
        return self.study.endswith(_FILES)

    @property
    def command(self) -> str:
        """The name of the command."""
        return "sweep" if self.bound else "run"

    def made(self) -> AbstractStudy:
        """The study, ready to run. Raises `ProblemError` if there is no such study, or none such."""
        study = studies.load(self.study, quick=self.quick)
        if not self.bound:
            return study.with_workers(self.workers) if self.workers else study
        return SweptStudy(study, self.bound, self.values, design=self.design or None, workers=self.workers or None)

    def check_owns(self, folder: Path) -> None:
        """Refuse a folder that another study has begun, or another sweep: its results would be replaced.

        Raises `ProblemError`; also where the folder does not say what began it.
        """
        if not (folder / RECORD).is_file():
            return
        other = _read(folder)
        if (self.bound, self.design) == (other.bound, other.design) and self._is_of_study(other, folder):
            return
        free = folder.with_name(f"{folder.name}-{Path(self.study).suffix[1:] if self.is_file else 'again'}")
        if self.bound and self.bound != other.bound:
            free = folder_over(folder, self.bound)
        raise ProblemError(
            f"The results of `{other}` are in '{folder}', and `{self}` would replace them: name another folder, "
            f"such as --out {free}, or remove that one."
        )

    def _is_of_study(self, other: "Record", folder: Path) -> bool:
        """Whether its study is that of another record, wherever the file of this one is now."""
        if not self.is_file or not other.is_file:
            return self.study == other.study
        places = [place.resolve() for place in other.places(folder) if place.is_file()]
        return Path(self.study).resolve() in places if places else Path(self.study).name == Path(other.study).name

    def places(self, folder: Path) -> list[Path]:
        """Where the study's file may be: as it was given, or as it lies from the run's folder."""
        return [Path(self.directory) / self.study, folder / self.beside]

    def __str__(self) -> str:
        bound = f" --bound {self.bound}" if self.bound else ""
        return f"aleator {self.command} {self.study}{bound}{f' --design {self.design}' if self.design else ''}"

    def write(self, folder: Path) -> "Record":
        """Note it in the run's folder, with the places from which the study can be found again, and its source.

        Returns it with these.
        """
        beside = ""
        if self.is_file:
            with suppress(ValueError):  # on another drive of Windows
                beside = os.path.relpath(Path(self.study).resolve(), folder.resolve())
        noted = replace(self, directory=str(Path.cwd()), beside=beside, source=_source(self.study))
        text = json_text({"command": self.command, **asdict(noted)})
        write_whole(folder / RECORD, lambda file: file.write_text(text, encoding="utf-8"))
        return noted


def folder_of(study: str) -> Path:
    """Where the results of a study go by default: `results/` and the last part of its name, file or module."""
    place = Path(study).stem if study.endswith(_FILES) else study.rpartition(":")[2]
    return Path("results") / place.rpartition(".")[2]


def folder_over(folder: Path, bound: str) -> Path:
    """Where a sweep goes by default: beside the results of its study."""
    of_the_bound = re.sub(r"[^\w.-]+", "-", bound).strip("-")
    return folder.with_name(f"{folder.name}-over-{of_the_bound}")


def is_stale(folder: Path) -> bool:
    """Whether the study of a folder has been edited since its run, or aleator or JAX has another version.

    No where the study has gone, or where the folder names none.
    """
    try:
        record = recorded(folder)
    except ProblemError:
        return False
    return record.source != _source(record.study)


def stale(folder: Path) -> str:
    """The sentence on a folder that is stale."""
    return (
        f"'{folder}' is stale: its study, or the version of aleator or JAX, has changed since the run. "
        f"`aleator resume {folder}` runs it again."
    )


def _source(study: str) -> str:
    """A digest of the text of a study's file or module, and of the versions; a case study is a part of aleator."""
    file = study if study.endswith(_FILES) else ""
    if not file and study not in studies.STUDIES:
        with suppress(ImportError, ValueError):
            file = getattr(find_spec(study.partition(":")[0]), "origin", "") or ""
    digest = hashlib.sha256(f"{aleator.__version__} {version('jax')} ".encode())
    with suppress(OSError):
        digest.update(content_of(file))
    return digest.hexdigest()


def study_of(folder: Path) -> tuple[AbstractStudy | None, str]:
    """The study that began the run of a folder; or none, and why, if it cannot be loaded any more.

    Modules beside its file can be imported from now on, also where the file has gone.
    """
    if not (folder / RECORD).is_file():
        return None, ""
    try:
        return recorded(folder).made(), ""
    except AleatorError as error:
        return None, f"{error}"


def recorded(folder: Path) -> Record:
    """What began the run of a folder, with the study's file where it is now; its modules can be imported from now on.

    Raises `ProblemError` if the folder does not say, or if the study's file has gone.
    """
    record = _read(folder)
    if not record.is_file:
        studies.importable(Path(record.directory))
        return record
    places = record.places(folder)
    for place in places:
        if place.is_file():
            return replace(record, study=str(place))
    studies.importable(*(place.parent for place in places if place.parent.is_dir()))
    raise ProblemError(
        f"The study of '{folder}' has gone: there is no file '{places[0]}', nor '{places[1]}'. Put it back, or run it "
        "where it is now, with --out for this folder."
    )


def _read(folder: Path) -> Record:
    """What began the run of a folder, as it was noted. Raises `ProblemError` if the folder does not say."""
    path = folder / RECORD
    try:
        data = json_of(content_of(path))
        noted = {field.name: type(field.default)(data[field.name]) for field in fields(Record)[1:]}
        return Record(f"{data['study']}", **{**noted, "values": tuple(map(float, data["values"]))})
    except FileNotFoundError:
        raise ProblemError(
            f"There is no '{RECORD}' in '{folder}': expected a folder that `aleator run` or `aleator sweep` has begun. "
            "Name the study instead, or run your script again."
        ) from None
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise ProblemError(
            f"'{path}' does not say what began the run ({type(error).__name__}: {error}): remove this file if you know "
            "it, and run the study by its name, with --out for this folder."
        ) from error
