"""Tails that share a loop, beside each of them taken alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_expansions import basis_of, random_coefficients

from aleator.statistics import Mean, Probability, Quantile, prepare, together
from aleator.uncertainty import HermiteGerm, LegendreGerm

BASIS = basis_of([LegendreGerm(), HermiteGerm()], 3)


@pytest.mark.slow
def test_tails_of_one_kind_and_shape_are_those_taken_alone():
    generator = np.random.default_rng(5)
    one, other = (random_coefficients(BASIS, seed, (20,)) for seed in range(2))
    asked = [
        (Quantile(0.9), one),
        (Mean(), one),
        (Quantile(0.1), other),
        (Probability(above=0.2), one),
        (Probability(above=-0.3), one),
        (Probability(below=0.2), one),
        (Quantile(0.5), one[:, :3]),
    ]
    constants = prepare([kind for kind, _ in asked], BASIS)

    def shared(terms):
        found = together([(kind, two) for (kind, _), two in zip(asked, terms, strict=True)], constants)
        assert [values is not None for values in found] == [True, False, True, True, True, False, False]
        return [values for values in found if values is not None]

    def alone(terms):
        pairs = [(kind, two) for (kind, _), two in zip(asked, terms, strict=True)]
        return [pairs[i][0].of(pairs[i][1], constants.of(pairs[i][0])) for i in (0, 2, 3, 4)]

    terms = [two for _, two in asked]
    slopes = [jnp.asarray(generator.normal(size=two.shape)) for two in terms]
    both = [jax.jit(lambda f=f: jax.jvp(f, (terms,), (slopes,)))() for f in (shared, alone)]
    for found, expected in zip(*map(jax.tree.leaves, both), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10)
