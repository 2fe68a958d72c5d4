"""A truss of 23 bars with ten uncertain inputs (Lee and Kwak 2006; Blatman and Sudret 2010), exact to compare with.

It is statically determinate, so that the deflection is a sum of products of independent numbers: moments in closed
form, tails conditionally on all but one of them at 2^18 Sobol points.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from zoo import algebraic

pytestmark = pytest.mark.slow

NODES = np.array([(4.0 * i, 0.0) for i in range(7)] + [(2.0 + 4.0 * i, 2.0) for i in range(6)])  # m
CHORDS = [*((i, i + 1) for i in range(6)), *((i, i + 1) for i in range(7, 12))]
DIAGONALS = [bar for i in range(6) for bar in ((i, i + 7), (i + 7, i + 1))]
BARS = np.array(CHORDS + DIAGONALS)
LENGTHS = np.linalg.norm(NODES[BARS[:, 1]] - NODES[BARS[:, 0]], axis=1)
FREE = np.setdiff1d(np.arange(26), [0, 1, 13])  # of the coordinates of all nodes: a hinge and a roller
MIDDLE, LOADED = np.searchsorted(FREE, [7]), np.searchsorted(FREE, np.arange(15, 26, 2))


def elongations() -> np.ndarray:
    """Elongation of each bar by displacements of the free coordinates."""
    matrix, bars = np.zeros((23, 13, 2)), np.arange(23)
    directions = (NODES[BARS[:, 1]] - NODES[BARS[:, 0]]) / LENGTHS[:, None]
    matrix[bars, BARS[:, 0]], matrix[bars, BARS[:, 1]] = -directions, directions
    return matrix.reshape(23, 26)[:, FREE]


ELONGATIONS = elongations()


@algebraic
def truss(E1, E2, A1, A2, P, camber=0.0):
    """Two moduli (Pa) and sections (m²), six loads (N), and a camber (m) that the deflection begins from."""
    stiffness = jnp.repeat(jnp.stack([E1 * A1, E2 * A2]), np.array([11, 12])) / LENGTHS
    loads = jnp.zeros(23).at[LOADED].set(-jnp.stack(P))
    moved = jnp.linalg.solve(ELONGATIONS.T @ (stiffness[:, None] * ELONGATIONS), loads)
    return {"deflection": -moved[MIDDLE[0]] - camber}


TRUSS = {
    "E1": al.LogNormal(mean=2.1e11, std=2.1e10),
    "E2": al.LogNormal(mean=2.1e11, std=2.1e10),
    "A1": al.LogNormal(mean=2e-3, std=2e-4),
    "A2": al.LogNormal(mean=1e-3, std=1e-4),
    "P": [al.Gumbel(mean=5e4, std=7.5e3) for _ in range(6)],
}
ABOVE = {
    0.10: (4.306e-2, 0.02),
    0.11: (8.81e-3, 0.03),
    0.12: (1.518e-3, 0.05),
    0.14: (3.34e-5, 0.2),
    0.16: (6.2e-7, 0.2),
}


def test_the_deflection_of_a_truss_has_its_moments_and_its_tail():
    expanded = al.expand(lambda one: one.outputs()["deflection"], truss(**TRUSS), al.Expansion(order=3))
    assert (expanded.mean, expanded.std) == pytest.approx((0.07940062219, 0.01108377770), rel=1e-4)
    assert expanded.skewness == pytest.approx(0.490, abs=0.01)  # these two by 4e5 samples
    assert expanded.kurtosis == pytest.approx(3.46, abs=0.05)
    for level, (probability, error) in ABOVE.items():
        assert expanded.probability(above=level) == pytest.approx(probability, rel=error)


def test_samples_of_a_truss_end_though_two_batches_at_once_would_wait_for_each_other_to_factorise():
    sample = al.references.monte_carlo(lambda one: one.outputs()["deflection"], truss(**TRUSS), 200_000)
    assert abs(sample.mean.value - 0.07940062219) < 3 * sample.mean.standard_error
    found = sample.probability(above=0.1)
    assert abs(found.value - ABOVE[0.1][0]) < 3 * found.standard_error
