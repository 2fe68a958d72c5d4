"""Constrained mechanics against elimination by hand: positions, torques, multipliers; drift, energy, derivatives."""

from functools import cache
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from closed_loops import ClosedTree, SliderCrank, slider_crank_by_hand
from double_pendulum import simulate
from scipy.integrate import solve_ivp

import aleator as al
from compiling import compiled

TURNS = al.PowerSeries(start=(0.7, 5.0, 1.0), end=(20.0, 1.0))
GRID = al.Grid(2.0, 200)


@cache
def driven_slider_crank():
    return simulate(al.InverseDynamics(SliderCrank(), motion={"crank": TURNS}, guess={"slider": 0.4}), GRID)


def by_hand(found):
    return slider_crank_by_hand(*(found[f"crank{end}"] for end in ("", "_rate", "_acceleration")))


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)


def test_a_driven_slider_crank_is_that_of_elimination_by_hand_over_three_turns():
    found = driven_slider_crank()
    expected = by_hand(found)
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
def test_a_driven_tree_that_is_closed_is_that_of_elimination_by_hand_and_its_multipliers_the_force_in_the_pin():
    found = simulate(al.InverseDynamics(ClosedTree(), motion={"crank": TURNS}, guess={"slider": 0.4}), GRID)
    expected = by_hand(found)
    rod = found["crank"] + found["rod"]
    close(np.exp(1j * rod), np.exp(1j * expected["rod"]))
    close(found["slider"], expected["slider"])
    close(found["crank_torque"], expected["torque"])
    # On the slider by the rod, in the rod's axes.
    x, y = (found[f"pin_{end}_multiplier"] for end in "xy")
    force = np.stack([np.cos(rod) * x - np.sin(rod) * y, np.sin(rod) * x + np.cos(rod) * y])
    close(force, -expected["wrist"])
    # The branch is kept through whole turns: the angle beside the crank goes round as often.
    assert np.abs(np.diff(found["rod"])).max() < 0.3
    assert found["rod"][-1] < -3 * 2 * np.pi + 1


class Pushed(SliderCrank):
    """With a force on the slider as well."""

    actuator_names = ("crank_torque", "slider_torque")


@pytest.mark.slow
def test_an_over_actuated_linkage_takes_the_torques_of_least_norm():
    found = simulate(al.InverseDynamics(Pushed(), motion={"crank": TURNS}, guess={"slider": 0.4}), GRID)
    # Work done: what the crank alone takes, shared in proportion to the speeds.
    gain = found["slider_rate"] / found["crank_rate"]
    alone = driven_slider_crank()["crank_torque"]
    close(found["crank_torque"], alone / (1 + gain**2))
    close(found["slider_torque"], alone * gain / (1 + gain**2))
    posture = jnp.array([0.7, -0.2, 0.37])
    assert al.actuation_of(Pushed(), posture) is al.Actuation.OVER
    assert al.actuation_of(SliderCrank(), posture) is al.Actuation.FULL


def energy_error(model, found):
    """The largest change of energy, relative to how much of it goes to and fro."""
    q, v = (np.stack([found[f"{name}{end}"] for name in model.coordinates], 1) for end in ("", "_rate"))
    both = compiled(jax.vmap(lambda q, v: (model.kinetic_energy(q, v), model.potential_energy(q))))
    kinetic, potential = map(np.asarray, both(q, v))
    energy = kinetic + potential
    return np.abs(energy - energy[0]).max() / np.ptp(kinetic)


def test_a_passive_slider_crank_moves_as_the_reduced_equation_does_and_keeps_constraints_and_energy():
    def rates(t, z):
        # Reduced: the torque by hand is affine in the acceleration, and none is given.
        still, unit = (slider_crank_by_hand(*(np.array([one]) for one in (z[0], z[1], a)))["torque"][0] for a in (0, 1))
        return z[1], -still / (unit - still)

    times = np.asarray(al.Grid(2.0, 200).times)
    expected = solve_ivp(rates, (0.0, 2.0), (0.7, 5.0), t_eval=times, rtol=1e-11, atol=1e-12).y[0]
    start = {"crank": 0.7, "crank_rate": 5.0}
    system = al.ForwardDynamics(SliderCrank(), start=start, guess={"slider": 0.4})
    found = simulate(system, al.Grid(2.0, 400))
    np.testing.assert_allclose(found["crank"][::2], expected, rtol=0, atol=1e-6)
    assert energy_error(SliderCrank(), found) < 3e-7
    assert found["constraint_drift"].max() < 1e-8
    assert found["constraint_error"].max() < 1e-13


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


class Rod(al.Lagrangian):
    """A pendulum in Cartesian coordinates, which an event stretches at the bottom."""

    coordinates = ("x", "y")
    constraint_names = ("length",)
    stretch: al.Number
    events: ClassVar = {
        "bottom": al.Event(lambda self, t, z: z.q[0], jump=lambda self, t, z: {"q": self.stretch * z.q})
    }

    def kinetic_energy(self, q, v):
        return 0.5 * v @ v

    def potential_energy(self, q):
        return 9.81 * q[1]

    def constraint(self, q):
        return (q @ q - 1.0,)


@pytest.mark.slow
def test_coordinates_that_jump_off_a_constraint_a_little_are_put_back_and_others_refused():
    start, grid = {"x": 0.6, "y": -0.8}, al.Grid(1.0, 50)
    stretched, same = (simulate(al.ForwardDynamics(Rod(size), start=start), grid)["x"] for size in (1.002, 1.0))
    np.testing.assert_allclose(stretched, same, rtol=0, atol=1e-9)
    with pytest.warns(al.SimulationWarning, match=r"constraints of Rod cannot be obeyed.*missed by 0\.02"):
        al.simulate(al.ForwardDynamics(Rod(1.01), start=start), grid)
