"""A run's folder: what began the run, so that `aleator resume FOLDER` goes on from it alone."""

import hashlib
import os
import re
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import final

import aleator
from aleator import studies
from aleator._core.border import content_of, json_of
from aleator._core.errors import ProblemError
from aleator._core.identity import own_files
from aleator.reporting import json_text, write_whole
from aleator.studies import AbstractStudy, SweptStudy

RECORD = "command.json"
"""The file in a run's folder that says what began it."""


@final
@dataclass(frozen=True)
class Record:
    """The command that began a run.

    - `study`: its name, file or module; a file is noted by its path from the run's folder, so that both may move;
    - `quick`: of `aleator run`; `directory`: where the command was given, from which modules are imported;
    - `workers`: processes that share the work, None if the study shall say;
    - `bound`, `values`, `design`: of `aleator sweep`;
    - `files`: those of the study and of the modules that it imports, by their paths from the run's folder; `source`: a
      digest of these and of the versions that computed; see `staleness`.
    """

    study: str
    quick: bool = False
    directory: str = ""
    bound: str = ""
    values: tuple[float, ...] = ()
    design: str | None = None
    workers: int | None = None
    files: tuple[str, ...] = ()
    source: str = ""

    @classmethod
    def of(cls, folder: Path) -> "Record":
        """What began the run of a folder, as it was noted; modules beside its study can be imported from now on.

        Raises `ProblemError` if the folder does not say.
        """
        try:
            noted = json_of(content_of(folder / RECORD))
            files = tuple(str((folder / file).resolve()) for file in noted["files"])
            record = cls(**{**noted, "values": tuple(noted["values"]), "files": files})
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise ProblemError(
                f"There is no '{RECORD}' in '{folder}' that says what began its run ({error}): name the study instead, "
                "with --out for this folder, or run your script again."
            ) from error
        if record.is_file:
            record = replace(record, study=str((folder / record.study).resolve()))
        studies.importable(Path(record.study).parent if record.is_file else Path(record.directory))
        return record

    def write(self, folder: Path) -> None:
        """Note it in the run's folder, with what finds the study again, and its source; the study has been made."""

        def moving(file: str) -> str:
            with suppress(ValueError):  # on another drive of Windows
                return os.path.relpath(Path(file).resolve(), folder.resolve())
            return file

        files = {str(file): None for file in ([Path(self.study).resolve()] if self.is_file else []) + own_files()}
        noted = replace(self, files=tuple(files), directory=str(Path.cwd()))
        paths = {"study": moving(self.study) if self.is_file else self.study, "files": [*map(moving, files)]}
        text = json_text(asdict(noted) | paths | {"source": noted.content()})
        write_whole(folder / RECORD, lambda file: file.write_text(text, encoding="utf-8"))

    @property
    def is_file(self) -> bool:
        """Whether the study is a file, not a name or a module."""
        return self.study.endswith((".py", ".toml"))

    @property
    def folder(self) -> Path:
        """Where its results go by default: `results/bracket`, or `results/bracket-over-mass` for a sweep.

        The last part of the study's name, file or module counts.
        """
        study = Path(self.study).stem if self.is_file else self.study.rpartition(":")[2]
        name = f"{study.rpartition('.')[2]}{f'-over-{self.bound}' if self.bound else ''}"
        return Path("results") / re.sub(r"[^\w.-]+", "-", name).strip("-")

    def __str__(self) -> str:
        bound = f" --bound {self.bound}" if self.bound else ""
        design = f" --design {self.design}" if self.design else ""
        return f"aleator {'sweep' if self.bound else 'run'} {self.study}{bound}{design}"

    def made(self) -> AbstractStudy:
        """The study, ready to run. Raises `ProblemError` if there is no such study, or none such."""
        study = studies.load(self.study, quick=self.quick)
        if self.bound:
            return SweptStudy(study, self.bound, self.values, design=self.design, workers=self.workers)
        return study if self.workers is None else study.with_workers(self.workers)

    def check_owns(self, folder: Path) -> None:
        """Refuse a folder that another study has begun, or another sweep: its results would be replaced.

        Where the file of that study has gone, it may be this one, of its name. Raises `ProblemError`.
        """
        if not (folder / RECORD).is_file():
            return
        other, own = Record.of(folder), Path(self.study)
        is_same = self.study == other.study
        if self.is_file and other.is_file:
            there = Path(other.study)
            is_same = own.resolve() == there.resolve() if there.is_file() else own.name == there.name
        if not is_same or (self.bound, self.design) != (other.bound, other.design):
            raise ProblemError(
                f"The results of `{other}` are in '{folder}', and `{self}` would replace them: name another folder by "
                "--out, or remove that one."
            )

    def content(self) -> str:
        """A digest of the texts of its files, and of versions."""
        digest = hashlib.sha256(f"{aleator.__version__} {version('jax')} ".encode())
        for file in self.files:
            with suppress(OSError):
                digest.update(content_of(file))
        return digest.hexdigest()


def staleness(folder: Path) -> str:
    """A sentence if the study of a folder, or a module that it imports, has been edited since its run, or aleator or
    JAX has another version.

    Empty where that is not so, where the study's file has gone, and where the folder names no study.
    """
    if not (folder / RECORD).is_file():
        return ""
    record = Record.of(folder)
    if record.source == record.content() or (record.is_file and not Path(record.study).is_file()):
        return ""
    return (
        f"'{folder}' is stale: its study, a module of it, or the version of aleator or JAX has changed since the run. "
        f"`aleator resume {folder}` runs it again."
    )
