"""Studies of one's own: from a file or a module to the report."""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import xarray
from typer.testing import CliRunner

import aleator as al
import bars
from aleator import cli
from aleator.studies import Study, load

SWEPT = (
    bars.FILE
    + """
study = al.Study(
    {"robust": problem},
    title="Bar [v2]",
    samples=2000,
    sweeps={"stress": [0.5, 0.6, 0.8]},
    wishes={"mass": al.output("mass").mean, "stress": stress.std},
    points=5,
)
"""
)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder to work in, whose modules are forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    known, path = set(sys.modules), list(sys.path)
    yield tmp_path
    for name in set(sys.modules) - known:
        if name in ("bar", "bracket", "wrong"):
            del sys.modules[name]
    sys.path[:] = path


def aleator(*arguments: str):
    return CliRunner().invoke(cli.application, list(arguments))


def test_a_file_with_a_problem_alone_is_a_study(here: Path):
    (here / "bar.py").write_text(bars.FILE)
    result = aleator("run", "bar.py")
    assert result.exit_code == 0, result.output
    designs = json.loads((here / "results/bar/designs.json").read_text())
    assert designs["designs/problem"]["objective"]["value"] == pytest.approx(bars.NEEDED / 0.5, rel=1e-6)
    assert (here / "results/bar/report.html").is_file()
    assert "evidence on problem" in result.output
    assert "earlier run" not in result.output
    assert "2 results were taken from an earlier run" in aleator("run", "bar.py").output
    assert "earlier run" not in aleator("run", "bar.py", "--afresh").output
    listed = aleator("list", "results/bar").output
    assert "solve Bar" in listed
    assert "validate Bar" in listed
    assert aleator("list", "results").exit_code == 2


def test_a_declared_study_sweeps_and_trades_off(here: Path):
    (here / "bar.py").write_text(SWEPT)
    assert aleator("run", "bar.py", "--out", "there").exit_code == 0
    page = (here / "there/report.html").read_text()
    assert "Bar [v2]" in page
    assert "Trade-off: mass against stress" in page
    front = al.pareto(load("bar.py").problems["robust"], "stress", [0.5, 0.6, 0.8])
    np.testing.assert_allclose(front.objectives, bars.NEEDED / np.array([0.5, 0.6, 0.8]), rtol=1e-6)
    for value in front.objectives:
        assert f"{value:.3g}" in page
    with xarray.open_datatree(here / "there/results.nc", engine="h5netcdf") as tree:
        along = {name: one.to_dataset() for name, one in tree["along/stress"].children.items()}
    assert list(along) == ["stress = 0.5", "stress = 0.6", "stress = 0.8"]
    for one in along.values():
        # No load is above the NEEDED one.
        assert float(one["violation"].sel(limit="stress")) == 0.0


def test_a_quick_run_takes_fewer_samples_and_points(here: Path):
    (here / "bar.py").write_text(SWEPT)
    study = load("bar.py", quick=True)
    assert isinstance(study, Study)
    assert study.samples == 100
    assert study.solves == 1 + 1 + 2
    assert "all samples" in study.left_out
    (here / "bar.py").write_text(bars.FILE)
    assert load("bar.py", quick=True).solves == 1


@pytest.mark.parametrize("place", ["bar", "bar:problem", "bar:declared"])
def test_an_importable_module_is_a_study(here: Path, place: str):
    (here / "bar.py").write_text(bars.FILE + "\ndef declared():\n    return problem\n")
    sys.path.insert(0, str(here))
    study = load(place if ":" in place else "bar.py")
    assert isinstance(study, Study)
    assert len(study.problems) == 1


def test_what_is_done_is_told_before_anything_is_spent(here: Path):
    (here / "bar.py").write_text(SWEPT)
    result = aleator("check", "bar.py")
    assert result.exit_code == 0, result.output
    told = " ".join(result.output.split())
    assert "minimise μ[mass]" in told
    assert re.search(r"collocation points │ \d+", told)
    assert re.search(r"decisions │ 1 ", told)
    assert "agree with differences" in told
    assert "9 solves in all" in told
    assert not (here / "results").exists()


def test_a_study_that_cannot_be_written_is_refused_in_words(here: Path):
    (here / "taken").write_text("a file in the place of a folder")
    result = aleator("new", "taken/bracket.py")
    assert result.exit_code == 2
    told = " ".join(result.output.split())
    assert "cannot be written" in told
    assert "name a file in a folder of your own" in told


def test_a_new_study_can_be_checked(here: Path):
    assert aleator("new", "bracket.py").exit_code == 0
    result = aleator("check", "bracket.py")
    assert result.exit_code == 0, result.output
    again = aleator("new", "bracket.py")
    assert again.exit_code == 2
    assert "exists already" in " ".join(again.output.split())


@pytest.mark.slow
def test_a_new_study_runs_as_it_is(here: Path):
    assert aleator("new", "bracket.py").exit_code == 0
    result = aleator("run", "bracket.py")
    assert result.exit_code == 0, result.output
    designs = json.loads((here / "results/bracket/designs.json").read_text())
    assert {one["status"] for one in designs.values()} == {al.Status.SOLVED.value}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("import aleator as al\nx = 1 / 0\n", r"wrong.py, line 2: ZeroDivisionError: division by zero"),
        ("def f(:\n", r"wrong.py, line 1: "),
        ("import aleator as al\n", "expected a study, such as"),
        ("study = 3\n", "wrong.py: study: expected AbstractStudy"),
        ("import nothing_of_this_name\n", "wrong.py, line 1: ModuleNotFoundError"),
        ("import aleator as al\nal.Study({})\n", "wrong.py, line 2: Study: designs: expected a problem"),
        ("import sys\nsys.exit(3)\n", "wrong.py, line 2: SystemExit: 3"),
    ],
)
def test_a_file_that_is_wrong_is_refused_with_its_line(here: Path, text: str, said: str):
    (here / "wrong.py").write_text(text)
    result = aleator("run", "wrong.py")
    assert result.exit_code == 2, result.output
    assert said in " ".join(result.output.split())
    assert "Traceback" not in result.output


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("missing.py", "There is no file 'missing.py'"),
        ("no_such_package.module", "There is no module 'no_such_package'"),
        ("json:problem", "the module has no 'problem'"),
        ("json:dumps", "json:dumps: TypeError"),
        ("bars", "There is no study 'bars'"),
    ],
)
def test_a_study_that_is_not_there_is_refused(here: Path, name: str, said: str):
    result = aleator("run", name)
    assert result.exit_code == 2
    assert said in " ".join(result.output.split())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"sweeps": {"strain": [1.0]}}, "strain"),
        ({"sweeps": {"stress": ["a"]}}, "sweep over 'stress'"),
        ({"samples": 1}, "samples"),
        ({"points": 1}, "points"),
        ({"wishes": {"mass": 3, "stress": 4}}, "wish 'mass'"),
        ({"wishes": {"mass": al.output("mass").mean}}, "two"),
        ({"solver": "ipopt"}, "solver"),
    ],
)
def test_a_study_that_cannot_be_run_is_refused_when_it_is_declared(here: Path, options: dict, said: str):
    (here / "bar.py").write_text(bars.FILE)
    problem = load("bar.py").problems["problem"]
    with pytest.raises(al.ProblemError, match=said):
        Study(problem, **options)
