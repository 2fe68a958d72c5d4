"""Roots of polynomials on an interval, beside NumPy's, however the program that finds them is optimised."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aleator._core.compilation import Use, compiled_for
from aleator.statistics._crossings import extrema, horner, roots_between

LINES = 4000


def polynomials(degree):
    """Random coefficients of x^0, x^1, ..., shape (degree + 1, lines)."""
    return np.random.default_rng(degree).normal(size=(degree + 1, LINES))


def crossings(powers):
    edges = extrema(powers)
    return roots_between(powers, edges, horner(powers, edges))


@pytest.mark.slow
@pytest.mark.parametrize("use", Use)
@pytest.mark.parametrize("degree", [1, 2, 3, 5, 8])
def test_crossings_are_the_real_roots_of_each_polynomial(degree, use):
    powers = polynomials(degree)
    found = np.asarray(compiled_for(use, jax.jit(crossings).lower(jnp.asarray(powers)), "cpu")(jnp.asarray(powers)))
    for line in range(LINES):
        roots = np.polynomial.polynomial.polyroots(powers[:, line])
        size, slopes = np.abs(powers[:, line]).sum(), np.polynomial.polynomial.polyder(powers[:, line])
        for root in np.sort(roots[(np.abs(roots.imag) < 1e-9) & (np.abs(roots.real) < 0.999)].real):
            slope = abs(np.polynomial.polynomial.polyval(root, slopes))
            # A root where the line is nearly flat is as uncertain as rounding of its values makes it.
            assert np.min(np.abs(found[:, line] - root)) < 1e-12 + 1e-14 * size / slope, (line, root)
