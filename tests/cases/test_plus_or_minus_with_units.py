"""'50 +/- 10 V' is 40 to 60 V, however it is written (atopile/atopile#436 read 60 to 60 V).

What is refused, with what to write instead, is in `tests/studies/test_quantities.py`.
"""

import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import aleator as al
from aleator import cli
from aleator.studies import Study, load

pytestmark = pytest.mark.slow

DIVIDER = """import aleator as al


class Divider(al.AlgebraicSystem):
    voltage: al.Number = al.parameter("V")
    warmth: al.Number = al.parameter("K")
    share: al.Number = 0.5
    units = {"out": "V", "drift": "K"}

    def outputs(self):
        return {"out": self.share * self.voltage, "drift": self.warmth}


out = al.output("out")
problem = al.Problem(
    Divider(al.Normal(48.0, 1.0), al.Normal(300.0, 1.0), al.Decision(0.5, 0.1, 0.9)),
    minimize=out.std,
    subject_to=[out.mean >= 20.0],
)
"""


@pytest.fixture
def model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Writes a study file whose table of the model is one line."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    Path("divider.py").write_text(DIVIDER)

    def written(line: str) -> str:
        Path("divider.toml").write_text(f'problem = "divider:problem"\n[model]\n{line}\n', encoding="utf-8")
        return "divider.toml"

    yield written
    sys.modules.pop("divider", None)


VOLTS = [
    *("50 +/- 10 V", "50 +/- 10V", "50 V +/- 10 V", "50V ± 10V", "50 ± 10 V", "50±10", "50 +- 10 V"),
    *("50 +10/-10 V", "50 \N{MINUS SIGN}10/+10 V", "50000 ± 10000 mV", "0.05 ± 0.01 kV"),
]
ZONES = [
    *(("voltage", text, (40.0, 60.0)) for text in VOLTS),
    ("voltage", "50 ±10 mV", (0.04, 0.06)),  # a unit at the end is that of both numbers
    ("warmth", "298.15 ± 5 K", (293.15, 303.15)),
]


def test_tolerances_in_study_files_are_those_that_they_read_as(model):
    for name, text, limits in ZONES:
        study = load(model(f'{name} = "{text}"'))
        assert isinstance(study, Study)
        (problem,) = study.problems.values()
        zone = getattr(problem.system, name)
        assert isinstance(zone, al.Toleranced), text
        assert [float(one) for one in zone.limits()] == pytest.approx(limits, rel=1e-15), text
        assert float(zone.std()) == pytest.approx((limits[1] - limits[0]) / 6, rel=1e-14), text


def test_a_check_prints_a_tolerance_and_refuses_another_zero_with_its_line(model):
    checked = CliRunner().invoke(cli.application, ["check", model('voltage = "50 +/- 10 V"')])
    assert checked.exit_code == 0
    # As mathematics, numbers are in the units of the model, which the table of numbers shows beside them.
    assert "voltage ~ Toleranced(nominal=50, tolerance=10, cp=1)" in checked.output
    assert "Toleranced(nominal=50, tolerance=10, cp=1) V " in " ".join(checked.output.split())
    for text in ("25 ± 5 degC", "77 ± 9 degF"):
        refused = CliRunner().invoke(cli.application, ["check", model(f'warmth = "{text}"')])
        said = " ".join(refused.output.split())
        assert refused.exit_code == 2
        assert "divider.toml, line 3" in said
        assert "Write '298.15 ± 5 K'" in said


def test_a_dimension_of_its_own_takes_no_unit():
    assert [float(one) for one in al.toleranced("50 +/- 10").limits()] == [40.0, 60.0]
    with pytest.raises(al.ProblemError, match="without a unit"):
        al.toleranced("50 +/- 10 V")
