"""Expansions of unbounded germs against closed forms: default points cover the tails, and others are told of."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from zoo import cases

NORMAL = al.Normal(0.0, 1.0)


def correlated(correlation):
    distribution = al.Uniform.bounds(0.0, 1.0)
    return al.correlated({"x": distribution, "y": distribution}, {("x", "y"): correlation})


def expanded_and_warnings(function, distributions, expansion):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        expanded = al.expand(function, distributions, expansion)
    return expanded, " ".join(str(one.message) for one in told)


# The standard deviation of each output in closed form, but for the logistic's, by a rule of 200 points.
NODES, MASSES = np.polynomial.hermite_e.hermegauss(200)
LOGISTIC = MASSES @ (1 / (1 + np.exp(-2 * NODES)) - 0.5) ** 2 / np.sqrt(2 * np.pi)
CASES = {
    "difference of correlated distributions": (lambda m: m["x"] - m["y"], correlated(0.8), np.sqrt(0.4 / 12)),
    "logistic": (lambda m: jax.nn.sigmoid(2 * m["x"]), {"x": NORMAL}, np.sqrt(LOGISTIC)),
    "decay": (
        lambda m: jnp.exp(-m["x"]) * m["y"],
        {"x": al.Gamma(shape=2.0, scale=1.0), "y": al.Normal(1.0, 0.3)},
        np.sqrt(1.09 / 9 - 1 / 16),
    ),
}


@pytest.mark.parametrize("order", cases([10, 3]))
@pytest.mark.parametrize("case", CASES)
def test_spreads_by_default_points_are_those_of_the_closed_form_or_warned_of(case, order):
    function, distributions, std = CASES[case]
    expanded, told = expanded_and_warnings(function, distributions, al.Expansion(order))
    assert float(expanded.std) == pytest.approx(std, rel=0.03 if not told else 0.15)
    assert order < 10 or not told


@pytest.mark.parametrize("case", cases(CASES))
def test_even_points_that_extrapolate_are_told_of_with_the_points_to_take(case):
    function, distributions, std = CASES[case]
    try:
        expanded, told = expanded_and_warnings(
            function, distributions, al.Expansion(8, points=al.points.HammersleyPoints())
        )
    except al.ProblemError:
        return  # the matrix is refused, which is no silence
    assert told or float(expanded.std) == pytest.approx(std, rel=0.03)
    if float(expanded.leave_one_out) <= 0.05 < float(expanded.jackknife):
        assert "into the tails" in told
        assert "al.points.InducedPoints() or al.points.GaussPoints()" in told
        assert "EXTRAPOLATED" in str(expanded)


def test_the_jackknife_error_is_how_far_refits_without_each_point_move_the_coefficients():
    function = lambda m: jnp.tanh(m["x"]) * m["y"]  # noqa: E731
    expanded = al.expand(function, {"x": NORMAL, "y": NORMAL}, al.Expansion(4, tolerance=9.0))
    points = expanded.collocation
    roots, samples = np.sqrt(np.asarray(points.weights)), np.asarray(expanded.samples)
    matrix, moved = np.asarray(points.matrix) * roots[:, None], 0.0
    for k in range(len(samples)):
        rest = np.arange(len(samples)) != k
        refit = np.linalg.lstsq(matrix[rest], (roots * samples)[rest], rcond=None)[0]
        moved += np.sum((refit - np.asarray(expanded.coefficients)) ** 2)
    variance = np.average((samples - np.average(samples, weights=roots**2)) ** 2, weights=roots**2)
    assert float(expanded.jackknife) == pytest.approx(np.sqrt(moved / variance), rel=1e-8)
