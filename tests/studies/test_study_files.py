"""Studies of one's own, from a file in Python or TOML to the report; what is wrong in it has its line."""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import xarray

import aleator as al
import command_line
from aleator.studies import Study, load
from zoo import SPREAD

NEEDED = 1.0 + 3.0 * SPREAD  # the width is NEEDED / stress

# A bar as a file that a user writes.
FILE = '''"""A bar that carries an uncertain load."""

import aleator as al


class Bar(al.AlgebraicSystem):
    width: al.Number = al.parameter("mm", positive=True)
    load: al.Number = al.parameter("kN")
    units = {"stress": "kN/mm", "mass": "mm"}

    def outputs(self):
        return {"stress": self.load / self.width, "mass": self.width}


stress = al.output("stress")
bar = Bar(al.Decision(4.0, 0.1, 10.0), al.Uniform(1.0, half_width=0.3))
strong = (stress.mean + 3 * stress.std <= 0.5).named("stress")
problem = al.Problem(bar, minimize=al.output("mass").mean, subject_to=[strong])
'''

SWEPT = (
    FILE
    + """
study = al.Study(
    {"robust": problem},
    title="Bar [v2]",
    samples=500,
    sweeps={"stress": [0.5, 0.8]},
    wishes={"mass": al.output("mass").mean, "stress": stress.std},
    points=3,
)
"""
)

WHOLE = """\
problem = "bar:problem"
title = "Bars"
samples = 2000
seed = 3
deterministic = true

[model]
load = { distribution = "Uniform", mean = "2000 N", half_width = 0.3 }
width = { start = "0.5 cm", lower = 0.1, upper = "10 cm" }

[limits]
stress = "600 N/mm"

[sigmas]
stress = 2

[expansion]
order = 4

[solver]
name = "Slsqp"
max_iterations = 50

[sweeps]
stress = [0.5, "0.6 kN/mm"]
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder to work in, with a study file, whose modules are forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    known, path = set(sys.modules), list(sys.path)
    (tmp_path / "bar.py").write_text(FILE)
    yield tmp_path
    for name in set(sys.modules) - known:
        if name in ("bar", "bracket", "wrong"):
            del sys.modules[name]
    sys.path[:] = path


def aleator(*arguments: str):
    """The exit code of a command, and what it says in one line."""
    result = command_line.aleator(*arguments)
    return result.exit_code, " ".join(result.output.split())


def loaded(text: str) -> Study:
    Path("bar.toml").write_text(text, encoding="utf-8")
    study = load("bar.toml")
    assert isinstance(study, Study)
    return study


# --- In Python -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_declared_study_sweeps_and_trades_off(here: Path):
    (here / "bar.py").write_text(SWEPT)
    code, said = aleator("run", "bar.py")
    assert code == 0, said
    assert "evidence on robust" in said
    folder = here / "results/bar"
    designs = json.loads((folder / "designs.json").read_text())
    assert designs["designs/robust"]["objective"]["value"] == pytest.approx(NEEDED / 0.5, rel=1e-6)
    page = (folder / "report.html").read_text()
    assert "Bar [v2]" in page
    assert "Trade-off: mass against stress" in page
    for value in NEEDED / np.array([0.5, 0.8]):
        assert f"{value:.3g}" in page
    with xarray.open_datatree(folder / "results.nc", engine="h5netcdf") as tree:
        along = {name: one.to_dataset() for name, one in tree["along/stress"].children.items()}
    assert list(along) == ["stress = 0.5", "stress = 0.8"]
    for one in along.values():
        # No load is above the NEEDED one.
        assert float(one["violation"].sel(limit="stress")) == 0.0


def test_an_importable_module_is_a_study_of_which_a_quick_run_takes_fewer_samples_and_points(here: Path):
    (here / "bar.py").write_text(SWEPT + "\ndef declared():\n    return problem\n")
    sys.path.insert(0, str(here))
    for place in ("bar:problem", "bar:declared"):
        assert len(load(place).problems) == 1
    study = load("bar.py", quick=True)
    assert isinstance(study, Study)
    assert study.samples == 500 // 20
    assert study.solves == 1 + 1 + 2
    assert "all samples" in study.left_out
    declared = al.Study(study.problems, samples=500, sweeps={"stress": [0.5, 0.8]}, quick=True)
    assert (declared.samples, declared.solves) == (500 // 20, 1 + 1)
    assert declared.with_workers(3).workers == 3
    assert declared.workers is None


def test_what_is_done_is_told_before_anything_is_spent(here: Path):
    (here / "bar.py").write_text(SWEPT)
    code, said = aleator("check", "bar.py")
    assert code == 0, said
    assert "minimise μ[mass]" in said
    assert "Uniform(mean=1, half_width=0.3) kN " in " ".join(said.split())
    assert re.search(r"collocation points \d+", said)
    assert re.search(r"decisions 1 ", said)
    assert "agree with differences" in said
    assert "6 solves in all" in said
    (here / "alone.py").write_text(SWEPT[: SWEPT.index("study")] + "study = al.Study(problem)\n")
    assert "1 solve in all" in aleator("check", "alone.py")[1]
    code, said = aleator("check", ".")
    assert code == 2
    assert "There is no study '.'" in said
    assert not (here / "results").exists()


@pytest.mark.slow
def test_a_new_study_runs_as_it_is(here: Path):
    assert aleator("new", "bracket.py")[0] == 0
    assert aleator("new", "bracket.py")[0] == 2  # it exists already
    code, said = aleator("run", "bracket.py")
    assert code == 0, said
    designs = json.loads((here / "results/bracket/designs.json").read_text())
    assert {one["status"] for one in designs.values()} == {al.Status.SOLVED.value}


WRONG = {
    "a slip": (
        "wrong.py",
        "import aleator as al\nx = 1 / 0\n",
        "wrong.py, line 2: ZeroDivisionError: division by zero",
    ),
    "no study": ("wrong.py", "import aleator as al\n", "expected a study, such as"),
    "a missing file": ("missing.py", "", "There is no file 'missing.py'"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_study_that_is_wrong_or_not_there_is_refused_with_its_line(here: Path, what: str):
    name, text, said = WRONG[what]
    (here / "wrong.py").write_text(text)
    code, told = aleator("run", name)
    assert code == 2, told
    assert said in told
    assert "Traceback" not in told


# --- In TOML ---------------------------------------------------------------------------------------------------------


def test_a_file_changes_numbers_limits_margins_expansion_and_solver_in_their_units(here: Path):
    study = loaded(WHOLE)
    assert list(study.problems) == ["nominal", "robust"]
    solution = al.solve(study.problems["robust"], al.solvers.Slsqp())
    # Loads of 2 ± 0.3 kN: their mean and two standard deviations at 0.6 kN/mm.
    assert solution.objective == pytest.approx((2.0 + 2 * 0.3 / np.sqrt(3)) / 0.6, rel=1e-6)
    assert study.problems["robust"].expansion.order == 4
    assert study.samples == 2000
    assert study.solves == 2 + 2


MISTAKES = [
    ("samples = 2000", "sampels = 2000", 3, "sampels: is unknown. Did you mean 'samples'?"),
    ("load = {", "laod = {", 8, "laod: the model has no number of this name. Did you mean 'load'?"),
    ('"2000 N"', '"2000 kg"', 8, "expected a unit that can be converted to 'kN'; received 'kg'"),
    ('"2000 N"', "nan", 8, "finite"),
    ('stress = "600 N/mm"', 'strain = "600 N/mm"', 12, "strain"),
    ("title =", "title", 2, "expected TOML"),
]


@pytest.mark.parametrize(("old", "new", "line", "said"), MISTAKES)
def test_what_is_wrong_is_told_with_its_line(here: Path, old: str, new: str, line: int, said: str):
    assert WHOLE.count(old) >= 1
    Path("bar.toml").write_text(WHOLE.replace(old, new, 1), encoding="utf-8")
    code, told = aleator("check", "bar.toml")
    assert code == 2, told
    assert re.search(rf"bar.toml, line {line}\b|at line {line}\b", told), told
    assert said in told
