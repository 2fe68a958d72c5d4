"""Square matrices by few tangents and their band, against dense ones of NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aleator.dynamics._sparse import Sparsity
from compiling import compiled
from zoo import cases

GENERATOR = np.random.default_rng(3)


def banded(n, below, above):
    places = np.subtract.outer(np.arange(n), np.arange(n))
    return (places <= below) & (places >= -above)


# The pattern, how many tangents tell it, and how many diagonals are below and above the main one.
PATTERNS = {
    "three diagonals": (banded(40, 1, 1), 3, (1, 1)),
    "more below": (banded(80, 3, 1), 5, None),
    "in another order": (
        banded(48, 1, 1)[np.ix_(*[GENERATOR.permutation(48)] * 2)] | np.eye(48, dtype=bool),
        None,
        None,
    ),
    "a full row": (banded(40, 1, 1) | (np.arange(40) == 7)[:, None], 40, None),
    "few": (banded(3, 1, 1), 3, None),
}


@pytest.mark.parametrize("name", cases(PATTERNS, 3))
def test_equations_are_solved_as_dense_ones_with_pivots_and_derivatives(name):
    pattern, tangents, band = PATTERNS[name]
    sparsity, n = Sparsity.of(pattern), len(pattern)
    if tangents is not None:
        assert len(sparsity.seeds) == tangents
    if band is not None:
        assert sparsity.band == band
    # Nothing on the main diagonal: no elimination goes without pivots.
    matrix, added = (np.where(pattern, GENERATOR.normal(size=(n, n)), 0.0) for _ in range(2))
    right, mass = GENERATOR.normal(size=n), np.zeros(n)

    @compiled
    def solved(matrix, added, right):
        def of(matrix):
            entries = sparsity.entries(jnp.asarray(sparsity.seeds) @ matrix.T)
            return sparsity.solver(sparsity.diagonal(mass) + entries)(right)

        return jax.jvp(of, (matrix,), (added,))

    value, change = solved(matrix, added, right)
    expected = np.linalg.solve(matrix, right)
    np.testing.assert_allclose(value, expected, rtol=1e-8)
    np.testing.assert_allclose(change, -np.linalg.solve(matrix, added @ expected), rtol=1e-6)
