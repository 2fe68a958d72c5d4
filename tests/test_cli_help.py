"""Help, completion and progress of the command line."""

import io
import re
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from aleator import cli
from aleator.cli._options import names_of_studies
from aleator.cli._progress import _Lines, shown
from aleator.cli._record import Record
from aleator.cli._sweep import numbers

COMMANDS = [one.name for one in cli.application.registered_commands]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_shows_an_example_on_one_line(name: str):
    result = CliRunner().invoke(cli.application, [f"{name}", "--help"])
    assert result.exit_code == 0
    assert re.search(rf"^\s*aleator {name}\b", result.output, re.MULTILINE)


def examples_of(command: str) -> list[str]:
    """The examples of a command's help."""
    shown = CliRunner().invoke(cli.application, [command, "--help"], terminal_width=200).output
    return [line.strip() for line in shown.splitlines() if line.strip().startswith(f"aleator {command} ")]


def test_examples_name_limits_and_designs_that_their_studies_have(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(cli.application, ["new", "bracket.py"]).exit_code == 0
    over = [re.fullmatch(r"aleator sweep (\S+) --bound (\S+) --values (\S+).*", line) for line in examples_of("sweep")]
    assert over
    for one in over:
        assert one is not None
        study, bound, values = one.groups()
        assert Record(study, bound=bound, values=numbers(values)).made().stages
    named = [re.search(r"(bracket\.py).* --design (\S+)", line) for line in examples_of("validate")]
    for study, design in [one.groups() for one in named if one]:
        assert design in Record(study).made().problems


def test_the_shell_completes_names_of_studies():
    asked = {"_ALEATOR_COMPLETE": "complete_bash", "COMP_WORDS": "aleator run sus", "COMP_CWORD": "2"}
    result = CliRunner().invoke(cli.application, [], env=asked, prog_name="aleator")
    assert result.output.split() == ["suspension"]


def test_completion_offers_study_files_and_folders_beside_the_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    for name in ("suspended.py", "sums.toml", "sunk.txt", "[odd].py"):
        (tmp_path / name).touch()
    (tmp_path / "sub").mkdir()
    assert names_of_studies("su") == ["sub/", "sums.toml", "suspended.py", "suspension"]
    assert names_of_studies("[o") == ["[odd].py"]
    assert names_of_studies(str(tmp_path)) == []


def lines(calls: list[tuple[float, str, int, int]]) -> list[str]:
    """What is printed of progress at some times (s)."""
    file, times = io.StringIO(), iter([0.0, 0.0, *(time for time, *_ in calls)])
    told = _Lines(Console(file=file, width=200), lambda: next(times))
    told.begin("front")
    for _, task, done, total in calls:
        told.show(task, done, total)
    return file.getvalue().splitlines()


def test_each_point_is_a_line_with_the_time_that_is_left():
    found = lines([(0.0, "front", 0, 3), (2.0, "front: a", 1, 3), (4.0, "front: b", 2, 3), (9.0, "front: c", 3, 3)])
    assert found == ["  front: a, 1 of 3, about 4 s left", "  front: b, 2 of 3, about 2 s left", "  front: c, 3 of 3"]


def test_many_steps_are_told_now_and_then():
    found = lines([(float(step), "samples", step, 1000) for step in range(25)])
    assert found == ["  samples, 11 of 1000, about 16 min left", "  samples, 22 of 1000, about 16 min left"]


def test_other_work_in_a_stage_has_its_own_time():
    found = lines([(50.0, "first", 1, 1), (100.0, "second", 0, 2), (101.0, "second", 1, 2)])
    assert found == ["  first, 1 of 1", "  second, 1 of 2, about 1 s left"]


@pytest.mark.parametrize("is_terminal", [True, False])
def test_only_a_terminal_gets_control_characters(is_terminal: bool):
    file = io.StringIO()
    with shown(
        Console(file=file, force_terminal=is_terminal, width=200, markup=False, highlight=False), 1.0
    ) as progress:
        progress.begin("front")
        progress.show("front: [x] = 1, objective 2", 1, 1)
        progress.end("front", 1.0, "0.5 s")
    assert ("\x1b" in file.getvalue()) == is_terminal
    assert "front: [x] = 1, objective 2" in file.getvalue()
    assert "front: 0.5 s" in file.getvalue()
