"""Multiple shooting: segments have the order of their rule."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from aleator.dynamics import SegmentRate
from compiling import compiled


def swung(steps, segments):
    """A pendulum and the integral of its angle squared after two seconds, pushed by cos(3 t)."""

    def rate(place, signal, z):
        return jnp.array([z[1], signal[0] - jnp.sin(z[0]), z[0] ** 2])

    mean, nodes = SegmentRate(steps), np.linspace(0.0, 2.0, segments + 1)

    def segment(moved, ends):
        first, last = ends
        times = first + (last - first) * mean.told
        places = jnp.stack([times, jnp.zeros(len(mean.told))], axis=1)
        return moved + (last - first) * mean(rate, places, jnp.cos(3 * times)[:, None], moved[:2]), None

    return jax.lax.scan(segment, jnp.array([1.0, 0.0, 0.0]), np.array(list(pairwise(nodes))))[0]


def test_states_and_integrals_are_of_order_4_in_steps_and_in_segments():
    def rate(t, z):
        return [z[1], np.cos(3 * t) - np.sin(z[0]), z[0] ** 2]

    exact = solve_ivp(rate, (0.0, 2.0), [1.0, 0.0, 0.0], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    counts = (32, 2), (64, 2), (2, 32), (2, 64)
    coarse, fine, few, many = (
        np.abs(np.asarray(one) - exact) for one in compiled(lambda: [swung(*one) for one in counts])()
    )
    np.testing.assert_allclose(np.log2(coarse / fine), 4.0, atol=0.15)
    np.testing.assert_allclose(np.log2(few / many), 4.0, atol=0.15)
    mean = SegmentRate(3)
    assert mean.quadrature.sum() == pytest.approx(1.0, rel=1e-14)
    assert mean.quadrature @ mean.told**3 == pytest.approx(1 / 4, rel=1e-14)
