"""Stacks of toleranced parts, some of them bought: a shaft in its housing, and a motor (inch).

Fortini 1967; Chase, Tolerance Allocation Methods for Designers, ADCATS 99-6; Dimensioning and Tolerancing Handbook,
chapter 9. All of it is linear, so that the right values are closed forms.
"""

import pytest

import aleator as al

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
