from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from double_pendulum import (
    Energies,
    Matrices,
    Pendubot,
    Rates,
    Tendons,
    by_sympy,
    forces_along,
    simulate,
)
from scipy.integrate import solve_ivp

import aleator as al
from aleator.mechanics._dynamics import scheme
from compiling import compiled
from zoo import cases

NAMES = ("shoulder", "elbow")
GRID = al.Grid(1.2, 48)
SWING = al.PowerSeries(start=(0.3, 0.5, -1.0), end=(1.4, 0.0, 2.0), middle=0.4)


def random(seed, *shape):
    return np.random.default_rng(seed).normal(size=shape)


@compiled
def all_of(model, q, v, force):
    return model.mass_matrix(q), model.bias(q, v), model.forward_dynamics(q, v, force)


def test_mass_bias_and_accelerations_of_energies_are_those_of_the_lagrangian_by_sympy():
    for seed in range(2):
        q, v, force = random(seed, 3, 2)
        sizes = dict(zip(("m_1", "m_2", "l_1", "l_2", "friction"), 0.3 + random(seed + 9, 5) ** 2, strict=True))
        mass, bias = by_sympy(q, v, **sizes)
        ours = all_of(Energies(**sizes), q, v, force)
        for one, expected in zip(ours, (mass, bias, np.linalg.solve(mass, force - bias)), strict=True):
            np.testing.assert_allclose(one, expected, rtol=1e-9, atol=1e-9)


BROUGHT = al.BSpline(np.array(random(1, 6, 2)), degree=3)
BEGUN = {"shoulder": 0.4, "elbow": -0.7, "elbow_rate": 1.0}


def test_torques_bring_about_the_accelerations_that_take_them():
    found = simulate(al.ForwardDynamics(Matrices(), torque=BROUGHT, start=BEGUN), GRID)
    given = np.asarray(BROUGHT.values(GRID.fractions, 1.2))
    np.testing.assert_allclose(forces_along(found), given, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.stack([found[f"{name}_torque"] for name in NAMES], 1), given, rtol=1e-13)
    rate = np.asarray(BROUGHT.values(GRID.fractions, 1.2, 1))
    np.testing.assert_allclose(np.stack([found[f"{name}_torque_rate"] for name in NAMES], 1), rate, rtol=1e-11)


MOTION = al.BSpline(
    0.3 * random(2, 7, 2), start=(np.array([0.2, 0.4]), np.zeros(2)), end=(np.array([1.0, -0.5]),), degree=5
)


def differences(values, step):
    """Derivatives in time inside a history, of fourth order."""
    return (values[:-4] - 8 * values[1:-3] + 8 * values[3:-1] - values[4:]) / (12 * step)


class Swapped(Matrices):
    actuator_names = ("elbow_torque", "shoulder_torque")


@pytest.mark.parametrize("model", cases([Swapped(), Rates()]))
def test_inverse_dynamics_takes_the_torques_of_the_motion_and_their_rates(model):
    grid = al.Grid(1.2, 300)
    found = simulate(al.InverseDynamics(model, motion=MOTION), grid)
    for order, end in enumerate(("", "_rate", "_acceleration")):
        along = np.stack([found[name + end] for name in NAMES], 1)
        expected = np.asarray(MOTION.values(grid.fractions, 1.2, order))
        np.testing.assert_allclose(along, expected, rtol=1e-12, atol=1e-12)
    torque = np.stack([found[f"{name}_torque"] for name in NAMES], 1)
    np.testing.assert_allclose(torque, forces_along(found), rtol=1e-9, atol=1e-9)
    rate = np.stack([found[f"{name}_torque_rate"] for name in NAMES], 1)[2:-2]
    # The motion has knots, at which the torques' second derivative jumps.
    np.testing.assert_allclose(rate, differences(torque, 1.2 / 300), rtol=0, atol=1e-4 * np.abs(rate).max())


def test_torques_of_least_norm_are_found_where_there_are_more_of_them():
    found = simulate(al.InverseDynamics(Tendons(), motion=MOTION), GRID)
    B = np.asarray(Tendons().actuation(None))
    expected = forces_along(found) @ np.linalg.pinv(B).T
    np.testing.assert_allclose(np.stack([found[name] for name in "abc"], 1), expected, rtol=1e-9, atol=1e-10)


@cache
def passive_elbow():
    """The elbow of a pendubot whose shoulder swings as prescribed, and its rate, by SciPy: at 21 instants."""
    swing = [np.polynomial.Polynomial(np.asarray(SWING.coefficients(1.2))).deriv(order) for order in range(3)]

    def rates(t, z):
        q_1, v_1, a_1 = (one(t / 1.2) / 1.2**order for order, one in enumerate(swing))
        mass, bias = by_sympy((q_1, z[0]), (v_1, z[1]))
        return z[1], -(mass[1, 0] * a_1 + bias[1]) / mass[1, 1]

    instants = np.linspace(0.0, 1.2, 21)
    return solve_ivp(rates, (0.0, 1.2), (-0.5, 0.8), method="DOP853", rtol=1e-11, atol=1e-11, t_eval=instants).y


START = {"elbow": -0.5, "elbow_rate": 0.8}


@cache
def swung(steps):
    return simulate(al.HybridDynamics(Pendubot(), motion={"shoulder": SWING}, start=START), al.Grid(1.2, steps))


def test_hybrid_dynamics_moves_the_passive_joint_as_it_must():
    found = swung(160)
    expected = passive_elbow()
    np.testing.assert_allclose(found["elbow"][::8], expected[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(found["elbow_rate"][::8], expected[1], rtol=0, atol=1e-5)
    for order, end in enumerate(("", "_rate", "_acceleration")):
        prescribed = SWING.values(np.linspace(0, 1, 161), 1.2, order)
        np.testing.assert_allclose(found[f"shoulder{end}"], prescribed, rtol=1e-12, atol=1e-12)
    force = forces_along(found)
    np.testing.assert_allclose(force[:, 0], found["shoulder_torque"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(force[:, 1], 0.0, rtol=0, atol=1e-9)


def test_rates_of_torques_that_hybrid_dynamics_finds_are_their_derivatives_in_time():
    found = swung(160)
    rate = found["shoulder_torque_rate"][2:-2]
    expected = differences(found["shoulder_torque"], 1.2 / 160)
    np.testing.assert_allclose(rate, expected, rtol=0, atol=5e-5 * np.abs(rate).max())


def test_the_actuation_scheme_is_told_from_the_actuation_map():
    assert al.actuation_of(Pendubot(), jnp.array([0.3, 0.2])) is al.Actuation.UNDER
    maps = {"FULL": np.eye(2), "OVER": Tendons().actuation(None), "PASSIVE": np.zeros((2, 2))}
    # Several torques on one joint of two are too many and too few.
    maps["UNDER_OVER"] = np.array([[1.0, 2.0], [0.0, 0.0]])
    for expected, effect in maps.items():
        assert scheme(np.asarray(effect)) is al.Actuation[expected]
