"""Roots of polynomials on an interval, beside NumPy's, however the program that finds them is optimised."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aleator._core.compilation import Use, compiled_for
from aleator.statistics._crossings import extrema, horner, roots_between

LINES = 1000


def crossings(powers):
    edges = extrema(powers)
    return edges, roots_between(powers, edges, horner(powers, edges))


@pytest.mark.parametrize(
    ("degree", "use"),
    [(5, Use.ONCE), *(pytest.param(*case, marks=pytest.mark.slow) for case in [(1, Use.ROWS), (8, Use.ROWS)])],
)
def test_crossings_are_the_real_roots_of_each_polynomial_and_no_others(degree, use):
    powers = np.random.default_rng(degree).normal(size=(degree + 1, LINES))
    program = compiled_for(use, jax.jit(crossings).lower(jnp.asarray(powers)), "cpu")
    edges, found = map(np.asarray, program(jnp.asarray(powers)))
    inside = (found > edges[:-1]) & (found < edges[1:])
    for line in range(LINES):
        roots = np.polynomial.polynomial.polyroots(powers[:, line])
        real = np.sort(roots[(np.abs(roots.imag) < 1e-9) & (np.abs(roots.real) < 1)].real)
        assert inside[:, line].sum() == len(real) or np.min(np.abs(np.abs(roots) - 1)) < 1e-6
        size, slopes = np.abs(powers[:, line]).sum(), np.polynomial.polynomial.polyder(powers[:, line])
        for root in real[np.abs(real) < 0.999]:
            slope = abs(np.polynomial.polynomial.polyval(root, slopes))
            # A root where the line is nearly flat is as uncertain as rounding of its values makes it.
            assert np.min(np.abs(found[:, line] - root)) < 1e-12 + 1e-14 * size / slope, (line, root)
