"""Constrained mechanics against elimination by hand: positions, torques, multipliers; drift, energy, derivatives."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from closed_loops import NEAR, FourBar, SliderCrank, four_bar_by_hand, slider_crank_by_hand
from scipy.integrate import solve_ivp

import aleator as al
from compiling import compiled

TURNS = al.PowerSeries(start=(0.7, 5.0, 1.0), end=(20.0, 1.0))
GRID = al.Grid(2.0, 200)


@compiled
def run(system, grid):
    return al.simulate(system, grid)


def simulate(system, grid=GRID):
    return {name: np.asarray(values) for name, values in run(system, grid).items()}


@cache
def driven_slider_crank():
    return simulate(al.InverseDynamics(SliderCrank(), motion={"crank": TURNS}, guess={"slider": 0.4}))


@cache
def driven_four_bar():
    return simulate(al.InverseDynamics(FourBar(), motion={"crank": TURNS}, guess=NEAR))


def by_hand(oracle, found):
    return oracle(*(found[f"crank{end}"] for end in ("", "_rate", "_acceleration")))


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)


def test_a_driven_slider_crank_is_that_of_elimination_by_hand_over_three_turns():
    found = driven_slider_crank()
    expected = by_hand(slider_crank_by_hand, found)
    for name in ("rod", "slider", "rod_rate", "rod_acceleration", "slider_acceleration"):
        close(found[name], expected[name])
    close(found["crank_torque"], expected["torque"])
    # The multipliers are the forces on the rod's end, with the sign of equation (6).
    close(found["length_multiplier"], -expected["wrist"][0])
    close(found["height_multiplier"], -expected["wrist"][1])
    close(found["slider_reaction"], -expected["wrist"][0])
    # By the parabola through five neighbours: fourth order in the step.
    torque = found["crank_torque"]
    slope = (-torque[4:] + 8 * torque[3:-1] - 8 * torque[1:-3] + torque[:-4]) / (12 * 0.01)
    np.testing.assert_allclose(found["crank_torque_rate"][2:-2], slope, rtol=0, atol=5e-3 * np.abs(slope).max())


@pytest.mark.slow
def test_a_driven_four_bar_is_that_of_elimination_by_hand_and_its_multipliers_the_force_in_the_pin():
    found = driven_four_bar()
    expected = by_hand(four_bar_by_hand, found)
    third = found["crank"] + found["coupler"]
    close(np.exp(1j * third), np.exp(1j * expected["coupler"]))
    close(np.exp(1j * found["rocker"]), np.exp(1j * expected["rocker"]))
    close(found["rocker_rate"], expected["rocker_rate"])
    close(found["crank_torque"], expected["torque"])
    # On the child by the parent, in the axes of the closing joint on the parent, the coupler.
    x, y = (found[f"pin_{end}_multiplier"] for end in "xy")
    force = np.stack([np.cos(third) * x - np.sin(third) * y, np.sin(third) * x + np.cos(third) * y])
    close(force, expected["force"])
    # The branch is kept through whole turns: the angle beside the crank goes round as often.
    assert np.abs(np.diff(found["coupler"])).max() < 0.3
    assert found["coupler"][-1] < -3 * 2 * np.pi + 1


@pytest.mark.slow
def test_an_over_actuated_linkage_takes_the_torques_of_least_norm():
    both = FourBar(driven=("crank_torque", "rocker_torque"))
    found = simulate(al.InverseDynamics(both, motion={"crank": TURNS}, guess=NEAR))
    # Work done: what the crank alone takes, shared in proportion to the speeds.
    gain = found["rocker_rate"] / found["crank_rate"]
    alone = driven_four_bar()["crank_torque"]
    close(found["crank_torque"], alone / (1 + gain**2))
    close(found["rocker_torque"], alone * gain / (1 + gain**2))
    assert al.actuation_of(both, jnp.array([0.7, -0.2, 1.7])) is al.Actuation.OVER
    assert al.actuation_of(FourBar(), jnp.array([0.7, -0.2, 1.7])) is al.Actuation.FULL


def energy_error(model, found):
    """The largest change of energy, relative to how much of it goes to and fro."""
    q, v = (np.stack([found[f"{name}{end}"] for name in model.coordinates], 1) for end in ("", "_rate"))
    both = compiled(jax.vmap(lambda q, v: (model.kinetic_energy(q, v), model.potential_energy(q))))
    kinetic, potential = map(np.asarray, both(q, v))
    energy = kinetic + potential
    return np.abs(energy - energy[0]).max() / np.ptp(kinetic)


@cache
def turning(steps, t_final=2.0):
    return simulate(
        al.ForwardDynamics(SliderCrank(), start={"crank": 0.7, "crank_rate": 5.0}, guess={"slider": 0.4}),
        al.Grid(t_final, steps),
    )


@pytest.mark.slow
def test_a_passive_linkage_keeps_its_constraints_and_its_energy_over_four_seconds():
    model = FourBar(crank=1.0, coupler=3.5, rocker=3.0, ground=4.0)
    found = simulate(al.ForwardDynamics(model, start={"crank": 0.9}, guess=NEAR), al.Grid(4.0, 6400))
    assert found["constraint_error"].max() < 1e-13
    assert found["constraint_rate_error"].max() < 1e-12
    assert found["constraint_drift"].max() < 1e-8
    assert energy_error(model, found) < 1e-8
    assert np.ptp(found["rocker"]) > 0.2


def test_a_passive_slider_crank_moves_as_the_reduced_equation_does_and_converges_with_order_four():
    def rates(t, z):
        # Reduced: the torque by hand is affine in the acceleration, and none is given.
        still, unit = (slider_crank_by_hand(*(np.array([one]) for one in (z[0], z[1], a)))["torque"][0] for a in (0, 1))
        return z[1], -still / (unit - still)

    times = np.asarray(al.Grid(2.0, 200).times)
    expected = solve_ivp(rates, (0.0, 2.0), (0.7, 5.0), t_eval=times, rtol=1e-11, atol=1e-12).y[0]
    steps = np.array([200, 400])
    histories = [turning(int(n)) for n in steps]
    errors = [np.abs(found["crank"][:: n // 200] - expected).max() for n, found in zip(steps, histories, strict=True)]
    assert errors[-1] < 2e-5
    energies = [energy_error(SliderCrank(), found) for found in histories]
    drifts = [found["constraint_drift"].max() for found in histories]
    for values in (errors, energies, drifts):
        assert np.log2(values[0] / values[1]) > 3.5
    assert histories[0]["constraint_error"].max() < 1e-13


class Bob(al.Lagrangian):
    """A pendulum in Cartesian coordinates."""

    names = ("x", "y")
    constraint_names = ("length",)

    length: al.Number = 1.0
    gravity: al.Number = 9.81

    def kinetic_energy(self, q, v):
        return 0.5 * v @ v

    def potential_energy(self, q):
        return self.gravity * q[1]

    def constraint(self, q):
        return (q @ q - self.length**2,)


def end_of_bob(numbers):
    system = al.ForwardDynamics(Bob(length=numbers[0], gravity=numbers[1]), start={"x": 0.3}, guess={"y": -1.0})
    found = al.simulate(system, al.Grid(0.5, 60), only=("y", "length_multiplier"))
    return jnp.stack([found["y"][0], found["y"][-1], found["length_multiplier"][-1]])


@pytest.mark.slow
def test_derivatives_by_numbers_are_those_of_finite_differences():
    functions = [end_of_bob]
    for _ in range(2):
        functions.append(jax.jacfwd(functions[-1]))
    all_of = compiled(lambda x: [one(x) for one in functions])
    numbers, h = np.array([1.0, 9.81]), 1e-5
    found = [np.asarray(one) for one in all_of(numbers)]
    for i, step in enumerate(h * np.eye(2)):
        ahead, behind = ([np.asarray(one) for one in all_of(numbers + sign * step)] for sign in (1, -1))
        for k in range(2):
            slope = (ahead[k] - behind[k]) / (2 * h)
            np.testing.assert_allclose(found[k + 1][..., i], slope, rtol=1e-6, atol=1e-6 * np.abs(found[k + 1]).max())


@pytest.mark.slow
def test_derivatives_of_driving_torques_by_lengths_are_those_of_finite_differences():
    grid = al.Grid(0.5, 20)

    def torque(rod):
        model = SliderCrank(b=rod)
        system = al.InverseDynamics(model, motion={"crank": TURNS}, guess={"slider": 0.4})
        return al.simulate(system, grid, only=("crank_torque",))["crank_torque"]

    def by_hand_at(rod):
        curve = [np.asarray(TURNS.derivative(k).sampled(grid.fractions, 0.0, 0.5)) for k in range(3)]
        return slider_crank_by_hand(*curve, b=rod)["torque"]

    slope = jax.jit(jax.jacfwd(torque))(0.3)
    h = 1e-3
    around = [by_hand_at(0.3 + k * h) for k in (-2, -1, 1, 2)]
    expected = (around[0] - 8 * around[1] + 8 * around[2] - around[3]) / (12 * h)
    np.testing.assert_allclose(slope, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


class Coupled(al.Lagrangian):
    """Two unit masses that move as one; at zero the rounding of their constraint is left, whatever they do."""

    names = ("lower", "upper")
    constraint_names = ("link",)

    def kinetic_energy(self, q, v):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def constraint(self, q):
        return (q[1] + 1.0 - 0.9 - 0.1 - q[0],)


def test_a_start_at_zero_that_obeys_the_constraints_up_to_rounding_is_taken():
    assert Coupled().constraint((0.0, 0.0)) != (0.0,)
    found = simulate(al.ForwardDynamics(Coupled(), start={"lower": 0.0, "lower_rate": 1.0}), al.Grid(0.5, 20))
    np.testing.assert_allclose([found["lower"][-1], found["upper"][-1]], 0.5, rtol=0, atol=1e-12)
