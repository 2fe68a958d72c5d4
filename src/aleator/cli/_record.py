"""What began a run, in its folder: so that `aleator resume FOLDER` goes on from the folder alone."""

import json
import os
import sys
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, final

from aleator import studies
from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._options import folder_over
from aleator.reporting import json_text, write_whole
from aleator.studies import AbstractStudy, SweptStudy

RECORD = "command.json"
"""The file in a run's folder that says what began it."""

_FILES = (".py", ".toml")


@final
@dataclass(frozen=True)
class Record:
    """The command that began a run.

    - `study`: its name, file or module, as given; `quick`: of `aleator run`;
    - `directory`: where the command was given; `beside`: the study's file, relative to the run's folder;
    - `workers`: processes that share the work, none if the study shall say;
    - `bound`, `values`, `design`: of `aleator sweep`; empty for `aleator run`.
    """

    study: str
    quick: bool = False
    directory: str = ""
    beside: str = ""
    bound: str = ""
    values: tuple[float, ...] = ()
    design: str = ""
    workers: int = 0

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
        if not self._is_of(other, folder):
            raise ProblemError(
                f"The results of `{other}` are in '{folder}', and `{self}` would replace them: name another folder, "
                f"such as --out {self._another(folder, other)}, or remove that one."
            )

    def _is_of(self, other: "Record", folder: Path) -> bool:
        """Whether it goes on with the run that another has begun, wherever its file is now."""
        if (self.bound, self.design) != (other.bound, other.design):
            return False
        if not self.study.endswith(_FILES) or not other.study.endswith(_FILES):
            return self.study == other.study
        places = [one for one in other.places(folder) if one.is_file()]
        if not places:
            return Path(self.study).name == Path(other.study).name
        return Path(self.study).resolve() in [one.resolve() for one in places]

    def _another(self, folder: Path, other: "Record") -> Path:
        """A name for another folder, which tells what differs: the bound, or the kind of the study's file."""
        if self.bound and self.bound != other.bound:
            return folder_over(folder, self.bound)
        kind = Path(self.study).suffix.removeprefix(".") if self.study.endswith(_FILES) else ""
        return folder.with_name(f"{folder.name}-{kind or 'again'}")

    def places(self, folder: Path) -> list[Path]:
        """Where the study's file may be: as it was given, or as it lies from the run's folder."""
        return [Path(self.directory) / self.study, folder / self.beside]

    def __str__(self) -> str:
        bound = f" --bound {self.bound}" if self.bound else ""
        return f"aleator {self.command} {self.study}{bound}{f' --design {self.design}' if self.design else ''}"

    def write(self, folder: Path) -> None:
        """Note it in the run's folder, atomically."""
        text = json_text({"command": self.command, **asdict(self._placed(folder))})
        write_whole(folder / RECORD, lambda file: file.write_text(text, encoding="utf-8"))

    def _placed(self, folder: Path) -> "Record":
        """The same, with the places from which the study can be found again."""
        here = Path.cwd()
        beside = _relative(here / self.study, folder.resolve()) if self.study.endswith(_FILES) else ""
        return replace(self, directory=str(here), beside=beside)


def _relative(file: Path, folder: Path) -> str:
    try:
        return os.path.relpath(file.resolve(), folder)
    except ValueError:  # on another drive of Windows
        return ""


def study_of(folder: Path) -> tuple[AbstractStudy | None, str]:
    """The study that began the run of a folder; or none, and why, if the folder says one that cannot be had any more.

    Modules beside its file can be imported from now on, also where the file has gone.
    """
    if not (folder / RECORD).is_file():
        return None, ""
    try:
        return recorded(folder).made(), ""
    except AleatorError as error:
        return None, f"{error}"


def recorded(folder: Path) -> Record:
    """What began the run of a folder, whose modules can be imported from now on.

    Raises `ProblemError` if the folder does not say, or if the study's file has gone.
    """
    return _found(_read(folder), folder)


def _read(folder: Path) -> Record:
    """What began the run of a folder, as it was noted. Raises `ProblemError` if the folder does not say."""
    path = folder / RECORD
    try:
        data = json.loads(path.read_bytes())
        return Record(**{name: _known(data[name], name) for name in (one.name for one in fields(Record))})
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


def _known(value: Any, name: str) -> Any:
    kinds = {"quick": bool, "workers": int, "values": list}
    if not isinstance(value, kinds.get(name, str)):
        raise TypeError(f"{name} = {value!r}")
    return tuple(map(float, value)) if isinstance(value, list) else value


def _found(record: Record, folder: Path) -> Record:
    """The record, with the study's file where it is now: as it was given, or as it lies from the folder."""
    if not record.study.endswith(_FILES):
        if record.directory not in sys.path:
            sys.path.insert(0, record.directory)
        return record
    places = record.places(folder)
    for place in places:
        if place.is_file():
            return replace(record, study=str(place))
    sys.path[:0] = [f"{one.parent.resolve()}" for one in places if one.parent.is_dir()]
    raise ProblemError(
        f"The study of '{folder}' has gone: there is no file '{places[0]}', nor '{places[1]}'. Put it back, or run it "
        "where it is now, with --out for this folder."
    )
