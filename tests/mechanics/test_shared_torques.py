"""Redundant actuators within bounds: closed forms, optimality, derivatives, and what no actuators can make."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from double_pendulum import simulate
from scipy.optimize import minimize

import aleator as al
from aleator.mechanics._sharing import shared
from compiling import compiled

FLEXOR, EXTENSOR, INERTIA = 0.04, 0.03, 0.1
WEIGHT = 1.5 * 9.81 * 0.15


class Forearm(al.Lagrangian):
    """A forearm with two muscles that only pull, on opposite sides of the elbow."""

    names = ("elbow",)
    actuator_names = ("flexor", "extensor")
    inertia: al.Number = INERTIA
    tone: al.Number = 0.0
    strongest: al.Number = 2000.0

    def kinetic_energy(self, q, v):
        return 0.5 * self.inertia * v[0] ** 2

    def potential_energy(self, q):
        return WEIGHT * jnp.sin(q[0])

    def actuation(self, q):
        return jnp.array([[FLEXOR, -EXTENSOR]])

    def torque_bounds(self, q, v):
        return {"flexor": (self.tone, self.strongest), "extensor": (self.tone, None)}


LIFT = {"elbow": al.PowerSeries(start=(-0.5, 0.0), end=(1.2, 0.0))}
GRID = al.Grid(0.6, 12)


def moment_of(found):
    return INERTIA * found["elbow_acceleration"] + WEIGHT * np.cos(found["elbow"])


def test_of_antagonists_one_pulls_and_the_other_rests():
    found = simulate(al.InverseDynamics(Forearm(), motion=LIFT), GRID)
    moment = moment_of(found)
    assert moment.min() < -1 < 1 < moment.max()
    np.testing.assert_allclose(found["flexor"], np.maximum(moment, 0.0) / FLEXOR, rtol=1e-12)
    np.testing.assert_allclose(found["extensor"], np.maximum(-moment, 0.0) / EXTENSOR, rtol=1e-12)
    jerk = np.asarray(LIFT["elbow"].values(GRID.fractions, 0.6, 3)).ravel()
    rate = INERTIA * jerk - WEIGHT * np.sin(found["elbow"]) * found["elbow_rate"]
    np.testing.assert_allclose(found["flexor_rate"], np.where(moment > 0, rate, 0.0) / FLEXOR, rtol=1e-9, atol=1e-9)


E_MAP = np.random.default_rng(3).normal(size=(2, 6))


@compiled
def shares(*arrays):
    return shared(*map(jnp.asarray, arrays))


@pytest.mark.parametrize("seed", [0, 3])
def test_shares_are_those_of_a_general_solver(seed):
    rng = np.random.default_rng(seed)
    force = E_MAP @ np.clip(rng.normal(size=6), 0.0, 1.0)
    found = shares(E_MAP, force, np.stack([np.zeros(6), np.ones(6)]))
    assert bool(found.valid)
    best = minimize(
        lambda x: x @ x / 2,
        np.full(6, 0.5),
        jac=lambda x: x,
        bounds=[(0.0, 1.0)] * 6,
        constraints=[{"type": "eq", "fun": lambda x: E_MAP @ x - force, "jac": lambda x: E_MAP}],
        method="SLSQP",
        options={"ftol": 1e-15},
    )
    np.testing.assert_allclose(found.torque, best.x, rtol=0, atol=1e-7)
    # Constraints bear what they can: the same force and any along their own directions.
    along = rng.normal(size=(1, 3))
    B = rng.normal(size=(3, 5))
    loaded = B @ np.array([0.5, 0.0, 0.7, 0.2, 0.1]) + 3.0 * along[0]
    borne = shares(B, loaded, np.stack([np.zeros(5), np.full(5, 9.0)]), along)
    across = np.linalg.svd(along)[2][1:]
    alone = shares(across @ B, across @ loaded, np.stack([np.zeros(5), np.full(5, 9.0)]))
    np.testing.assert_allclose(borne.torque, alone.torque, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_derivatives_of_shares_are_exact_to_second_order():
    force = E_MAP @ np.array([0.0, 1.0, 0.3, 0.2, 0.0, 1.0])

    def torque(numbers):
        E, upper = numbers[:12].reshape(2, 6), numbers[14:]
        return shared(E, numbers[12:14], jnp.stack([jnp.zeros(6), upper])).torque

    @compiled
    def derivatives(numbers):
        return jax.jacfwd(torque)(numbers), jax.jacrev(torque)(numbers), jax.jacfwd(jax.jacfwd(torque))(numbers)

    at, h = np.concatenate([E_MAP.ravel(), force, np.full(6, 1.0)]), 1e-5
    every = [sign * h * one for one in np.eye(20) for sign in (1, -1)]
    held, *values = np.asarray(compiled(jax.vmap(torque))(np.stack([at, *(at + by for by in every)])))
    assert {0.0, 1.0} < set(held)
    assert ((held > 0) & (held < 1.0)).sum() > 1
    first, backward, second = map(np.asarray, derivatives(at))
    np.testing.assert_allclose(backward, first, rtol=0, atol=1e-12)
    ends = np.array([derivatives(at + by)[0] for by in every])
    np.testing.assert_allclose(first.T, np.subtract(values[::2], values[1::2]) / (2 * h), rtol=0, atol=1e-8)
    np.testing.assert_allclose(second.transpose(2, 0, 1), (ends[::2] - ends[1::2]) / (2 * h), rtol=0, atol=1e-7)


def declared(model):
    return al.Problem(al.InverseDynamics(model, motion=LIFT), grid=GRID, minimize=al.terminal("flexor").mean)


@pytest.mark.slow
def test_a_moment_that_no_actuators_make_is_named_with_its_instant_and_realisation():
    declared(Forearm(strongest=125.0))
    short = r"'flexor', 'extensor' cannot make .* 'elbow': at t = 0 s they fall short .* by 0.77"
    with pytest.raises(al.ProblemError, match=short):
        declared(Forearm(strongest=100.0))
    # Heavier arms take more: (0.1 + 0.02) * 28.3 + 1.9 N·m at the start.
    with pytest.raises(al.ProblemError, match=r"at t = 0 s .* In the system with inertia = 0.12"):
        declared(Forearm(strongest=125.0, inertia=al.Uniform(INERTIA, half_width=0.02)))
    with pytest.warns(al.SimulationWarning, match=short):
        found = al.simulate(al.InverseDynamics(Forearm(strongest=100.0), motion=LIFT), GRID)
    assert np.isnan(np.asarray(found["flexor"])[0])
    assert np.asarray(found["torque_shortfall"])[0] == pytest.approx(
        moment_of(simulate(al.InverseDynamics(Forearm(), motion=LIFT), GRID))[0] - 4.0
    )


def test_what_are_no_bounds_is_refused_by_name():
    odd = type("Odd", (Forearm,), {"torque_bounds": lambda self, q, v: {"flexr": (0.0, None)}})()
    with pytest.raises(al.ProblemError, match=r"Odd.torque_bounds\(q, v\).*some of \['flexor', 'extensor'\]"):
        jax.eval_shape(lambda: al.simulate(al.InverseDynamics(odd, motion=LIFT), GRID))
