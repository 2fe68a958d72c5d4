"""Stacks of toleranced parts, some of them bought: a shaft in its housing, and a motor (inch); tolerances in words.

Fortini 1967; Chase, Tolerance Allocation Methods for Designers, ADCATS 99-6; Dimensioning and Tolerancing Handbook,
chapter 9. All of it is linear, so that the right values are closed forms.
"""

import sys

import pytest

import aleator as al
from aleator.studies import load

pytestmark = pytest.mark.slow

BOUGHT = {"A": (0.0505, 0.0015), "C": (0.5093, 0.0025), "G": (0.5093, 0.0025)}
MADE = {"B": (8.0, 0.008), "D": (0.4, 0.002), "E": (7.711, 0.006), "F": (0.4, 0.002)}
ALLOWED, GAP = 0.015, 0.0199


def factor(part, tolerance: str, *limits) -> float:
    """The largest common factor of the tolerances of the parts that are made."""
    made = {name: part(size, **{tolerance: al.Decision(t, 1e-4, 0.1)}) for name, (size, t) in MADE.items()}
    bought = {name: part(size, **{tolerance: t}) for name, (size, t) in BOUGHT.items()}
    shares = {name: al.value(f"{name}.{tolerance}") / t for name, (_, t) in MADE.items()}
    problem = al.Problem(
        al.Assembly(made | bought, features={"gap": "-A + B - C + D - E + F - G"}),
        minimize=-shares["D"],
        subject_to=[*((shares[name] - shares["D"]).equals(0.0) for name in "BEF"), *limits],
        expansion=al.Expansion(order=1),
    )
    return -al.solve(problem).objective


def test_tolerances_of_a_shaft_and_its_housing_are_scaled_by_root_sum_square_and_by_the_worst_case():
    gap = al.output("gap")
    assert factor(al.Toleranced, "tolerance", 3 * gap.std <= ALLOWED) == pytest.approx(1.395263, abs=1e-6)
    worst = gap.at_most(GAP + ALLOWED, worst_case=True), gap.at_least(GAP - ALLOWED, worst_case=True)
    assert factor(al.Uniform, "half_width", *worst) == pytest.approx(0.472222, abs=1e-6)


MOTOR = {
    "A": ".375 +0/-.031",
    "B": ".032 ± .002",
    "C": ".060 ± .003",
    "D": ".438 +0/-.015",
    "E": ".120 ± .005",
    "F": "1.500 +.010/-.004",
    "G": ".120 ± .005",
    "H": ".438 +0/-.015",
    "I": ".450 ± .007",
    "J": "3.019 +.012/0",
    "K": ".300 ± .030",
}


def test_a_stack_of_unequal_tolerances_adds_up():
    parts = {name: al.toleranced(text) for name, text in MOTOR.items()}
    motor = al.Assembly(parts, features={"gap": "-A + B + C + D + E + F + G + H + I - J + K"})
    analysis = al.tolerance_analysis(motor, "gap", lower=0.0, expansion=al.Expansion(order=1))
    assert analysis.mean == pytest.approx(0.0615, abs=1e-6)
    assert analysis.worst_case == pytest.approx((-0.034, 0.157), abs=1e-6)
    assert analysis.rss == pytest.approx(0.0380756, abs=1e-6)
    assert analysis.std == pytest.approx(0.0126919, abs=1e-6)
    assert analysis.rejects_low == pytest.approx(0.631, rel=0.02)  # parts per million


# --- "50 +/- 10 V" in a study file (atopile/atopile#436 read it as 60 to 60 V) ----------------------------------------

SUPPLY = """
import aleator as al


class Supply(al.AlgebraicSystem):
    voltage: al.Number = al.parameter("V")
    temperature: al.Number = al.parameter("K")
    gain: al.Number = al.Decision(1.0, 0.5, 2.0)

    def outputs(self):
        return {"y": self.gain * self.voltage + self.temperature}


problem = al.Problem(Supply(50.0, 298.15), minimize=al.output("y").mean)
"""
ACCEPTED = {
    ("voltage", text): (40.0, 60.0)
    for text in (
        *("50 +/- 10 V", "50 +/- 10V", "50 V +/- 10 V", "50V ± 10V", "50 ± 10 V", "50 +10/-10 V", "50±10"),
        *("50 \N{MINUS SIGN}10/+10 V", "0.05 ± 0.01 kV", "50 +- 10 V"),
    )
} | {("voltage", "50 ±10 mV"): (0.04, 0.06), ("temperature", "298.15 ± 5 K"): (293.15, 303.15)}
REFUSED = {
    ("voltage", "50 ± 20 % V"): "'50 ± 10 V'",
    ("voltage", "50 ± 20 %"): "'50 ± 10 V'",
    ("voltage", "50,0 ± 10 V"): "'50.0 ± 10 V'",
    ("temperature", "25 ± 5 degC"): "'298.15 ± 5 K'",
    ("temperature", "77 ± 9 degF"): "'298.15 ± 5 K'",
}


@pytest.fixture
def supply(tmp_path, monkeypatch):
    """A function that reads a study file with a text for a number of the supply, and gives this number."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "supply_of_tests.py").write_text(SUPPLY)

    def read(name, text):
        file = f'problem = "supply_of_tests:problem"\n[model]\n{name} = "{text}"\n'
        (tmp_path / "supply.toml").write_text(file, encoding="utf-8")
        (problem,) = load("supply.toml").problems.values()
        return getattr(problem.system, name)

    yield read
    sys.modules.pop("supply_of_tests", None)


def test_tolerances_in_words_have_their_limits_or_are_refused_with_what_to_write(supply):
    for (name, text), limits in ACCEPTED.items():
        zone = supply(name, text)
        assert [float(one) for one in zone.limits()] == pytest.approx(limits, rel=1e-12), text
        assert float(zone.std()) == pytest.approx((limits[1] - limits[0]) / 6, rel=1e-9), text
    for (name, text), written in REFUSED.items():
        with pytest.raises(al.ProblemError, match=r"supply\.toml.*line 3") as refused:
            supply(name, text)
        assert written in str(refused.value)
