"""What an expansion says of itself: relative rms errors, the condition of its matrix, corners without a point."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.expansion import unseen
from aleator.expansion._basis import Basis
from aleator.uncertainty import HermiteGerm, LegendreGerm

MEAN, STD = 1.0, 0.1
W = {"w": al.Normal(MEAN, STD)}


def expanded_and_warned(function, distributions, expansion):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        expanded = al.expand(function, distributions, expansion)
    return expanded, any(issubclass(one.category, al.ExpansionWarning) for one in told)


@pytest.mark.parametrize("k", [1.0, 10.0])
def test_an_expansion_that_is_not_warned_of_has_the_spread_of_the_closed_form(k):
    first = np.cos(k * MEAN) * np.exp(-((k * STD) ** 2) / 2)
    variance = (1 + np.cos(2 * k * MEAN) * np.exp(-2 * (k * STD) ** 2)) / 2 - first**2
    verdicts = []
    for order in (3, 8):
        expanded, warned = expanded_and_warned(lambda m: jnp.cos(k * m["w"]), W, al.Expansion(order))
        assert warned or float(expanded.variance) == pytest.approx(variance, rel=0.05)
        verdicts.append(warned)
    assert verdicts == [k == 10.0, False]


def test_a_matrix_that_loses_digits_is_warned_of_and_its_condition_is_printed():
    with pytest.warns(al.ExpansionWarning, match=r"condition number \d\.\de\+0[67].*Use more points"):
        expanded = al.expand(lambda m: m["w"], W, al.Expansion(14, points=al.points.HammersleyPoints()))
    basis = np.polynomial.hermite_e.hermevander(np.asarray(expanded.collocation.points)[:, 0], 14)
    basis /= np.sqrt([float(np.prod(np.arange(1, n + 1))) for n in range(15)])
    assert f"points, condition number {np.linalg.cond(basis):.3g}" in str(expanded)
    assert float(expanded.collocation.condition_number) == pytest.approx(np.linalg.cond(basis), rel=1e-3)


def test_the_corner_without_a_point_is_the_one_that_is_furthest_from_all_points():
    germs = {"u": LegendreGerm(), "n": HermiteGerm()}
    basis = Basis(germs, np.array([[0, 0], [1, 0], [0, 1]]))
    levels = np.array([[0.1, 0.1], [0.15, 0.8], [0.9, 0.2], [0.6, 0.7]])
    corner = unseen(basis, basis.map_to_germ(levels))
    # At the high, high end the nearest point is 0.4 and 0.3 away: 0.4² of all systems lie nearer.
    assert corner.ends == {"u": "high", "n": "high"}
    assert corner.share == pytest.approx(0.4, rel=1e-9)
    assert corner.probability == pytest.approx(0.16, rel=1e-9)
    assert corner.sentence() == (
        "the largest corner without a point (u high, n high, the outermost 40 % of each) holds 16 % of all systems"
    )
