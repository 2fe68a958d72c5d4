"""Stacks of toleranced parts, some of them bought: a shaft in its housing, and a motor (inch).

Fortini 1967; Chase, Tolerance Allocation Methods for Designers, ADCATS 99-6; Dimensioning and Tolerancing Handbook,
chapter 9. All of it is linear, so that the right values are closed forms.
"""

import pytest

import aleator as al

pytestmark = pytest.mark.slow


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
