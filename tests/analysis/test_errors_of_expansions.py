"""How far an expansion is to be trusted: fresh points, unbounded tails, and the time until which it follows."""

import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.expansion import leave_one_out, leave_one_out_history, resolved_instants

UNIT = {"x": al.Uniform.bounds(0.0, 1.0)}
RIPPLE_STD = np.sqrt(1 / 12 + 2.5**2 / 2)


def rippled(waves):
    return lambda at: at["x"] + 5.0 * jnp.cos(jnp.pi * waves * at["x"]) ** 2


def test_a_ripple_of_the_pitch_of_the_points_is_told_and_elements_have_its_closed_form():
    with pytest.warns(al.ExpansionWarning, match="does not resolve the output"):
        expanded = al.expand(rippled(12.0), UNIT)
    # By the collocation points all is well.
    assert float(expanded.std) == pytest.approx(np.sqrt(1 / 12))
    assert float(expanded.leave_one_out) < 1e-12
    assert float(expanded.error) == float(expanded.fresh_error) > 0.9
    assert "error at fresh points" in str(expanded)
    piecewise = al.expand(rippled(12.0), UNIT, al.MultiElement(error=1e-3))
    assert float(piecewise.std) == pytest.approx(RIPPLE_STD, rel=1e-5)


def test_what_vanishes_at_all_nodes_of_a_gauss_grid_is_told():
    def legendre(at):
        return at["x"] + (35 * at["x"] ** 4 - 30 * at["x"] ** 2 + 3) / 8

    expansion = al.Expansion(3, points=al.points.GaussPoints(4))
    with pytest.warns(al.ExpansionWarning, match="does not resolve the output"):
        expanded = al.expand(legendre, {"x": al.Uniform.bounds(-1.0, 1.0)}, expansion)
    # The mean square of the fourth polynomial is 1/9, and the variance of the first 1/3.
    assert float(expanded.std) == pytest.approx(np.sqrt(1 / 3))
    assert float(expanded.fresh_error) == pytest.approx(np.sqrt(1 / 9 / (1 / 3 + 1 / 9)), rel=0.5)


@pytest.mark.parametrize("order", [2, 4])
def test_a_called_function_is_called_twice_more_and_what_the_basis_holds_is_exact_at_fresh_points(order):
    calls = []

    def square(at):
        calls.append(at["x"])
        return at["x"] ** 2

    expanded = al.expand(square, UNIT, al.Expansion(order), traced=False)
    assert len(calls) == 3 * (order + 1) + 2
    assert float(expanded.fresh_error) < 1e-12
    constant = al.expand(lambda at: 0.0 * at["x"] + 3.0, UNIT, al.Expansion(order), traced=False)
    assert float(constant.fresh_error) == 0.0


# --- Expansions of unbounded germs against closed forms ---------------------------------------------------------------


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


@pytest.mark.parametrize("case", CASES)
def test_spreads_by_default_points_are_those_of_the_closed_form(case):
    function, distributions, std = CASES[case]
    expanded, told = expanded_and_warnings(function, distributions, al.Expansion(10))
    assert float(expanded.std) == pytest.approx(std, rel=0.03)
    assert not told


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


# --- The guard that says from when on an order no longer resolves a trajectory ----------------------------------------


TIMES = np.linspace(0.0, 50.0, 501)
FREQUENCY = {"w": al.Uniform.bounds(0.7, 1.3)}


def wave(model):
    return jnp.cos(model["w"] * TIMES)


@functools.cache
def expanded_and_resolved(order):
    """The expansion, and the number of instants that it resolves."""
    with pytest.warns(al.ExpansionWarning):
        expanded = al.expand(wave, FREQUENCY, al.Expansion(order))
    return expanded, int(resolved_instants(expanded.collocation, expanded.samples, expanded.coefficients))


def test_each_order_resolves_the_phase_that_its_polynomials_can_follow():
    """A phase of +-0.3 t rad needs about one order for each radian (the Bessel functions of Jacobi and Anger)."""
    orders = np.array([2, 10])
    until = TIMES[[expanded_and_resolved(order)[1] - 1 for order in orders.tolist()]]
    assert 0.5 < np.polyfit(orders, 0.3 * until, 1)[0] < 1.5
    assert np.all(np.diff(until) > 0)


def test_up_to_the_instant_the_standard_deviation_is_right_and_after_it_is_not():
    expanded, count = expanded_and_resolved(10)
    first, second = (np.sinc(n * TIMES * 0.3 / np.pi) * np.cos(n * TIMES) for n in (1, 2))
    error = abs(np.asarray(expanded.std) - np.sqrt(0.5 + second / 2 - first**2))
    assert error[: count // 2].max() < 1e-3
    assert error[:count].max() < 0.1
    assert error[count:].max() > 0.2


def test_the_history_of_errors_is_relative_to_the_largest_variance_so_far():
    expanded = al.expand(lambda m: jnp.stack([m["w"], 10 * m["w"] ** 3, m["w"] ** 4]), FREQUENCY, al.Expansion(2))
    samples, coefficients = np.asarray(expanded.samples), np.asarray(expanded.coefficients)
    errors = np.asarray(leave_one_out_history(expanded.collocation, samples, coefficients))
    single = [float(leave_one_out(expanded.collocation, samples[:, i], coefficients[:, i])) for i in range(3)]
    variances = np.var(samples, axis=0)
    assert errors[:2] == pytest.approx(single[:2], rel=1e-10)
    assert errors[2] == pytest.approx(single[2] * np.sqrt(variances[2] / variances[1]), rel=1e-10)


def test_the_warning_names_the_instant_and_the_output():
    with pytest.warns(al.ExpansionWarning, match=r"x \(error .*resolved until t = 1[0-9.]* only\)"):
        al.expand(lambda m: {"x": wave(m), "w": m["w"] * TIMES}, FREQUENCY, al.Expansion(6), times=TIMES)
