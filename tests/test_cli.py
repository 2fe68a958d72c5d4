"""The command line: what it prints, what it keeps and how it exits; its help, completion and progress."""

import io
import json
import os
import re
import subprocess
import sys
import warnings
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

import aleator as al
from aleator import cli, studies
from aleator.cli._options import names_of_studies
from aleator.cli._progress import _Lines, shown
from aleator.cli._record import Record
from aleator.cli._sweep import numbers
from aleator.cli._tables import fitted
from aleator.reporting import Table, Verdict, _lock, number
from aleator.studies import Stage
from command_line import aleator, said
from rehearsed_runs import Rehearsal

BRACKETS = "[bold]a[/] [/wrong] [0] :smile: \\[x] {task}"


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


def test_a_study_that_finishes_exits_with_zero_and_names_its_files(run, tmp_path: Path):
    result = run(Rehearsal(), "--out", str(tmp_path / "new" / "folder"))
    assert result.exit_code == 0
    assert (tmp_path / "new" / "folder" / "designs.json").read_text() == "first second third"
    assert str(tmp_path / "new" / "folder" / "report.html") in result.output
    assert "as far as it went" in result.output


@pytest.mark.parametrize(
    ("accident", "code", "word"),
    [
        (al.SolveError("'travel' is violated at t = 1.2 s"), 1, "'second': 'travel' is violated at t = 1.2 s"),
        (MemoryError("Unable to allocate 48 GiB"), 1, "48 GiB"),
        (KeyboardInterrupt(), 130, "kept"),
    ],
    ids=["unsolved", "memory", "interrupted"],
)
def test_what_goes_wrong_sets_the_exit_code_and_what_was_finished_is_kept(run, tmp_path: Path, accident, code, word):
    result = run(stopped(accident), "--out", str(tmp_path))
    assert result.exit_code == code
    assert word in said(result)
    assert (tmp_path / "designs.json").read_text() == "first"
    assert (tmp_path / "report.html").exists()


def test_a_mistake_in_a_study_s_own_code_ends_with_its_traceback_and_a_document(run, tmp_path: Path):
    result = run(stopped(ZeroDivisionError("by the engineer")), "--out", str(tmp_path), "--json")
    assert isinstance(result.exception, ZeroDivisionError)
    told = json.loads(result.stdout)
    assert told["exit_code"] == 1
    assert told["errors"] == ["ZeroDivisionError: by the engineer"]


def test_the_list_names_every_study():
    result = aleator("list")
    assert result.exit_code == 0
    assert all(name in result.output for name in studies.STUDIES)


@pytest.mark.skipif(os.name == "nt", reason="a file in the place of a folder is another error on Windows")
def test_an_unwritable_folder_is_refused_before_any_work(run, tmp_path: Path):
    (tmp_path / "file").write_text("in the way")
    study = Rehearsal()
    result = run(study, "--out", str(tmp_path / "file" / "below"))
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


class Bracketed(Rehearsal):
    """A study whose every name and text looks like markup, or like an emoji."""

    @property
    def stages(self) -> Mapping[str, Stage]:
        return {name: Stage(partial(self.work, name), 1.0) for name in (BRACKETS, "second")}

    def tables(self) -> list[Table]:
        return [Table(f"caption {BRACKETS}", [f"head {BRACKETS}"], [[f"cell {BRACKETS}"]], f"note {BRACKETS}")]

    def verdict(self) -> Verdict:
        return Verdict("good", "Done", f"headline {BRACKETS}")


def test_text_in_square_brackets_is_printed_as_it_is(run, monkeypatch, tmp_path: Path):
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.chdir(tmp_path)
    accident = al.SolveError(f"message {BRACKETS}")
    result = run(Bracketed(stopped(accident).at), "--out", BRACKETS)
    assert result.exit_code == 1
    for text in (f"{BRACKETS}: 0.0 s", f"message {BRACKETS}", f"wrote {BRACKETS}/"):
        assert text in result.output
    for part in ("caption", "head", "cell", "note"):
        assert f"{part} {BRACKETS}" in result.output
    assert f"headline {BRACKETS}" in run(Bracketed(), "--out", BRACKETS).output


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
    assert aleator("--help").exit_code == 0
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
        (
            [(50.0, "first", 1, 1), (100.0, "second", 0, 2), (101.0, "second", 1, 2)],
            ["first, 1 of 1", "second, 1 of 2, about 1 s left"],
        ),
    ],
    ids=["each step", "many steps now and then", "other work in a stage has a time of its own"],
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


def printed(table: Table, width: int) -> str:
    written = io.StringIO()
    console = Console(file=written, width=width, markup=False, emoji=False, highlight=False)
    for one in fitted(table, width):
        console.print(one)
    return written.getvalue()


@pytest.mark.parametrize("width", [40, 80, 400])
def test_every_number_of_a_wide_table_stands_whole_in_one_line_of_a_terminal(width: int):
    names = [f"design {i}" for i in range(8)]
    rows = [[f"row {j}", *(number(23339.0 + i + 0.001 * j, 7, "N/m") for i in range(8))] for j in range(3)]
    text = printed(Table("Designs", ["", *names], rows, "A note on all of them."), width)
    assert "…" not in text
    assert all(cell in text for row in (names, *rows) for cell in row)
    assert max(map(len, text.splitlines())) <= width
    assert text.count("Designs") == text.count("A note on all") == 1


def test_long_texts_wrap_between_words_and_longer_words_are_broken_without_loss():
    reason = "no design: the width is at its bound and the stress is beyond its limit by 0.3 kN/mm"
    word = "a-name-without-any-space-" * 5
    text = printed(Table("Points", ["stress", "Result"], [["0.01", reason], ["0.02", word]]), 60)
    cells = [line.split("│")[2].strip() for line in text.splitlines() if line.startswith("│")]
    assert " ".join(cells[:2]) == reason
    assert "".join(cells[2:]) == word
