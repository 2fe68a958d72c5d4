"""Models that name many states one by one: against the same one after the other."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from aleator._core.dependence import dependence
from aleator.dynamics._alike import together
from compiling import compiled


def conducted(conduction, u):
    """Heat between neighbours, place by place."""
    each = (0.0, *u, 0.0)
    return tuple(conduction * (each[i] - 2 * each[i + 1] + each[i + 2]) for i in range(len(u)))


def by_number(function, count):
    """A function of many numbers, as one of a vector of them."""
    _, named = ravel_pytree((jnp.zeros(()),) * count)
    return lambda number, vector: ravel_pytree(function(number, named(vector)))[0]


def test_equations_are_as_few_however_many_names_there_are():
    def counted(count):
        heat = by_number(conducted, count)
        return len(jax.make_jaxpr(lambda c, u: together(count, heat, c, u))(0.1, np.zeros(count)).eqns)

    assert counted(40) == counted(100) < 25


def irregular(which):
    """Reactions of different kinds among substances that nothing orders, with a part that is no single number."""
    several = jnp.array([0.5, 2.0, 1.5])

    def rates(number, u):
        rows = []
        for i, (a, b, c) in enumerate(which):
            rate = (i + 1) * u[a] * u[b] - jnp.where(u[c] > 0.5, jnp.sin(u[i]), number * u[a])
            rows.append(rate + number**2 if i % 3 else rate * jnp.sum(several * u[c]) / (1 + u[b]))
        return (*rows, jnp.stack(u[3:6]) @ several, jnp.zeros(0))

    return rates


def test_values_derivatives_and_their_places_are_those_of_one_equation_after_the_other():
    generator, count = np.random.default_rng(4), 30
    plain = by_number(irregular(generator.integers(0, count, (count, 3))), count)

    def packed(number, u):
        return together(count, plain, number, u)

    @compiled
    def every(number, u):
        return [(f(number, u), *jax.jacfwd(f, (0, 1))(number, u), jax.jacrev(f, 1)(number, u)) for f in (plain, packed)]

    at = 0.3, generator.uniform(0.2, 0.9, count)
    for one, other in zip(*every(*at), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-14)
    first, second = (dependence(f, at[:1], at[1:]) for f in (plain, packed))
    assert np.array_equal(first.first, second.first)
    assert np.array_equal(first.second, second.second)
