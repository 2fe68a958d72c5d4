"""The command line: what it prints, what it keeps and how it exits."""

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import pytest
from typer.testing import CliRunner

import aleator as al
from aleator import cli, studies
from aleator._core.progress import Progress
from aleator.reporting import Section, Table, Verdict, _lock
from aleator.studies import AbstractStudy, Stage


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


def test_a_study_that_finishes_exits_with_zero_and_names_its_files(monkeypatch, tmp_path):
    result = invoke(monkeypatch, Rehearsal(), "--out", str(tmp_path / "new" / "folder"))
    assert result.exit_code == 0
    assert (tmp_path / "new" / "folder" / "finished.txt").read_text() == "first second third"
    assert str(tmp_path / "new" / "folder" / "report.html") in result.output
    assert "as far as it went" in result.output


def test_a_failed_solve_exits_with_one_and_keeps_what_was_finished(monkeypatch, tmp_path):
    accident = al.SolveError("'travel' is violated by 0.1 at t = 1.2 s")
    result = invoke(monkeypatch, Rehearsal(accident), "--out", str(tmp_path))
    assert result.exit_code == 1
    assert "'second': 'travel' is violated by 0.1 at t = 1.2 s" in " ".join(result.output.split())
    assert (tmp_path / "finished.txt").read_text() == "first"
    assert (tmp_path / "report.html").exists()


def test_a_simulation_that_blows_up_exits_with_one(monkeypatch, tmp_path):
    result = invoke(monkeypatch, Rehearsal(al.SimulationError("not finite")), "--out", str(tmp_path))
    assert result.exit_code == 1


def test_an_interruption_keeps_what_was_finished(monkeypatch, tmp_path):
    result = invoke(monkeypatch, Rehearsal(KeyboardInterrupt()), "--out", str(tmp_path))
    assert result.exit_code == 130
    assert "kept" in result.output
    assert (tmp_path / "finished.txt").read_text() == "first"
    assert (tmp_path / "report.html").exists()


def test_an_unknown_study_is_wrong_usage_and_lists_those_there_are():
    result = CliRunner().invoke(cli.application, ["run", "suspention"])
    assert result.exit_code == 2
    assert "suspention" in result.output
    assert "suspension" in result.output


@pytest.mark.skipif(os.name == "nt", reason="a file in the place of a folder is another error on Windows")
def test_an_unwritable_folder_is_refused_before_any_work(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("in the way")
    study = Rehearsal()
    result = invoke(monkeypatch, study, "--out", str(tmp_path / "file" / "below"))
    assert result.exit_code == 2
    assert study.finished == ()
    assert "cannot be written" in " ".join(result.output.split())


def test_an_unknown_option_is_wrong_usage():
    assert CliRunner().invoke(cli.application, ["run", "suspension", "--fast"]).exit_code == 2


def test_the_list_names_every_study():
    result = CliRunner().invoke(cli.application, ["list"])
    assert result.exit_code == 0
    assert "suspension" in result.output


BRACKETS = "[bold]a[/] [/wrong] [0] :smile: \\[x] {task}"


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
    study = Bracketed(al.SolveError(f"message {BRACKETS}"))
    result = invoke(monkeypatch, study, "--out", BRACKETS)
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


def test_an_unknown_study_in_square_brackets_is_named():
    result = CliRunner().invoke(cli.application, ["run", BRACKETS])
    assert result.exit_code == 2
    assert BRACKETS in " ".join(result.output.split())


def test_a_folder_that_another_run_writes_to_is_refused_before_any_work(monkeypatch, tmp_path):
    monkeypatch.setattr(_lock, "_PATIENCE", 0.1)
    study = Rehearsal()
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        result = invoke(monkeypatch, study, "--out", str(tmp_path))
        holder.kill()
    assert result.exit_code == 2
    assert study.finished == ()
    assert "Another process" in " ".join(result.output.split())


HOLDER = """
import sys
from pathlib import Path
from aleator.reporting import only_writer
with only_writer(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


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


def test_work_that_takes_too_much_memory_ends_a_run_with_one_and_keeps_what_was_finished(monkeypatch, tmp_path):
    result = invoke(monkeypatch, Rehearsal(MemoryError("Unable to allocate 48 GiB")), "--out", str(tmp_path))
    assert result.exit_code == 1
    assert "48 GiB" in result.output
    assert (tmp_path / "report.html").exists()


@pytest.mark.parametrize("module", ["aleator", "aleator_command"])
def test_the_modules_run_as_the_command_does(module):
    arguments = [sys.executable, "-m", module, "run", "misspelt"]
    ended = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert "no study 'misspelt'" in ended.stdout + ended.stderr


def test_help_names_the_commands():
    result = CliRunner().invoke(cli.application, ["--help"])
    assert result.exit_code == 0
    assert "COMMAND" in result.output


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
    assert [str(one.message) for one in others] == ["a library's own"]
