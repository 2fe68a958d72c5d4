"""The leave-one-out error against refits without each point."""

import numpy as np
import pytest

import aleator as al
from aleator.expansion import collocate as discretise
from aleator.expansion import leave_one_out, mean_squares, relative_error
from aleator.uncertainty import HermiteGerm, LegendreGerm
from compiling import compiled

GERMS = {"u": LegendreGerm(), "n": HermiteGerm()}


def collocate(germs, expansion):
    return discretise(germs, expansion).collocation


@compiled
def error(collocation, samples):
    return leave_one_out(collocation, samples, collocation.coefficients(samples))


@compiled
def by_entry(collocation, samples):
    parts = mean_squares(collocation, samples, collocation.coefficients(samples))
    return relative_error(*parts).reshape(samples.shape[1:])


def error_of(collocation, samples):
    return float(error(collocation, samples))


def scalar(points):
    x = np.asarray(points)
    return np.exp(0.4 * x[:, 0]) * np.sin(x[:, 1]) + x[:, 0] ** 5


def histories(points):
    times, x = np.linspace(0.0, 3.0, 7)[None, :], np.asarray(points)
    return np.exp(-times * (1 + 0.5 * x[:, :1])) * (2 + x[:, 1:2])


@pytest.mark.parametrize("points", [al.points.HammersleyPoints(), al.points.ChristoffelPoints(30)])
@pytest.mark.parametrize("output", [scalar, histories])
def test_the_error_is_that_of_refitting_without_each_point(output, points):
    collocation = collocate(GERMS, al.Expansion(3, points=points))
    matrix, weights = np.asarray(collocation.matrix), np.asarray(collocation.weights)
    samples, roots = output(collocation.points).reshape(30, -1), np.sqrt(weights)[:, None]
    squares = np.zeros(samples.shape)
    for k in range(len(samples)):
        others = np.arange(len(samples)) != k
        refit = np.linalg.lstsq((matrix * roots)[others], (samples * roots)[others], rcond=None)[0]
        squares[k] = (samples[k] - matrix[k] @ refit) ** 2
    variance = weights @ (samples - weights @ samples) ** 2
    expected = np.sqrt((weights @ squares).sum() / variance.sum())
    assert error_of(collocation, output(collocation.points)) == pytest.approx(expected, rel=1e-7)


def test_the_error_of_a_constant_output_is_zero_in_spite_of_rounding_and_a_small_variation_still_counts():
    collocation = collocate(GERMS, al.Expansion(3, points=al.points.HammersleyPoints()))
    for constant in (0.0, 0.1, 1 / 3, np.pi, -1e9, 1e-300):
        assert error_of(collocation, np.full(30, constant)) == 0.0
    varying = scalar(collocation.points)
    assert error_of(collocation, 1e4 + 1e-2 * varying) == pytest.approx(error_of(collocation, varying), rel=1e-5)


def test_interpolation_and_projection_by_a_sparse_grid_leave_nothing_to_check_by_so_the_error_is_infinite():
    for expansion in (
        al.Expansion(3, points=10),
        al.Expansion(3, points=al.points.SmolyakPoints(), fit=al.fits.Projection()),
    ):
        collocation = collocate(GERMS, expansion)
        assert error_of(collocation, scalar(collocation.points)) == np.inf


def test_samples_that_are_not_finite_do_not_pass_for_a_good_fit():
    collocation = collocate(GERMS, al.Expansion(3, points=al.points.HammersleyPoints()))
    for bad in (np.nan, np.inf):
        samples = np.array(scalar(collocation.points))
        samples[3] = bad
        assert not error_of(collocation, samples) <= 0.5


def test_the_error_of_each_entry_is_that_of_the_entry_alone():
    collocation = collocate(GERMS, al.Expansion(3, points=al.points.ChristoffelPoints(30)))
    one = histories(collocation.points)
    samples = np.stack([one, 3 + one**2, np.full(one.shape, 0.3)], axis=2)
    each = np.asarray(by_entry(collocation, samples))
    alone = [[error_of(collocation, samples[:, i, j]) for j in range(3)] for i in range(7)]
    assert each == pytest.approx(np.array(alone), rel=1e-8)
    assert np.array_equal(each[:, 2], np.zeros(7))  # what does not vary has no error of its own
