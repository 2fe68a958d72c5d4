"""The guard that says from when on an order no longer resolves a trajectory."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.expansion import leave_one_out, leave_one_out_history, resolved_instants

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


@pytest.mark.slow
def test_a_start_that_is_certain_and_crossings_do_not_count_as_unresolved():
    times = np.linspace(0.0, 6.0, 200)
    expanded = al.expand(lambda m: jnp.sin(m["w"] * times) * jnp.cos(times), FREQUENCY, al.Expansion(6))
    assert int(resolved_instants(expanded.collocation, expanded.samples, expanded.coefficients)) == 200


def test_the_warning_names_the_instant_and_the_output():
    with pytest.warns(al.ExpansionWarning, match=r"x \(error .*resolved until t = 1[0-9.]* only\)"):
        al.expand(lambda m: {"x": wave(m), "w": m["w"] * TIMES}, FREQUENCY, al.Expansion(6), times=TIMES)
    late = TIMES[-20:]
    with pytest.warns(al.ExpansionWarning, match="resolved at no instant"):
        al.expand(lambda m: wave(m)[-20:], FREQUENCY, al.Expansion(6), times=late)
