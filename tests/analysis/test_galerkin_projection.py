"""Intrusive Galerkin projection of equations with and without time, against closed forms and collocation."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.expansion import Adaptive
from zoo import Decay

GRID = al.Grid(10.0, 100)
DECAY = Decay(rate=al.Uniform.bounds(0.1, 0.2), start=al.Normal(1.5, 0.2))
DECAY_MEAN, DECAY_VARIANCE = 0.348816236902, 0.012314725652


def test_the_uncertain_decay_has_its_published_moments():
    expanded = al.galerkin(DECAY, GRID, al.Expansion(8))
    assert np.asarray(expanded.mean["x"])[-1] == pytest.approx(DECAY_MEAN, abs=1e-7)
    assert np.asarray(expanded.variance["x"])[-1] == pytest.approx(DECAY_VARIANCE, abs=1e-7)


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


def test_what_cannot_be_projected_is_refused_in_words():
    with pytest.raises(al.ProblemError, match="nothing in the system is uncertain"):
        al.galerkin(Decay(rate=0.1), GRID)
    with pytest.raises(al.ProblemError, match="expected a fixed one"):
        al.galerkin(DECAY, GRID, al.Expansion(index_set=Adaptive()))


class Spring(al.AlgebraicSystem):
    """The deflection `u` of a spring under a force: `k u = f`."""

    unknowns = ("u",)
    k: Any
    f: Any = 2.0

    def guess(self):
        return {"u": 0.0}

    def residual(self, rho):
        return (self.k * rho.u - self.f,)


class Root(al.AlgebraicSystem):
    """`x² = a`."""

    unknowns = ("x",)
    a: Any
    start: Any = 1.0

    def guess(self):
        return {"x": self.start}

    def residual(self, rho):
        return (rho.x**2 - self.a,)

    def outputs(self, rho):
        return {"x": rho.x, "square": rho.x**2}


@pytest.mark.filterwarnings("ignore:galerkin:aleator.ExpansionWarning")
def test_the_coefficients_of_a_linear_equation_solve_the_projected_one():
    """`k u = f` with `k = m + h xi` projects to `(m I + h J) c = f e_0`, with Jacobi's matrix of Legendre's recurrence:
    so far from converged, this is Galerkin's own answer and no other method's.
    """
    expanded = al.galerkin(Spring(al.Uniform(1.0, half_width=0.5)), expansion=al.Expansion(2))
    n = np.arange(1, 3)
    off = n / np.sqrt(4 * n**2 - 1)
    projected = np.eye(3) + 0.5 * (np.diag(off, 1) + np.diag(off, -1))
    expected = np.linalg.solve(projected, 2.0 * np.eye(3)[0])
    assert np.asarray(expanded.coefficients["u"]) == pytest.approx(expected, rel=1e-13)


@pytest.mark.filterwarnings("ignore:galerkin:aleator.ExpansionWarning")
def test_a_quadratic_residual_of_order_one_has_the_coefficients_that_two_equations_give():
    """`c0² + c1² = m` and `2 c0 c1 = h/sqrt(3)`: sum and difference are the roots of `m ± h/sqrt(3)`."""
    expanded = al.galerkin(Root(al.Uniform(2.0, half_width=1.0)), expansion=al.Expansion(1))
    plus, minus = np.sqrt(2 + 1 / np.sqrt(3)), np.sqrt(2 - 1 / np.sqrt(3))
    expected = [(plus + minus) / 2, (plus - minus) / 2]
    assert np.asarray(expanded.coefficients["x"]) == pytest.approx(expected, rel=1e-13)
    # its square, projected: of equation (20) that is the given number itself
    assert np.asarray(expanded.coefficients["square"]) == pytest.approx([2.0, 1 / np.sqrt(3)], rel=1e-13)


def test_too_low_an_order_warns():
    with pytest.warns(al.ExpansionWarning, match="highest degrees carry a large part of the variance of u"):
        al.galerkin(Spring(al.Uniform(1.0, half_width=0.9)), expansion=al.Expansion(2))


def test_time_is_refused():
    with pytest.raises(al.ProblemError, match=r"Spring is algebraic .*expansion=.*; received grid and integrator\."):
        al.galerkin(Spring(al.Normal(5.0, 0.1)), grid=al.Grid(1.0, 2), integrator=al.integrators.Tsit5())
