import numpy as np
import pytest

import aleator as al

FRACTIONS = np.linspace(0.0, 1.0, 31)


def row(t, order, count):
    """A row of the matrix in equation (51): derivatives of the powers of t."""
    return [
        np.prod([float(k - i) for i in range(order)]) * t ** (k - order) if k >= order else 0.0 for k in range(count)
    ]


def by_numpy(conditions, t, order):
    """The polynomial with these conditions `(time, order, value)`, by NumPy's own linear solve."""
    count = len(conditions)
    matrix = np.array([row(when, which, count) for when, which, _ in conditions])
    coefficients = np.linalg.solve(matrix, np.array([value for *_, value in conditions]))
    return np.array([row(one, order, count) for one in t]) @ coefficients


START, END = (0.3, -1.0, 2.0), (1.1, 0.5, -0.7)


@pytest.mark.parametrize(("duration", "middle"), [(0.4, None), (3.0, (0.3, -0.4))])
def test_the_polynomial_is_that_of_equation_51_in_seconds(duration, middle):
    conditions = [(0.0, k, x) for k, x in enumerate(START)] + [(duration, k, x) for k, x in enumerate(END)]
    options = {}
    if middle is not None:
        conditions.append((middle[0] * duration, 0, middle[1]))
        options = {"middle_time": middle[0], "middle": middle[1]}
    series = al.PowerSeries(start=START, end=END, **options)
    for order in range(5):
        expected = by_numpy(conditions, duration * FRACTIONS, order)
        found = series.values(FRACTIONS, duration, order)
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(series.values(FRACTIONS, duration, 8), 0.0)


def test_conditions_at_the_start_alone_make_a_taylor_series():
    t = 1.7 * FRACTIONS
    series = al.PowerSeries(start=(0.2, -1.0, 3.0))
    np.testing.assert_allclose(series.values(FRACTIONS, 1.7), 0.2 - t + 1.5 * t**2, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(series.values(FRACTIONS, 1.7, 1), -1 + 3 * t, rtol=1e-13, atol=1e-13)
    constant = al.PowerSeries(start=4.0)
    np.testing.assert_array_equal(constant.values(FRACTIONS, 9.0), np.full(31, 4.0))
    np.testing.assert_array_equal(constant.values(FRACTIONS, 9.0, 1), np.zeros(31))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: al.PowerSeries(start=(0, 0, 0, 0)), "received 4 conditions"),
        (lambda: al.PowerSeries(start=(0.0,), end=(np.ones(2),)), r"a value of shape \(\) at the end"),
        (lambda: al.PowerSeries(start=(0.0,), middle=1.0, middle_time=0.0), "strictly between 0 and 1"),
        (
            lambda: al.PowerSeries(start=(0.0,), middle=1.0, middle_time=al.Uniform(0.5, half_width=0.6)),
            "or a distribution or a Decision in that range",
        ),
    ],
)
def test_power_series_that_make_no_sense_are_refused_in_words(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()


def test_rates_on_a_grid_that_begins_late_are_per_second_of_its_duration():
    rate = al.PowerSeries(start=(0.0, 0.0), end=(1.0, 0.0)).derivative()
    at = np.linspace(0.0, 1.0, 5)
    # 3 f² - 2 f³ of the fraction f, in two seconds.
    np.testing.assert_allclose(rate.sampled(at, 1.0, 3.0), 6 * at * (1 - at) / 2.0, atol=1e-12)
