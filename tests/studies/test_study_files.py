"""Study files in TOML: what they change, and one sentence with its line for each thing that is wrong."""

import json
import random
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import aleator as al
import bars
from aleator import cli
from aleator.studies import Study, load, schema

WHOLE = """\
problem = "bars_of_a_file:problem"
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
    monkeypatch.chdir(tmp_path)
    path = list(sys.path)
    (tmp_path / "bars_of_a_file.py").write_text(bars.FILE)
    yield tmp_path
    sys.modules.pop("bars_of_a_file", None)
    sys.path[:] = path


def loaded(text: str) -> Study:
    Path("bar.toml").write_text(text, encoding="utf-8")
    study = load("bar.toml")
    assert isinstance(study, Study)
    return study


def test_a_file_changes_numbers_limits_margins_expansion_and_solver_in_their_units(here: Path):
    study = loaded(WHOLE)
    assert list(study.problems) == ["nominal", "robust"]
    solution = al.solve(study.problems["robust"], al.solvers.Slsqp())
    # Loads of 2 ± 0.3 kN: their mean and two standard deviations at 0.6 kN/mm.
    assert solution.objective == pytest.approx((2.0 + 2 * 0.3 / np.sqrt(3)) / 0.6, rel=1e-6)
    assert study.problems["robust"].expansion.order == 4
    assert study.samples == 2000
    assert study.solves == 2 + 2


@pytest.mark.parametrize(
    ("text", "load"),
    [
        ("load = 2.0", 2.0),
        ('load = "2000 N"', 2.0),
        ('load = "2000 ± 30 N"', al.Toleranced(2.0, tolerance=0.03)),
        ('load = "2 +0.3/-0.1 kN"', al.Toleranced(2.0, plus=0.3, minus=0.1)),
        ('load = "2000 +300/+100 N"', al.Toleranced(2.0, plus=0.3, minus=-0.1)),
        ('load = { distribution = "Normal", mean = 2, std = "100 N" }', al.Normal(2.0, 0.1)),
        (
            'load = { distribution = "Normal", mean = { start = "2 kN", upper = "3000 N" }, std = 0.1 }',
            al.Normal(al.Decision(2.0, upper=3.0), 0.1),
        ),
        ('load = { distribution = "Beta", alpha = 2, beta = 5, lower = "1 kN", upper = "2 kN" }',
         al.Beta(alpha=2.0, beta=5.0, lower=1.0, upper=2.0)),
    ],
)  # fmt: skip
def test_quantities_are_those_that_python_would_declare(here: Path, text: str, load):
    (problem,) = loaded(f'problem = "bars_of_a_file:problem"\n[model]\n{text}\n').problems.values()
    found = problem.system.load
    assert str(found) == str(load)


def test_a_tolerance_of_a_positive_number_is_refused_with_the_distribution_that_is_taken(here: Path):
    head = 'problem = "bars_of_a_file:problem"\n[model]\nload = { start = 1.0 }\nwidth = '
    with pytest.raises(al.ProblemError, match="'width' must stay positive") as refused:
        loaded(f'{head}"27.645 +0.05/-0.02 mm"\n')
    advised = re.search(r"write (TruncatedNormal)\((.*?)\)", str(refused.value))
    assert advised is not None
    (problem,) = loaded(f'{head}{{ distribution = "{advised[1]}", {advised[2]} }}\n').problems.values()
    found = problem.system.width
    # The zone of the drawing, whose half-width is three standard deviations.
    assert [float(one) for one in found.support()] == pytest.approx([27.625, 27.695])
    assert found.parameters["scale"] == pytest.approx(0.035 / 3)


def test_a_check_prints_the_plain_numbers_of_the_model_with_their_units(here: Path):
    text = 'problem = "bars_of_a_file:problem"\n[model]\nload = "0.0012 MN"\n'
    Path("bar.toml").write_text(text, encoding="utf-8")
    told = CliRunner().invoke(cli.application, ["check", "bar.toml"])
    assert re.search(r"load\s*│\s*1\.2\s*kN", told.output), told.output
    assert not re.search(r"width\s*│", told.output)
    found = json.loads(CliRunner().invoke(cli.application, ["check", "bar.toml", "--json"]).stdout)
    (problem,) = found["problems"].values()
    assert problem["numbers"] == {"load": {"value": pytest.approx(1.2), "unit": "kN"}}


def test_two_bounds_make_a_limit_on_a_mean_two_sided(here: Path):
    with Path("bars_of_a_file.py").open("a", encoding="utf-8") as file:
        file.write('\nheavy = al.Problem(bar, minimize=stress.std, subject_to=[al.output("mass").mean >= 1.0])\n')
    (problem,) = loaded('problem = "bars_of_a_file:heavy"\n[limits]\nmass = ["2 mm", "0.3 cm"]\n').problems.values()
    assert [(float(one.lower), float(one.upper)) for one in problem.constraints] == [(2.0, 3.0)]


def test_a_file_runs_to_its_report(here: Path):
    Path("bar.toml").write_text(WHOLE, encoding="utf-8")
    result = CliRunner().invoke(cli.application, ["run", "bar.toml"])
    assert result.exit_code == 0, result.output
    assert "Bars" in Path("results/bar/report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("samples = 2000", "sampels = 2000", 3, "sampels: is unknown. Did you mean 'samples'?"),
        ("samples = 2000", 'samples = "many"', 3, "samples: input should be a valid integer"),
        ("samples = 2000", "samples = 1", 3, "samples: input should be greater than or equal to 2"),
        ("bars_of_a_file:problem", "bars_of_a_file:problems", 1, "no 'problems'. Did you mean 'problem'?"),
        ("bars_of_a_file:problem", "no_such_module:problem", 1, "There is no module 'no_such_module'"),
        ("load = {", "laod = {", 8, "laod: the model has no number of this name. Did you mean 'load'?"),
        ('"2000 N"', '"2000 kg"', 8, "expected a unit that can be converted to 'kN'; received 'kg'"),
        ('"2000 N"', '"a lot"', 8, "expected a quantity"),
        ('"2000 N"', "nan", 8, "finite"),
        ('"Uniform"', '"Unifrom"', 8, "model.load.distribution"),
        ('"2000 N"', "true", 8, "input should be a valid number"),
        ("stress = 2\n", 'stress = "2"\n', 15, "valid number"),
        ('{ distribution = "Uniform", mean', '{ distribution = "Beta", alpha = "2", mean', 8, "received the text '2'"),
        ('stress = "600 N/mm"', "stress = [0.5, 0.6]", 12, "Constraint 'stress': expected one number"),
        ("half_width = 0.3", "halfwidth = 0.3", 8, "Uniform has no parameter 'halfwidth'"),
        ("half_width = 0.3", "half_width = -0.3", 8, "half_width"),
        ("lower = 0.1", "lower = 70", 9, "A Decision"),
        ("lower = 0.1", "least = 0.1", 9, "least: is unknown"),
        ('stress = "600 N/mm"', 'strain = "600 N/mm"', 12, "strain"),
        ('stress = "600 N/mm"', 'stress = "600 N"', 12, "expected a unit that can be converted to 'kN/mm'"),
        ("stress = 2\n", "stress = -2\n", 15, "greater than 0"),
        ("order = 4", "order = 0.5", 18, "valid integer"),
        ('"Slsqp"', '"SLSQP"', 21, "solver.name"),
        ("max_iterations", "max_iteratoins", 20, "Did you mean 'max_iterations'?"),
        ("[0.5,", "[", 25, ""),
        ("title =", "title", 2, "expected TOML"),
        ('[sweeps]\nstress = [0.5, "0.6 kN/mm"]', "[grid]\nsteps = 5", 24, "the model has no time"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_line(here: Path, old: str, new: str, line: int, said: str):
    assert WHOLE.count(old) >= 1
    text = WHOLE.replace(old, new, 1)
    Path("bar.toml").write_text(text, encoding="utf-8")
    result = CliRunner().invoke(cli.application, ["check", "bar.toml"])
    if not said:  # still right
        assert result.exit_code == 0
        return
    told = " ".join(result.output.split())
    assert result.exit_code == 2, result.output
    assert re.search(rf"bar.toml, line {line}\b|at line {line}\b", told), told
    assert said in told


def test_two_hundred_files_with_something_wrong_end_in_one_sentence_each(here: Path):
    generator = random.Random(0)
    keys = ["problem", "title", "samples", "deterministic", "load", "width", "stress", "order", "name", "mean", "start"]
    values = ['"?"', "[]", "{}", "nan", "-1e400", "[[1]]", "{ a = 1 }", "1979-05-27", '"3 parsec/fortnight"', "true"]
    said = list[str]()
    for _ in range(200):
        key = generator.choice(keys)
        if generator.random() < 0.4:
            at = generator.randrange(len(key))
            text = re.sub(rf"\b{key}\b(?= =)", key[:at] + "x" + key[at:], WHOLE, count=1)
        else:
            text = re.sub(rf"(\b{key} = )([^,\n}}]+)", rf"\g<1>{generator.choice(values)}", WHOLE, count=1)
        Path("bar.toml").write_text(text, encoding="utf-8")
        try:
            load("bar.toml")
        except al.ProblemError as error:
            said.append(str(error))
    assert len(said) > 150
    assert [one for one in said if not re.search(r"line \d+", one) or "\n" in one] == []


def test_the_schema_names_every_key_and_is_printed():
    result = CliRunner().invoke(cli.application, ["schema"])
    assert result.exit_code == 0
    assert set(schema()["properties"]) >= {"problem", "model", "limits", "sigmas", "sweeps", "grid", "solver"}
    assert '"Uniform"' in result.output
