"""The command line: what it prints, what it keeps and how it exits."""

import os
from collections.abc import Mapping
from pathlib import Path

import pytest
from typer.testing import CliRunner

import aleator as al
from aleator import cli
from aleator._core.progress import Progress
from aleator.report import Table
from aleator.studies import AbstractStudy


class Rehearsal(AbstractStudy):
    """A study of three stages, the second of which may go wrong."""

    def __init__(self, accident: BaseException | None = None):
        self.accident = accident
        self.finished: list[str] = []

    @property
    def stages(self) -> Mapping[str, float]:
        return {"first": 1.0, "second": 2.0, "third": 1.0}

    def run(self, stage: str, progress: Progress) -> None:
        progress("inside", 0, 2)
        if stage == "second" and self.accident is not None:
            raise self.accident
        self.finished.append(stage)

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

    def headline(self) -> str:
        return "Done: as far as it went."


def invoke(monkeypatch: pytest.MonkeyPatch, study: Rehearsal, *arguments: str):
    monkeypatch.setattr(cli, "load", lambda name, quick: study)
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
    assert study.finished == []
    assert "cannot be written" in " ".join(result.output.split())


def test_an_unknown_option_is_wrong_usage():
    assert CliRunner().invoke(cli.application, ["run", "suspension", "--fast"]).exit_code == 2


def test_the_list_names_every_study():
    result = CliRunner().invoke(cli.application, ["list"])
    assert result.exit_code == 0
    assert "suspension" in result.output
