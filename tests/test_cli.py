"""The command line: what it prints, what it keeps and how it exits; its help, completion and progress."""

import io
import json
import os
import re
import subprocess
import sys
import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

import aleator as al
from aleator import cli, studies
from aleator._core.progress import Progress
from aleator.cli._options import names_of_studies
from aleator.cli._progress import _Lines, shown
from aleator.cli._record import Record
from aleator.cli._sweep import numbers
from aleator.reporting import Section, Table, Verdict, _lock
from aleator.studies import AbstractStudy, Stage

BRACKETS = "[bold]a[/] [/wrong] [0] :smile: \\[x] {task}"


class Rehearsal(AbstractStudy):
    """A study of three stages, the second of which may go wrong."""

    def __init__(self, accident: BaseException | None = None):
        self.accident = accident

    @property
    def stages(self) -> Mapping[str, Stage]:
        return {name: Stage(partial(self.work, name), 1.0) for name in ("first", "second", "third")}

    def work(self, stage: str, progress: Progress) -> None:
        progress("inside", 0, 2)
        if stage == "second" and self.accident is not None:
            raise self.accident

    def save(self, folder: Path) -> list[Path]:
        path = folder / "finished.txt"
        path.write_text(" ".join(self.finished))
        return [path]

    def write_page(self, folder: Path) -> Path:
        path = folder / "report.html"
        path.write_text("<p>report</p>")
        return path

    def tables(self) -> list[Table]:
        return [Table("Stages", ["stage"], [[stage] for stage in self.finished])]

    def results(self) -> Mapping[str, object]:
        return {}

    def sections(self) -> Sequence[Section]:
        return []

    def verdict(self) -> Verdict:
        return Verdict("good", "Done", "as far as it went.")


def invoke(monkeypatch: pytest.MonkeyPatch, study: Rehearsal, *arguments: str):
    monkeypatch.setattr(studies, "load", lambda name, quick: study)
    return CliRunner().invoke(cli.application, ["run", "rehearsal", *arguments])


def said(result) -> str:
    return " ".join(result.output.split())


def test_a_study_that_finishes_exits_with_zero_and_names_its_files(monkeypatch, tmp_path):
    result = invoke(monkeypatch, Rehearsal(), "--out", str(tmp_path / "new" / "folder"))
    assert result.exit_code == 0
    assert (tmp_path / "new" / "folder" / "finished.txt").read_text() == "first second third"
    assert str(tmp_path / "new" / "folder" / "report.html") in result.output
    assert "as far as it went" in result.output


@pytest.mark.parametrize(
    ("accident", "code", "word"),
    [
        (al.SolveError("'travel' is violated at t = 1.2 s"), 1, "'second': 'travel' is violated at t = 1.2 s"),
        (al.SimulationError("not finite"), 1, "not finite"),
        (MemoryError("Unable to allocate 48 GiB"), 1, "48 GiB"),
        (KeyboardInterrupt(), 130, "kept"),
    ],
    ids=["unsolved", "diverged", "memory", "interrupted"],
)
def test_what_goes_wrong_sets_the_exit_code_and_what_was_finished_is_kept(
    monkeypatch, tmp_path, accident, code: int, word: str
):
    result = invoke(monkeypatch, Rehearsal(accident), "--out", str(tmp_path))
    assert result.exit_code == code
    assert word in said(result)
    assert (tmp_path / "finished.txt").read_text() == "first"
    assert (tmp_path / "report.html").exists()


def test_results_that_cannot_be_written_end_a_run_with_one(monkeypatch, tmp_path):
    class Full(Rehearsal):
        def save(self, folder: Path) -> list[Path]:
            if self.finished == ("first", "second"):
                raise al.ProblemError("No results can be written (No space left on device)")
            return super().save(folder)

    result = invoke(monkeypatch, Full(), "--out", str(tmp_path))
    assert result.exit_code == 1
    assert result.output.count("No space left on device") == 1
    assert (tmp_path / "finished.txt").read_text() == "first"


def test_a_mistake_in_a_study_s_own_code_ends_with_its_traceback_and_a_document(monkeypatch, tmp_path):
    result = invoke(monkeypatch, Rehearsal(ZeroDivisionError("by the engineer")), "--out", str(tmp_path), "--json")
    assert isinstance(result.exception, ZeroDivisionError)
    told = json.loads(result.stdout)
    assert told["exit_code"] == 1
    assert told["errors"] == ["ZeroDivisionError: by the engineer"]


def test_what_is_typed_wrong_is_told_and_the_list_names_every_study():
    for arguments in (["run", "suspention"], ["run", "suspension", "--fast"], ["run", BRACKETS]):
        result = CliRunner().invoke(cli.application, arguments)
        assert result.exit_code == 2
        assert arguments[-1] in said(result)
    result = CliRunner().invoke(cli.application, ["list"])
    assert result.exit_code == 0
    assert all(name in result.output for name in studies.STUDIES)


@pytest.mark.skipif(os.name == "nt", reason="a file in the place of a folder is another error on Windows")
def test_an_unwritable_folder_is_refused_before_any_work(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("in the way")
    study = Rehearsal()
    result = invoke(monkeypatch, study, "--out", str(tmp_path / "file" / "below"))
    assert result.exit_code == 2
    assert study.finished == ()
    assert "cannot be written" in said(result)


HOLDER = """
import fcntl, sys
file = open(sys.argv[1], "a")
fcntl.flock(file, fcntl.LOCK_EX)
print("held", flush=True)
sys.stdin.read()
"""


def test_a_folder_that_another_run_writes_to_is_refused_before_any_work(monkeypatch, tmp_path):
    monkeypatch.setattr(_lock, "_PATIENCE", 0.1)
    study = Rehearsal()
    with _lock.only_writer(tmp_path):
        (lock,) = tmp_path.iterdir()
    with subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", HOLDER, str(lock)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        result = invoke(monkeypatch, study, "--out", str(tmp_path))
        holder.kill()
    assert result.exit_code == 2
    assert study.finished == ()
    assert "Another process" in said(result)


class Bracketed(Rehearsal):
    """A study whose every name and text looks like markup, or like an emoji."""

    @property
    def stages(self) -> Mapping[str, Stage]:
        return {name: Stage(partial(self.work, name), 1.0) for name in (BRACKETS, "second")}

    def work(self, stage: str, progress: Progress) -> None:
        progress(BRACKETS, 0, 2)
        super().work(stage, progress)

    def tables(self) -> list[Table]:
        return [Table(f"caption {BRACKETS}", [f"head {BRACKETS}"], [[f"cell {BRACKETS}"]], f"note {BRACKETS}")]

    def verdict(self) -> Verdict:
        return Verdict("good", "Done", f"headline {BRACKETS}")


def test_text_in_square_brackets_is_printed_as_it_is(monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.chdir(tmp_path)
    result = invoke(monkeypatch, Bracketed(al.SolveError(f"message {BRACKETS}")), "--out", BRACKETS)
    assert result.exit_code == 1
    for text in (
        f"{BRACKETS}: 0.0 s",
        f"message {BRACKETS}",
        f"wrote {BRACKETS}/",
        *(f"{part} {BRACKETS}" for part in ("caption", "head", "cell", "note")),
    ):
        assert text in result.output
    assert f"headline {BRACKETS}" in invoke(monkeypatch, Bracketed(), "--out", BRACKETS).output
    result = invoke(monkeypatch, Bracketed(KeyboardInterrupt()), "--out", BRACKETS)
    assert f"kept in {BRACKETS}" in result.output


class Doubtful(Rehearsal):
    """A study whose first stage has doubts, of ours and of a library."""

    def work(self, stage: str, progress: Progress) -> None:
        super().work(stage, progress)
        if stage == "first":
            warnings.warn("On 10 steps 'x(t_f)' is off by 1.", al.GridWarning, stacklevel=2)
            warnings.warn("a library's own", RuntimeWarning, stacklevel=2)


def test_a_warning_is_a_sentence_without_the_place_in_the_code(monkeypatch, tmp_path):
    with warnings.catch_warnings(record=True) as others:
        warnings.simplefilter("always")
        result = invoke(monkeypatch, Doubtful(), "--out", str(tmp_path))
    assert result.exit_code == 0
    assert "warning: On 10 steps 'x(t_f)' is off by 1." in result.output
    assert "GridWarning" not in result.output
    assert [str(warning.message) for warning in others] == ["a library's own"]


@pytest.mark.slow
@pytest.mark.parametrize("module", ["aleator", "aleator_command"])
def test_the_modules_run_as_the_command_does(module):
    arguments = [sys.executable, "-m", module, "run", "misspelt"]
    ended = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert "no study 'misspelt'" in ended.stdout + ended.stderr


# --- Help and completion ---------------------------------------------------------------------------------------------


def examples_of(command: str) -> list[str]:
    """The examples of a command's help."""
    result = CliRunner().invoke(cli.application, [command, "--help"], terminal_width=200)
    assert result.exit_code == 0
    return [line.strip() for line in result.output.splitlines() if re.match(rf"\s*aleator {command}\b", line)]


def test_every_command_shows_an_example_of_names_that_there_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(cli.application, ["--help"]).exit_code == 0
    assert CliRunner().invoke(cli.application, ["new", "bracket.py"]).exit_code == 0
    for command in cli.application.registered_commands:
        assert examples_of(f"{command.name}")
    for line in examples_of("sweep"):
        study, bound, values = re.fullmatch(r"aleator sweep (\S+) --bound (\S+) --values (\S+).*", line).groups()  # type: ignore[union-attr]
        assert Record(study, bound=bound, values=numbers(values)).made().stages
    designs = [re.search(r"(bracket\.py).* --design (\S+)", line) for line in examples_of("validate")]
    assert any(designs)
    assert all(named[2] in Record(named[1]).made().problems for named in designs if named)


def test_the_shell_completes_names_of_studies_files_and_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    asked = {"_ALEATOR_COMPLETE": "complete_bash", "COMP_WORDS": "aleator run sus", "COMP_CWORD": "2"}
    result = CliRunner().invoke(cli.application, [], env=asked, prog_name="aleator")
    assert result.output.split() == ["suspension"]
    monkeypatch.chdir(tmp_path)
    for name in ("suspended.py", "sums.toml", "sunk.txt", "[odd].py"):
        (tmp_path / name).touch()
    (tmp_path / "sub").mkdir()
    assert names_of_studies("su") == ["sub/", "sums.toml", "suspended.py", "suspension"]
    assert names_of_studies("[o") == ["[odd].py"]
    assert names_of_studies(str(tmp_path)) == []


# --- Progress --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("calls", "printed"),
    [
        (
            [(0.0, "front", 0, 3), (2.0, "front: a", 1, 3), (4.0, "front: b", 2, 3), (9.0, "front: c", 3, 3)],
            ["front: a, 1 of 3, about 4 s left", "front: b, 2 of 3, about 2 s left", "front: c, 3 of 3"],
        ),
        (  # many steps are told now and then
            [(float(step), "samples", step, 1000) for step in range(25)],
            ["samples, 11 of 1000, about 16 min left", "samples, 22 of 1000, about 16 min left"],
        ),
        (  # other work in a stage has a time of its own
            [(50.0, "first", 1, 1), (100.0, "second", 0, 2), (101.0, "second", 1, 2)],
            ["first, 1 of 1", "second, 1 of 2, about 1 s left"],
        ),
    ],
)
def test_progress_is_lines_with_the_time_that_is_left(calls, printed):
    file, times = io.StringIO(), iter([0.0, 0.0, *(time for time, *_ in calls)])
    lines = _Lines(Console(file=file, width=200), lambda: next(times))
    lines.begin("front")
    for _, task, done, total in calls:
        lines.show(task, done, total)
    assert file.getvalue().splitlines() == [f"  {line}" for line in printed]


@pytest.mark.parametrize("is_terminal", [True, False])
def test_only_a_terminal_gets_control_characters(is_terminal: bool):
    file = io.StringIO()
    console = Console(file=file, force_terminal=is_terminal, width=200, markup=False, highlight=False)
    with shown(console, 1.0) as progress:
        progress.begin("front")
        progress.show("front: [x] = 1, objective 2", 1, 1)
        progress.end("front", 1.0, "0.5 s")
    assert ("\x1b" in file.getvalue()) == is_terminal
    assert "front: [x] = 1, objective 2" in file.getvalue()
    assert "front: 0.5 s" in file.getvalue()
