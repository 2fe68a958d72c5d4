import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline as SciPySpline

import aleator as al
from aleator.uncertainty import placements, realise
from compiling import compiled

FRACTIONS = np.linspace(0.0, 1.0, 57)


def numbers(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape)


def clamped(interior, degree):
    return np.concatenate([np.zeros(degree + 1), interior, np.ones(degree + 1)])


def scipy_values(spline, points, duration, order, fractions=FRACTIONS):
    knots = clamped(spline.knots, spline.degree)
    return SciPySpline(knots, points, spline.degree)(fractions, nu=order) / duration**order


@pytest.mark.parametrize("degree", [2, 3])
def test_values_and_derivatives_of_every_degree_are_those_of_scipy(degree):
    points = numbers(degree + 5, 2, seed=degree)
    knots = [None, [0.1, 0.15, 0.6, 0.95]][degree % 2]
    spline = al.BSpline(points, degree=degree, knots=knots)
    found = map(np.asarray, compiled(lambda: [spline.values(FRACTIONS, 1.7, order) for order in range(degree + 2)])())
    found = list(found)
    for order in range(degree + 1):
        expected = scipy_values(spline, points, 1.7, order)
        if order == degree:
            # Between knots it is constant: at a knot itself, sides are a matter of convention.
            keep = np.min(np.abs(FRACTIONS[:, None] - np.array(spline.knots)), axis=1) > 1e-9
        else:
            keep = np.ones_like(FRACTIONS, bool)
        np.testing.assert_allclose(found[order][keep], expected[keep], rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_array_equal(found[degree + 1], np.zeros((57, 2)))


def test_spans_are_knots_in_proportion():
    points, spans = numbers(7), np.array([1.0, 3.0, 0.5, 2.0])
    by_spans = al.BSpline(points, spans=spans)
    by_knots = al.BSpline(points, knots=np.cumsum(spans)[:-1] / spans.sum())
    found = compiled(lambda: [by_spans.values(FRACTIONS, 2.0, order) for order in range(3)])()
    for order in range(3):
        np.testing.assert_allclose(found[order], by_knots.values(FRACTIONS, 2.0, order), rtol=1e-11, atol=1e-11)


def test_polynomials_up_to_the_degree_are_reproduced():
    degree, T = 5, 2.5
    polynomial = np.polynomial.Polynomial(numbers(degree + 1, seed=7))
    derivatives = [polynomial, polynomial.deriv(), polynomial.deriv(2)]
    ends = {"start": [one(0.0) for one in derivatives], "end": [one(T) for one in derivatives]}
    path = polynomial(T * np.linspace(0.0, 1.0, 40))
    found = al.fit_control_points(path, 8, degree=degree, duration=T, **ends)
    spline = al.BSpline(found, degree=degree, **ends)
    for order in range(3):
        expected = polynomial.deriv(order)(T * FRACTIONS) if order else polynomial(T * FRACTIONS)
        np.testing.assert_allclose(spline.values(FRACTIONS, T, order), expected, rtol=1e-8, atol=1e-8)


def test_conditions_at_the_ends_hold_for_any_duration():
    duration = 4.0
    start, end = numbers(3, 2, seed=1), numbers(3, 2, seed=2)
    spline = al.BSpline(numbers(4, 2), start=tuple(start), end=tuple(end), degree=5)
    for order in range(3):
        both = spline.values(np.array([0.0, 1.0]), duration, order)
        np.testing.assert_allclose(both, np.stack([start[order], end[order]]), rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(np.asarray(spline.control_points(duration))[3:-3], numbers(4, 2))


def test_control_points_of_derivatives_are_those_of_equation_54():
    points, interior, p, T = numbers(8), np.array([0.2, 0.5, 0.55, 0.9]), 3, 1.3
    u = clamped(interior, p)
    by_hand = [p / (u[i + p + 1] - u[i + 1]) * (points[i + 1] - points[i]) / T for i in range(7)]
    spline = al.BSpline(points, knots=interior)
    np.testing.assert_allclose(spline.control_points(T, 1), by_hand, rtol=1e-13)
    second = SciPySpline(u, points, p).derivative(2)
    np.testing.assert_allclose(spline.control_points(T, 2), second.c[:6] / T**2, rtol=1e-12)
    np.testing.assert_array_equal(spline.control_points(T, 4), [0.0])


def test_the_curve_stays_in_the_hull_of_its_control_points():
    order = 2
    spline = al.BSpline(numbers(5, 3), start=(np.ones(3), np.zeros(3)), end=(np.zeros(3),), degree=4)
    dense = np.asarray(spline.values(np.linspace(0.0, 1.0, 2001), 0.7, order))
    lower, upper = map(np.asarray, spline.hull(0.7, order))
    assert (dense >= lower - 1e-9).all()
    assert (dense <= upper + 1e-9).all()
    assert (upper > lower).all()


def test_beyond_its_ends_by_rounding_the_curve_goes_on():
    # An instant that rounding puts 1e-15 before the start must not find the curve at zero.
    spline = al.BSpline(np.array([2.0, 2.5, 1.0, 3.0]))
    np.testing.assert_allclose(spline.values(np.array([-1e-15, 1 + 1e-15])), [2.0, 3.0], rtol=1e-12)


def test_a_trajectory_fills_the_time_that_it_is_given():
    spline = al.BSpline(numbers(6))
    times = np.linspace(2.0, 5.0, 7)

    @compiled
    @jax.vmap
    def along(t):
        return spline.over(2.0, 5.0)(t), jax.grad(spline.over(2.0, 5.0))(t), spline.derivative().over(2.0, 5.0)(t)

    stretched, slope, rate = along(times)
    np.testing.assert_allclose(stretched, spline.values((times - 2.0) / 3.0, 3.0), rtol=1e-12)
    np.testing.assert_allclose(spline.sampled(np.linspace(0, 1, 7), 2.0, 5.0), stretched, rtol=1e-12)
    np.testing.assert_allclose(rate, slope, rtol=1e-10, atol=1e-12)
    twice = spline.derivative().derivative()
    np.testing.assert_allclose(twice.values(FRACTIONS, 3.0), spline.values(FRACTIONS, 3.0, 2), rtol=1e-12)
    assert twice.shape == ()


class Follower(al.System):
    """A system without states that shows a trajectory."""

    states = ()

    path: al.AbstractTrajectory

    def signals(self):
        return {"value": self.path, "rate": self.path.derivative()}

    def rhs(self, t, z):
        return ()

    def outputs(self, t, z, value, rate):
        return {"value": value, "rate": rate}


def test_distributions_and_decisions_stand_in_control_points_and_ends():
    uncertain = Follower(
        al.BSpline(
            [al.Decision(0.2, -1.0, 1.0), al.Uniform(1.0, half_width=0.5), -0.4],
            start=(al.Normal(0.1, 0.01), al.Decision(0.0, -1.0, 1.0)),
            end=(1.0,),
        )
    )
    assert placements(uncertain).germ_names == ("path.free.1", "path.start.0")
    assert placements(uncertain).size == 2
    realised = realise(uncertain, jnp.array([0.5, 2.0]), jnp.array([0.3, 0.7]))
    plain = Follower(al.BSpline([0.3, 1.25, -0.4], start=(0.12, 0.7), end=(1.0,)))
    grid = al.Grid(2.0, 20, t_start=0.5)
    ours, expected = al.simulate(realised, grid), al.simulate(plain, grid)
    for name in ("value", "rate"):
        np.testing.assert_allclose(ours[name], expected[name], rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose([np.asarray(ours[name])[0] for name in ("value", "rate")], [0.12, 0.7], rtol=1e-12)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: al.BSpline(np.zeros(3)), "degree 3 needs at least 4 control points .* Give 1 more"),
        (lambda: al.BSpline(np.zeros((5, 2)), start=(1.0,)), r"a value of shape \(2,\) at the start, .*shape \(\)"),
        (lambda: al.BSpline(np.zeros(6), knots=[0.6, 0.4]), "expected 2 increasing knots"),
        (
            lambda: al.BSpline(np.zeros(6), knots=[0.4, al.Uniform(0.6, half_width=0.1)]),
            "expected plain numbers as knots",
        ),
        (lambda: al.fit_control_points(np.zeros(3), 4), "finite values at 4 or more instants"),
    ],
)
def test_splines_that_make_no_sense_are_refused_in_words(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()


def test_a_spline_over_a_grid_may_be_asked_at_a_plain_instant():
    signal = al.BSpline([0.0, 1.0], degree=1).over(0.0, 2.0)
    assert float(signal(0.5)) == pytest.approx(0.25)
