"""A case study's folder: its page again without computing anything, and what a killed run leaves of it."""

import json
import re
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from aleator import cli
from aleator.journalling import FILE
from aleator.reporting import PAGE


def aleator(*arguments: str) -> dict:
    result = CliRunner().invoke(cli.application, [*arguments, "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def body(page: Path) -> str:
    """A page without the time at which it was written."""
    return re.sub(r"<footer>.*</footer>", "", page.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a quick run, which no test changes."""
    folder = tmp_path_factory.mktemp("finished") / "clutch"
    aleator("run", "clutch", "--quick", "--out", str(folder))
    return folder


@pytest.mark.slow
def test_a_case_study_is_written_and_run_again_from_its_folder_alone(finished: Path, tmp_path: Path):
    before = (finished / FILE).read_bytes()
    told = aleator("report", str(finished), "--out", str(tmp_path / PAGE))
    assert told["missing"] == []
    assert (finished / FILE).read_bytes() == before
    assert body(tmp_path / PAGE) == body(finished / PAGE)
    shutil.copytree(finished, tmp_path / "clutch")
    done = {json.loads(line)["key"] for line in before.decode().splitlines() if '"state": "done"' in line}
    again = aleator("run", "clutch", "--quick", "--out", str(tmp_path / "clutch"))
    assert again["recalled"] == len(done)
    assert body(tmp_path / "clutch" / PAGE) == body(finished / PAGE)


@pytest.mark.slow
def test_a_run_that_was_killed_after_its_first_stage_has_a_page_of_that(finished: Path, tmp_path: Path):
    killed = tmp_path / "clutch"
    shutil.copytree(finished, killed)
    (killed / PAGE).unlink()
    lines = (killed / FILE).read_text().splitlines(keepends=True)
    (killed / FILE).write_text("".join(lines[: next(i for i, one in enumerate(lines) if "work tolerances" in one)]))
    found = aleator("report", str(killed))
    assert found["missing"] == [
        "'tolerances' is not finished: work tolerances, limits is missing.",
        "'allocation' is not finished: what it follows from is missing.",
        "'front' is not finished: solve Assembly is missing.",
    ]
    assert found["verdict"].startswith("The study was stopped")
    page = (killed / PAGE).read_text(encoding="utf-8")
    assert "Not reached or not completed: tolerances, allocation and front." in page
    assert "gPC, order 3" in page
