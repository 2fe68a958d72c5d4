"""The command line: what it prints, what it keeps and how it exits; its help, completion and progress."""

import io
import json
import re
import subprocess
import sys
import warnings
from pathlib import Path
from typing import ClassVar

import pytest
from rich.console import Console
from typer.testing import CliRunner

import aleator as al
from aleator import cli, studies
from aleator.cli._options import names_of_studies
from aleator.cli._progress import _Lines
from aleator.cli._record import Record
from aleator.cli._sweep import numbers
from aleator.cli._tables import fitted
from aleator.reporting import Table, Verdict, _lock, number
from aleator.studies import Stage
from command_line import aleator, said
from rehearsed_runs import Rehearsal

BRACKETS, PARTS = "[bold]a[/] [/wrong] [0] :smile: \\[x] {task}", ("caption", "head", "cell", "note", "headline")


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch):
    """A run of a study as the command begins it."""

    def run(study: Rehearsal, *arguments: str):
        monkeypatch.setattr(studies, "load", lambda name, quick: study)
        return aleator("run", "rehearsal", *arguments)

    return run


def stopped(accident: BaseException, where: str = "in the second stage") -> Rehearsal:
    """A study that goes wrong somewhere."""

    def at(moment: str) -> None:
        if moment == where:
            raise accident

    return Rehearsal(at)


@pytest.mark.parametrize(
    ("study", "code", "word", "finished"),
    [
        (Rehearsal(), 0, "as far as it went", "first second third"),
        (stopped(al.SolveError("'travel' is violated at t = 1.2 s")), 1, "'second': 'travel' is violated", "first"),
        (stopped(MemoryError("Unable to allocate 48 GiB")), 1, "48 GiB", "first"),
        (stopped(KeyboardInterrupt()), 130, "kept", "first"),
    ],
    ids=["finished", "unsolved", "memory", "interrupted"],
)
def test_the_exit_code_tells_what_went_wrong_and_what_was_finished_is_kept(
    run, tmp_path: Path, study, code, word, finished
):
    result = run(study, "--out", str(tmp_path / "new" / "folder"))
    assert result.exit_code == code
    assert word in said(result)
    assert (tmp_path / "new" / "folder" / "designs.json").read_text() == finished
    assert (tmp_path / "new" / "folder" / "report.html").exists()


class Bracketed(Rehearsal):
    """A study whose texts look like markup, or like an emoji."""

    stages: ClassVar = {BRACKETS: Stage(lambda progress: progress(BRACKETS, 0, 2), 1.0)}

    def tables(self) -> list[Table]:
        return [Table(f"caption {BRACKETS}", [f"head {BRACKETS}"], [[f"cell {BRACKETS}"]], f"note {BRACKETS}")]

    def verdict(self) -> Verdict:
        return Verdict("good", "Done", f"headline {BRACKETS}")


def test_text_in_square_brackets_is_printed_as_it_is(run, monkeypatch, tmp_path: Path):
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.chdir(tmp_path)
    told = run(Bracketed(), "--out", BRACKETS).output
    for text in (f"{BRACKETS}: 0.0 s", f"wrote {BRACKETS}/", *(f"{part} {BRACKETS}" for part in PARTS)):
        assert text in told
    failed = run(stopped(al.SolveError(f"message {BRACKETS}")), "--out", BRACKETS)
    assert f"message {BRACKETS}" in failed.output


def test_a_mistake_in_a_study_s_own_code_ends_with_its_traceback_and_a_document(run, tmp_path: Path):
    result = run(stopped(ZeroDivisionError("by the engineer")), "--out", str(tmp_path), "--json")
    assert isinstance(result.exception, ZeroDivisionError)
    told = json.loads(result.stdout)
    assert told["exit_code"] == 1
    assert told["errors"] == ["ZeroDivisionError: by the engineer"]


HOLDER = """
import fcntl, sys
file = open(sys.argv[1], "a")
fcntl.flock(file, fcntl.LOCK_EX)
print("held", flush=True)
sys.stdin.read()
"""


def test_a_folder_that_another_run_writes_to_is_refused_before_any_work(run, monkeypatch, tmp_path: Path):
    monkeypatch.setattr(_lock, "_PATIENCE", 0.1)
    study = Rehearsal()
    with _lock.only_writer(tmp_path):
        (lock,) = tmp_path.iterdir()
    with subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", HOLDER, str(lock)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        result = run(study, "--out", str(tmp_path))
        holder.kill()
    assert result.exit_code == 2
    assert study.finished == ()
    assert "Another process" in said(result)


def test_a_warning_is_a_sentence_without_the_place_in_the_code(run, tmp_path: Path):
    def doubt(moment: str) -> None:
        if moment == "in the first stage":
            warnings.warn("On 10 steps 'x(t_f)' is off by 1.", al.GridWarning, stacklevel=2)
            warnings.warn("a library's own", RuntimeWarning, stacklevel=2)

    with warnings.catch_warnings(record=True) as others:
        warnings.simplefilter("always")
        result = run(Rehearsal(doubt), "--out", str(tmp_path))
    assert result.exit_code == 0
    assert "warning: On 10 steps 'x(t_f)' is off by 1." in result.output
    assert "GridWarning" not in result.output
    assert [str(warning.message) for warning in others] == ["a library's own"]


@pytest.mark.slow
@pytest.mark.parametrize("module", ["aleator", "aleator_command"])
def test_the_modules_run_as_the_command_does(module: str):
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
    assert all(name in aleator("list").output for name in studies.STUDIES)
    assert aleator("new", "bracket.py").exit_code == 0
    for command in cli.application.registered_commands:
        assert examples_of(f"{command.name}")
    for line in examples_of("sweep"):
        study, bound, values = re.fullmatch(r"aleator sweep (\S+) --bound (\S+) --values (\S+).*", line).groups()  # type: ignore[union-attr]
        assert Record(study, bound=bound, values=numbers(values)).made().stages
    named = re.search(r"(bracket\.py).* --design (\S+)", "\n".join(examples_of("validate")))
    assert named is not None
    assert named[2] in Record(named[1]).made().problems


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


# --- Progress and tables ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("calls", "printed"),
    [
        (
            [(0.0, "front", 0, 3), (2.0, "front: a", 1, 3), (4.0, "front: b", 2, 3), (9.0, "front: c", 3, 3)],
            ["front: a, 1 of 3, about 4 s left", "front: b, 2 of 3, about 2 s left", "front: c, 3 of 3"],
        ),
        (
            [(float(step), "samples", step, 1000) for step in range(25)],
            ["samples, 11 of 1000, about 16 min left", "samples, 22 of 1000, about 16 min left"],
        ),
    ],
    ids=["each step", "many steps now and then"],
)
def test_progress_is_lines_with_the_time_that_is_left(calls, printed):
    file, times = io.StringIO(), iter([0.0, 0.0, *(time for time, *_ in calls)])
    lines = _Lines(Console(file=file, width=200), lambda: next(times))
    lines.begin("front")
    for _, task, done, total in calls:
        lines.show(task, done, total)
    assert file.getvalue().splitlines() == [f"  {line}" for line in printed]


@pytest.mark.parametrize("width", [40, 80, 400])
def test_every_number_of_a_wide_table_stands_whole_in_one_line_of_a_terminal(width: int):
    names = [f"design {i}" for i in range(8)]
    rows = [[f"row {j}", *(number(23339.0 + i + 0.001 * j, 7, "N/m") for i in range(8))] for j in range(3)]
    written = io.StringIO()
    console = Console(file=written, width=width, markup=False, emoji=False, highlight=False)
    for piece in fitted(Table("Designs", ["", *names], rows, "A note on all of them."), width):
        console.print(piece)
    text = written.getvalue()
    assert "…" not in text
    assert all(cell in text for row in (names, *rows) for cell in row)
    assert max(map(len, text.splitlines())) <= width
    assert text.count("Designs") == text.count("A note on all") == 1
