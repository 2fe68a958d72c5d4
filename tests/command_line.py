"""The command line in this process, and the folder of a run of a small study that tests copy."""

import contextlib
import functools
import io
import json
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import aleator_command
from aleator import solving
from aleator.cli._run import Record
from zoo import SPREAD

STUDY = """import aleator as al
from zoo import MASS, STRESS, bar_problem

problem = bar_problem()
study = al.Study(
    {"nominal": al.deterministic(problem), "robust": problem},
    title="Bar",
    samples=4000,
    sweeps={"stress": [0.5, 0.6]},
)
"""
# An edited form of it, with one design alone.
EDITED = STUDY[: STUDY.index("study")].replace("()", "(load=1.1)")
EDITED += "study = al.Study({'robust': problem}, samples=200)\n"
# The width of the bar times the bound of its stress; the same of the edited study.
NEEDED, NEEDED_NOW = 1.0 + 3.0 * SPREAD, 1.1 + 3.0 * SPREAD


@dataclass
class Ended:
    """How a command ended, and what it printed."""

    exit_code: int
    stdout: str
    stderr: str

    @property
    def output(self) -> str:
        return self.stdout + self.stderr


def aleator(*arguments: str) -> Ended:
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        code = aleator_command.execute(arguments)
    return Ended(code, out.getvalue(), err.getvalue())


def document(result) -> dict:
    """The one JSON document on stdout, whose numbers are finite."""

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    return json.loads(result.stdout, parse_constant=refuse)


def said(result) -> str:
    return " ".join(result.output.split())


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a study to work in, whose module is forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bar.py").write_text(STUDY)
    path = list(sys.path)
    yield tmp_path
    sys.modules.pop("bar", None)
    sys.path[:] = path


@functools.cache
def _run_once(session: Path) -> Path:
    place, path = session / "finished run", list(sys.path)
    place.mkdir()
    (place / "bar.py").write_text(STUDY)
    result = aleator("run", str(place / "bar.py"), "--out", str(place / "results"))
    assert result.exit_code == 0, result.output
    sys.modules.pop("bar", None)
    sys.path[:] = path
    return place / "results"


@pytest.fixture
def finished(tmp_path_factory: pytest.TempPathFactory, here: Path) -> Path:
    """A copy of the folder of a complete run, beside its study."""
    shutil.copytree(_run_once(tmp_path_factory.getbasetemp()), here / "results")
    Record("bar.py").write(here / "results")
    return here / "results"


@pytest.fixture
def interrupted_at(monkeypatch: pytest.MonkeyPatch, python_interrupts):
    """Has Ctrl-C pressed in a solve of this process, by its number."""
    solve, done = solving._solve._solved, list[object]()

    def at(number: int) -> None:
        def stopped(call):
            done.append(call)
            if len(done) == number:
                raise KeyboardInterrupt
            return solve(call)

        done.clear()
        monkeypatch.setattr(solving._solve, "_solved", stopped)

    return at


@pytest.fixture
def nothing_solved(interrupted_at) -> None:
    """No solve may happen."""
    interrupted_at(1)
