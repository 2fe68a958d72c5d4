"""Equations of motion of SymPy against our own bodies and joints, and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sympy as sp
from sympy.physics import mechanics as me

import aleator as al
from compiling import compiled
from sympy_models import (
    ROD,
    RODS,
    A,
    B,
    D,
    G,
    L,
    L_1,
    M,
    Rods,
    T_A,
    THETA,
    rod_by_kane,
    rod_by_lagrange,
    rods_by_kane,
    rods_by_lagrange,
)

RODS_OF = {"Kane": lambda: al.foreign.from_kane(rods_by_kane(), RODS), "Lagrange": None}
RODS_OF["Lagrange"] = lambda: al.foreign.from_lagrange(rods_by_lagrange(), RODS)


@compiled
def motions(model, q, v, force):
    """Accelerations at many states."""
    return jax.vmap(model.forward_dynamics)(q, v, force)


@compiled
def slopes(model, q, v, force):
    """Derivatives of the accelerations by every number of the model."""
    return jax.jacfwd(lambda one: one.forward_dynamics(q, v, force))(model)


def traced(model):
    return jax.tree.map(lambda number: jnp.asarray(number, dtype=float), model)


def states(count, seed=3):
    generator = np.random.default_rng(seed)
    return [generator.normal(size=(count, 2)) * scale for scale in (2.0, 4.0, 5.0)]


@pytest.mark.parametrize("method", RODS_OF)
def test_accelerations_of_a_double_pendulum_are_those_of_bodies_and_joints(method):
    found, expected = (motions(traced(model), *states(50)) for model in (RODS_OF[method](), Rods()))
    assert np.abs(expected).max() > 10
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("method", RODS_OF)
def test_derivatives_by_each_number_are_those_of_bodies_and_joints(method):
    q, v, force = (one[0] for one in states(1))
    found = slopes(traced(RODS_OF[method]()), q, v, force).numbers
    expected = slopes(traced(Rods()), q, v, force)
    for name in ("m_1", "m_2", "l_1", "l_2", "d", "g"):
        np.testing.assert_allclose(found[name], getattr(expected, name), rtol=1e-11, atol=1e-11, err_msg=name)
        assert np.abs(found[name]).max() > 1e-3


@pytest.mark.parametrize("method", RODS_OF)
def test_a_simulation_of_a_double_pendulum_is_that_of_bodies_and_joints(method):
    grid, torque = al.Grid(1.0, 200), al.PowerSeries(start=(0.5, -1.0), end=(0.2, 2.0))
    ours = al.simulate(al.ForwardDynamics(Rods(), torque={"a_torque": torque}, start={"a": 0.4, "b": -0.9}), grid)
    model = RODS_OF[method]()
    system = al.ForwardDynamics(model, torque={"t_a": torque}, start={"a": 0.4, "b": -0.9})
    theirs = al.simulate(system, grid)
    assert np.ptp(ours["a"]) > 1
    for name in ("a", "b", "a_rate", "b_rate", "a_acceleration"):
        np.testing.assert_allclose(theirs[name], ours[name], rtol=0, atol=1e-12 * 100, err_msg=name)
    np.testing.assert_allclose(theirs["t_a"], ours["a_torque"], rtol=1e-14)


@pytest.mark.parametrize("model", [lambda: al.foreign.from_kane(rod_by_kane(), ROD), lambda: al.foreign.from_lagrange(rod_by_lagrange(), ROD)])
def test_a_rod_on_a_damped_hinge_swings_as_its_equation_says(model):
    # m l²/3 θ̈ = τ - d ω - m g l/2 cos θ
    for q, v, torque in ((0.3, -1.2, 0.0), (-2.0, 3.0, 1.7)):
        found = model().forward_dynamics(jnp.array([q]), jnp.array([v]), jnp.array([torque]))
        expected = 3 * (torque - 0.1 * v - 9.81 / 2 * np.cos(q))
        np.testing.assert_allclose(found, [expected], rtol=1e-13)
