"""Data with seven equal leading digits (NIST StRD, NumAcc3 and NumAcc4)."""

from fractions import Fraction

import pytest

import aleator as al

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("base", [1e6, 1e7], ids=["NumAcc3", "NumAcc4"])
def test_certified_moments_of_data_with_equal_leading_digits(base):
    # Of 1001 numbers around base + 0.2, 1000 deviate by 0.1; the certified standard deviation, 0.1, is that with n - 1.
    x = {"x": al.Sample([base + 0.2, *[base + 0.1, base + 0.3] * 500])}
    itself, square, shifted = (
        al.expand(function, x, al.Expansion(order=2))
        for function in (lambda at: at["x"], lambda at: at["x"] ** 2, lambda at: (at["x"] - base) ** 2)
    )
    assert itself.mean == pytest.approx(base + 0.2, rel=1e-15)
    assert itself.std == pytest.approx(0.0999500374687773, rel=1e-6)
    centre, variance = Fraction(base) + Fraction(2, 10), Fraction(10, 1001)
    assert square.mean == pytest.approx(float(centre**2 + variance), rel=1e-15)
    assert shifted.mean == pytest.approx(0.04 + 10 / 1001, rel=1e-6)
