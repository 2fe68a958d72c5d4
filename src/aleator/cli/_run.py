"""The run of a study: what began it, by which `aleator resume FOLDER` goes on from the folder alone; its chapter, its
results, its page and its tables, whatever ends it.
"""

import hashlib
import os
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, final

import aleator
from aleator import studies
from aleator._core.border import content_of, json_of
from aleator._core.errors import AleatorError, ProblemError
from aleator._core.identity import own_files
from aleator.cli._interruption import Interruptions
from aleator.cli._terminal import FAILED, Terminal
from aleator.journalling import Journal, journal
from aleator.reporting import by_place, check_writable, designs_document, json_text, words, write_whole
from aleator.solution import Solution
from aleator.studies import AbstractStudy, Draft, SweptStudy
from aleator.sweep import Front
from aleator.validation import Evidence

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


# --- The run ----------------------------------------------------------------------------------------------------------


def run_study(study: AbstractStudy, folder: str | Path) -> int:
    """Run your own study as `aleator run` runs the built-in ones; returns the exit code.

    The chapter runs with its progress shown; the journal keeps each result as soon as it is there. Then, and on Ctrl-C,
    all results are saved into `folder`, the page is written and the tables are printed.
    """
    terminal = Terminal("run")
    return terminal.do(lambda: _Run(terminal, Path(folder)).execute(lambda: study))


def begin(terminal: Terminal, out: Path | None, afresh: bool, **command: Any) -> int:
    """Run a study, or solve one of its designs for each value of a bound; `command`: as `Record` has it."""
    record = Record(**command)
    return _Run(terminal, out or record.folder).execute(record.made, record, afresh=afresh)


def resume(terminal: Terminal, folder: Path, workers: int | None) -> int:
    """Go on with the run of a folder."""
    record = Record.of(folder)
    record = replace(record, workers=record.workers if workers is None else workers)
    return _Run(terminal, folder).execute(record.made, record)


@final
class _Run:
    """One run of a study in a folder, and what it says; until the study is there, there are no page and no results."""

    def __init__(self, terminal: Terminal, folder: Path):
        self._terminal, self._folder = terminal, folder
        self._page: Draft | None = None
        self._results: Journal | None = None
        self._paths = list[Path]()
        self._mistake: Exception | None = None
        self._interruptions = Interruptions(lambda code: terminal.end_at_once(self._last_words(), code))

    def execute(self, made: Callable[[], AbstractStudy], record: Record | None = None, *, afresh: bool = False) -> int:
        """Make the study and run it while no other run writes into its folder; returns the exit code.

        - `record`: the command that began it, which the folder notes.
        """
        self._terminal.note(folder=str(self._folder))
        with self._interruptions:
            try:
                study = made()
                study.check_declaration()
                check_writable(self._folder)
                if record is not None:
                    record.check_owns(self._folder)
                with journal(self._folder, afresh=afresh) as results:
                    if staleness(self._folder):  # so that no design of an earlier form goes by the name of this run's
                        results.outdate()
                    if record is None:
                        (self._folder / RECORD).unlink(missing_ok=True)
                    else:
                        record.write(self._folder)
                    self._page, self._results = Draft(study), results
                    code = self._execute(self._page, results)
            except KeyboardInterrupt:
                code = self._interruptions.conclude()
                self._terminal.complain(self._last_words(), "")
        if self._mistake is not None:
            raise self._mistake
        return code

    def _execute(self, page: Draft, results: Journal) -> int:
        """Run the chapter, save its results, write the page, and print the tables; returns the exit code."""

        def ended(_: str) -> None:
            _name_results(page, results)
            self._terminal.end()

        def save() -> None:
            _name_results(page, results)
            self._paths += page.save(self._folder)
            self._paths.append(page.write(self._folder))

        self._attempt(page, "the chapter", lambda: page.fill(self._terminal.progress, self._terminal.begin, ended))
        with self._interruptions.shielded():
            if page.finished or page.kept or page.failures:
                self._attempt(page, "saving", save)
            fronts = {place: one for place, one in by_place(page.kept).items() if isinstance(one, Front)}
            self._terminal.note(
                finished=page.finished,
                files=[str(path) for path in self._paths],
                title=page.study.title,
                verdict=page.headline(),
                designs=designs_document(page.kept),
                fronts={place: _front_document(front) for place, front in fronts.items()},
                recalled=len(results.taken),
            )
        if page.stopped:
            raise KeyboardInterrupt
        for table in page.tables:
            self._terminal.table(table)
        self._terminal.tell(page.headline())
        for path in self._paths:
            self._terminal.tell(f"wrote {path}")
        if results.taken:
            self._terminal.tell(f"Results taken from an earlier run: {len(results.taken)}.")
        for sentence in [*page.failures, *page.unsolved]:
            self._terminal.complain(sentence)
        return FAILED if page.failures or page.unsolved else 0

    def _attempt(self, page: Draft, where: str, part: Callable[[], None]) -> None:
        """Do a part of the run, and note on the page how it ended.

        An exception in a study's own code is raised again after writing, for its traceback.
        """
        try:
            part()
        except KeyboardInterrupt:
            page.stop()
        except Exception as error:
            if self._interruptions.received is not None:  # which a library has turned into another exception
                page.stop()
                return
            page.fail(where, error)
            if not isinstance(error, AleatorError | MemoryError | OSError):
                self._mistake = self._mistake or error

    def _last_words(self) -> str:
        """What an interrupted run has finished and kept."""
        if self._page is None or self._results is None:
            return "Interrupted: nothing was begun."
        during = f" during '{self._page.present}'" if self._page.present else ""
        finished = words([f"'{name}'" for name in self._page.finished], "no part")
        kept = "1 result is" if len(self._results) == 1 else f"{len(self._results)} results are"
        return f"Interrupted{during}: {kept} kept in '{self._folder}'; finished: {finished}."


def _name_results(page: Draft, results: Journal) -> None:
    """Let the journal know what the study calls its results, for `aleator validate` and `al.load`.

    Where one result has several places, the first is its name.
    """
    kept = [(place, one) for place, one in by_place(page.kept).items() if isinstance(one, Solution | Evidence)]
    results.call(dict(reversed(kept)))


def _front_document(front: Front) -> dict[str, Any]:
    """A front, point by point."""
    columns = zip(front.values, front.points, front.objectives, front.shadow_prices, front.violations, strict=True)
    return {
        "bound": front.bound,
        "interrupted": front.interrupted,
        "points": [
            {
                "value": value,
                "status": point.status.value,
                "objective": objective,
                "shadow_price": price,
                "violation": violation,
                "decisions": dict(point.decisions) if isinstance(point, Solution) and point.ok else {},
                "why": None if point.ok else point.why(),
            }
            for value, point, objective, price, violation in columns
        ],
    }
