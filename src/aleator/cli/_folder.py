"""A run's folder: what began the run, so that `aleator resume FOLDER` goes on from it alone."""

import hashlib
import os
import re
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
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
    - `workers`: processes that share the work, None if the study shall say;
    - `bound`, `values`, `design`: of `aleator sweep`;
    - `source`: a digest of the study's file and of the versions that computed; see `staleness`.
    """

    study: str
    quick: bool = False
    directory: str = ""
    beside: str = ""
    bound: str = ""
    values: tuple[float, ...] = ()
    design: str | None = None
    workers: int | None = None
    source: str = ""

    @classmethod
    def of(cls, folder: Path) -> "Record":
        """What began the run of a folder, as it was noted. Raises `ProblemError` if the folder does not say."""
        path = folder / RECORD
        try:
            noted = json_of(content_of(path))
            return cls(**{**noted, "values": tuple(noted["values"])})
        except FileNotFoundError:
            raise ProblemError(
                f"There is no '{RECORD}' in '{folder}': expected a folder that `aleator run` or `aleator sweep` has "
                "begun. Name the study instead, or run your script again."
            ) from None
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise ProblemError(
                f"'{path}' does not say what began the run ({type(error).__name__}: {error}): remove this file, and "
                "run the study by its name, with --out for this folder."
            ) from error

    @property
    def is_file(self) -> bool:
        """Whether the study is a file, not a name or a module."""
        return self.study.endswith(_FILES)

    def __str__(self) -> str:
        bound = f" --bound {self.bound}" if self.bound else ""
        design = f" --design {self.design}" if self.design else ""
        return f"aleator {'sweep' if self.bound else 'run'} {self.study}{bound}{design}"

    @property
    def folder(self) -> Path:
        """Where its results go by default: `results/bracket`, or `results/bracket-over-mass` for a sweep.

        The last part of the study's name, file or module counts.
        """
        study = Path(self.study).stem if self.is_file else self.study.rpartition(":")[2]
        name = f"{study.rpartition('.')[2]}{f'-over-{self.bound}' if self.bound else ''}"
        return Path("results") / re.sub(r"[^\w.-]+", "-", name).strip("-")

    def made(self) -> AbstractStudy:
        """The study, ready to run. Raises `ProblemError` if there is no such study, or none such."""
        study = studies.load(self.study, quick=self.quick)
        if self.bound:
            return SweptStudy(study, self.bound, self.values, design=self.design, workers=self.workers)
        return study if self.workers is None else study.with_workers(self.workers)

    def located(self, folder: Path) -> "Record":
        """The same, with the study's file where it is now; its modules can be imported from now on.

        Raises `ProblemError` if it has gone.
        """
        if not self.is_file:
            studies.importable(Path(self.directory))
            return self
        places = self._places(folder)
        for place in places:
            if place.is_file():
                return replace(self, study=str(place))
        studies.importable(*(place.parent for place in places if place.parent.is_dir()))
        raise ProblemError(
            f"The study of '{folder}' has gone: there is no file '{places[0]}', nor '{places[1]}'. Put it back, or run "
            "it where it is now, with --out for this folder."
        )

    def _places(self, folder: Path) -> list[Path]:
        """Where the study's file may be: as it was given, or as it lies from the run's folder."""
        return [Path(self.directory) / self.study, folder / self.beside]

    def check_owns(self, folder: Path) -> None:
        """Refuse a folder that another study has begun, or another sweep: its results would be replaced.

        Raises `ProblemError`; also where the folder does not say what began it.
        """
        if not (folder / RECORD).is_file():
            return
        other, own = Record.of(folder), Path(self.study)
        is_same = self.study == other.study
        if self.is_file and other.is_file:  # wherever it is now
            places = [place.resolve() for place in other._places(folder) if place.is_file()]
            is_same = own.resolve() in places if places else own.name == Path(other.study).name
        if not is_same or (self.bound, self.design) != (other.bound, other.design):
            raise ProblemError(
                f"The results of `{other}` are in '{folder}', and `{self}` would replace them: name another folder by "
                "--out, or remove that one."
            )

    def write(self, folder: Path) -> None:
        """Note it in the run's folder, with the places from which the study can be found again, and its source."""
        beside = ""
        if self.is_file:
            with suppress(ValueError):  # on another drive of Windows
                beside = os.path.relpath(Path(self.study).resolve(), folder.resolve())
        noted = replace(self, directory=str(Path.cwd()), beside=beside, source=_source(self.study))
        text = json_text(asdict(noted))
        write_whole(folder / RECORD, lambda file: file.write_text(text, encoding="utf-8"))


def staleness(folder: Path) -> str:
    """A sentence if the study of a folder has been edited since its run, or aleator or JAX has another version.

    Empty where that is not so, where the study has gone, and where the folder names none.
    """
    try:
        record = Record.of(folder).located(folder)
    except ProblemError:
        return ""
    if record.source == _source(record.study):
        return ""
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
        return Record.of(folder).located(folder).made(), ""
    except AleatorError as error:
        return None, f"{error}"
