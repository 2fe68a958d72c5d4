"""Models that name many states one by one: against the same one after the other, and against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import aleator as al
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


PLACES = 50


class Rod(al.System):
    """A rod with cold ends, whose first mode decays exactly."""

    states = tuple(f"u{i}" for i in range(PLACES))
    conduction: al.Number
    amplitude: al.Number

    def rhs(self, t, z):
        return conducted(self.conduction * (PLACES + 1) ** 2, z)

    def initial(self):
        return {name: self.amplitude * np.sin(np.pi * (i + 1) / (PLACES + 1)) for i, name in enumerate(self.states)}

    def outputs(self, t, z):
        return {"middle": z.u25}


@pytest.mark.slow
@pytest.mark.parametrize("way", [al.Sequential(), al.Simultaneous(al.schemes.Radau(3))], ids=["shot", "collocated"])
def test_the_hottest_rod_of_fifty_named_places_that_cools_in_time_is_that_of_the_closed_form(way):
    problem = al.Problem(
        Rod(al.Uniform(0.1, half_width=0.02), al.Decision(2.0, 1.0, 3.0)),
        grid=al.Grid(0.5, 10),
        minimize=-al.value("amplitude"),
        subject_to=[al.terminal("middle").at_most(1.5, sigmas=2)],
        integrator=al.integrators.Rodas5P(),
    )
    found = al.solve(problem, transcription=way)
    assert found.ok, found
    rate = 4 * (PLACES + 1) ** 2 * np.sin(np.pi / (2 * (PLACES + 1))) ** 2 * 0.5

    def moment(k):
        return (np.exp(-k * rate * 0.08) - np.exp(-k * rate * 0.12)) / (k * rate * 0.04)

    largest = moment(1) + 2 * np.sqrt(moment(2) - moment(1) ** 2)
    right = 1.5 / (np.sin(np.pi * 26 / (PLACES + 1)) * largest)
    assert found.decisions["amplitude"] == pytest.approx(right, rel=1e-6)
