"""Collocation schemes: what their weights integrate exactly, and the order of what they solve."""

import numpy as np
import pytest

import aleator as al

SCHEMES = {
    "trapezoid": (al.schemes.Trapezoid(), 2),
    "Hermite and Simpson": (al.schemes.HermiteSimpson(), 4),
    "Radau 1": (al.schemes.Radau(1), 1),
    "Radau 2": (al.schemes.Radau(2), 3),
    "Radau 3": (al.schemes.Radau(3), 5),
    "Gauss 1": (al.schemes.GaussLegendre(1), 2),
    "Gauss 2": (al.schemes.GaussLegendre(2), 4),
    "Gauss 3": (al.schemes.GaussLegendre(3), 6),
}
each = pytest.mark.parametrize(("scheme", "order"), SCHEMES.values(), ids=SCHEMES)


@each
def test_the_quadrature_is_exact_up_to_the_order_and_rates_that_are_polynomials_are_integrated_exactly(scheme, order):
    assert scheme.order == order
    for degree in range(len(scheme.nodes)):
        exact = scheme.points[1:] ** (degree + 1) / (degree + 1)
        np.testing.assert_allclose(scheme.weights @ scheme.nodes**degree, exact, rtol=1e-13, atol=1e-14)
    for degree in range(order):
        assert scheme.weights[-1] @ scheme.nodes**degree == pytest.approx(1 / (degree + 1), rel=1e-13)
    # The next power is not integrated: the order is no higher than it says.
    assert abs(scheme.weights[-1] @ scheme.nodes**order - 1 / (order + 1)) > 1e-5


def _solved(scheme, intervals):
    """`x' = -x² + cos(3 t)` from 1 over two seconds, by Newton's method on the scheme's own equations."""
    x, h = 1.0, 2.0 / intervals
    for k in range(intervals):
        t, unknown = h * (k + scheme.nodes), np.full(len(scheme.points) - 1, x)
        for _ in range(30):
            states = np.append(x, unknown)[scheme.asked]
            residual = unknown - x - h * scheme.weights @ (np.cos(3 * t) - states**2)
            slopes = np.eye(len(unknown))
            inside = slice(1, None) if scheme.asked.start == 0 else slice(None)
            columns = np.arange(len(scheme.points))[scheme.asked][inside] - 1
            slopes[:, columns] += h * scheme.weights[:, inside] * 2 * states[inside]
            unknown = unknown - np.linalg.solve(slopes, residual)
        x = unknown[-1]
    return x


@each
def test_errors_fall_by_the_order(scheme, order):
    exact = _solved(al.schemes.GaussLegendre(8), 40)
    counts = (8, 16) if order > 4 else (32, 64)
    first, second = (abs(_solved(scheme, count) - exact) for count in counts)
    assert np.log2(first / second) == pytest.approx(order, abs=0.3)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: al.schemes.Radau(0), "Radau.*stages"),
        (lambda: al.schemes.GaussLegendre(13), "GaussLegendre.*stages"),
        (lambda: al.schemes.MultipleShooting(0), "MultipleShooting: steps is a whole number"),
        (lambda: al.schemes.MultipleShooting(2000), "at most 100 steps in a segment"),
        (lambda: al.Simultaneous(al.schemes.Radau), r"Simultaneous: scheme: expected .*al\.schemes\.HermiteSimpson"),
        (lambda: al.Simultaneous(error=1e-13), "Simultaneous: error"),
        (lambda: al.Simultaneous(al.schemes.Radau(3), error=1e-6, most_stages=2), "stages"),
        (lambda: al.Simultaneous(al.schemes.Radau(3), error=1e-6, most_stages=13), "stages"),
        (
            lambda: al.Simultaneous(error=1e-6, most_stages=8),
            r"expected a scheme whose stages can be raised to 8.*HermiteSimpson",
        ),
        (lambda: al.Simultaneous(al.schemes.Radau(3), most_stages=8), "expected an error to refine them for"),
    ],
)
def test_schemes_and_meshes_that_cannot_be_are_refused(made, message):
    with pytest.raises(al.ProblemError, match=message):
        made()
