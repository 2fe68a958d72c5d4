"""Intrusive Galerkin projection against closed forms and against collocation."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.expansion import Adaptive
from compiling import compiled
from zoo import Decay

GRID = al.Grid(10.0, 100)
DECAY = Decay(rate=al.Uniform.bounds(0.1, 0.2), start=al.Normal(1.5, 0.2))
DECAY_MEAN, DECAY_VARIANCE = 0.348816236902, 0.012314725652


@pytest.mark.parametrize(
    "integrator", [None, pytest.param(al.integrators.Tsit5(rtol=1e-11, atol=1e-12), marks=pytest.mark.slow)]
)
def test_the_uncertain_decay_has_its_published_moments(integrator):
    expanded = al.galerkin(DECAY, GRID, al.Expansion(8), integrator=integrator)
    assert float(expanded.mean["x"][-1]) == pytest.approx(DECAY_MEAN, abs=1e-7)
    assert float(expanded.variance["x"][-1]) == pytest.approx(DECAY_VARIANCE, abs=1e-7)


def test_the_coefficients_of_a_linear_system_are_those_of_the_projected_equations():
    """`x' = -(m + h xi) x`: with Legendre's recurrence the coefficients obey `c' = -(m I + h J) c`, J of Jacobi."""
    expanded = al.galerkin(Decay(rate=al.Uniform(0.5, half_width=0.3)), al.Grid(2.0, 400), al.Expansion(4))
    n = np.arange(1, 5)
    off = n / np.sqrt(4 * n**2 - 1)
    values, vectors = np.linalg.eigh(0.5 * np.eye(5) + 0.3 * (np.diag(off, 1) + np.diag(off, -1)))
    expected = vectors @ (np.exp(-2.0 * values) * vectors[0])
    assert np.asarray(expanded.coefficients["x"][:, -1]) == pytest.approx(expected, abs=1e-11)


class Pendulum(al.System):
    """Nonlinear, with a number and an array (the integral of the angle, and the speed) as states."""

    states = ("angle", "trail")
    length: Any
    start: Any

    def rhs(self, t, z, push):
        force = push - 9.81 / self.length * jnp.sin(z.angle)
        return z.trail[1], jnp.stack([z.angle, force])

    def outputs(self, t, z, push):
        return {"angle": z.angle, "trail": z.trail, "push": push}

    def initial(self):
        return {"angle": self.start, "trail": np.zeros(2)}


def test_a_nonlinear_system_with_array_states_and_uncertain_inputs_agrees_with_collocation():
    grid = al.Grid(1.0, 50)
    system = Pendulum(length=al.Uniform(1.0, half_width=0.1), start=al.Normal(0.8, 0.05))
    push = al.Tabulated([0.0, 1.0], [0.0, al.Uniform(1.0, half_width=0.3)])
    intrusive = al.galerkin(system, grid, al.Expansion(5), inputs={"push": push})
    other = al.expand(
        lambda m: al.simulate(m["system"], grid, {"push": m["push"]}), {"system": system, "push": push}, al.Expansion(5)
    )
    assert intrusive.basis.names == ("length", "start", "inputs.push.values.1")
    for name in ("angle", "trail", "push"):
        assert np.asarray(intrusive.mean[name]) == pytest.approx(np.asarray(other.mean[name]), abs=1e-6)
        assert np.asarray(intrusive.std[name]) == pytest.approx(np.asarray(other.std[name]), abs=1e-5)
    assert intrusive.coefficients["trail"].shape == (intrusive.basis.terms, 51, 2)


def test_galerkin_is_differentiable_through_the_distributions():
    def spread(half_width):
        return al.galerkin(
            Decay(rate=al.Uniform(0.15, half_width=half_width)), al.Grid(10.0, 100), al.Expansion(6)
        ).std["x"][-1]

    def exact(half_width, t=10.0):
        first, second = (np.exp(-0.15 * k * t) * np.sinh(k * half_width * t) / (k * half_width * t) for k in (1, 2))
        return np.sqrt(second - first**2)

    expected = (exact(0.05 + 1e-5) - exact(0.05 - 1e-5)) / 2e-5
    assert float(compiled(jax.grad(spread))(0.05)) == pytest.approx(expected, rel=1e-5)


def test_what_cannot_be_projected_is_refused_in_words():
    with pytest.raises(al.ProblemError, match="nothing in the system is uncertain"):
        al.galerkin(Decay(rate=0.1), GRID)
    with pytest.raises(al.ProblemError, match="expected a fixed one"):
        al.galerkin(DECAY, GRID, al.Expansion(index_set=Adaptive()))
