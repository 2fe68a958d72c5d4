"""Constrained mechanics against elimination by hand: positions, torques, multipliers; drift, energy, derivatives."""

import itertools
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
def test_hybrid_dynamics_that_prescribe_all_freedoms_are_inverse_dynamics():
    found = simulate(al.HybridDynamics(SliderCrank(), motion={"crank": TURNS}, guess={"slider": 0.4}))
    for name, values in driven_slider_crank().items():
        np.testing.assert_allclose(found[name], values, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_torques_and_their_rates_drive_forward_dynamics_along_the_same_motion():
    grid = al.Grid(1.0, 400)
    inverse = al.InverseDynamics(SliderCrank(), motion={"crank": TURNS}, guess={"slider": 0.4})
    planned = simulate(inverse, grid.divided(800))
    torque = planned["crank_torque"]
    # By the parabola through five neighbours: fourth order in the step.
    slope = (-torque[4:] + 8 * torque[3:-1] - 8 * torque[1:-3] + torque[:-4]) / (12 / 800)
    np.testing.assert_allclose(planned["crank_torque_rate"][2:-2], slope, atol=1e-4 * np.abs(slope).max())
    # Torques are known where Runge and Kutta look for them.
    given = al.Tabulated(np.asarray(grid.node_times), torque)
    begins = {"crank": 0.7, "crank_rate": 5.0}
    forward = al.ForwardDynamics(SliderCrank(), torque={"crank_torque": given}, start=begins, guess={"slider": 0.4})
    np.testing.assert_allclose(simulate(forward, grid)["crank"], planned["crank"][::2], atol=1e-5)


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
    kinetic = np.asarray(jax.jit(jax.vmap(model.kinetic_energy))(q, v))
    energy = kinetic + np.asarray(jax.jit(jax.vmap(model.potential_energy))(q))
    return np.abs(energy - energy[0]).max() / np.ptp(kinetic)


@cache
def turning(steps, t_final=2.0):
    return simulate(
        al.ForwardDynamics(SliderCrank(), start={"crank": 0.7, "crank_rate": 5.0}, guess={"slider": 0.4}),
        al.Grid(t_final, steps),
    )


@pytest.mark.slow
def test_a_passive_linkage_keeps_its_constraints_and_its_energy_over_ten_seconds():
    model = FourBar(crank=1.0, coupler=3.5, rocker=3.0, ground=4.0)
    found = simulate(al.ForwardDynamics(model, start={"crank": 0.9}, guess=NEAR), al.Grid(10.0, 16000))
    assert found["constraint_error"].max() < 1e-13
    assert found["constraint_rate_error"].max() < 1e-12
    assert found["constraint_drift"].max() < 1e-8
    assert energy_error(model, found) < 1e-8
    assert np.ptp(found["rocker"]) > 0.5


@pytest.mark.slow
def test_energy_and_drift_converge_by_the_order_of_the_integrator():
    steps = np.array([200, 400, 800])
    errors = [energy_error(SliderCrank(), turning(int(n))) for n in steps]
    drifts = [turning(int(n))["constraint_drift"].max() for n in steps]
    for values in (errors, drifts):
        assert np.polyfit(np.log(1 / steps), np.log(values), 1)[0] > 3.7


def test_a_passive_slider_crank_moves_as_the_reduced_equation_of_the_crank_does():
    def rates(t, z):
        # Reduced: the torque by hand is affine in the acceleration, and none is given.
        still, unit = (slider_crank_by_hand(*(np.array([one]) for one in (z[0], z[1], a)))["torque"][0] for a in (0, 1))
        return z[1], -still / (unit - still)

    times = np.asarray(al.Grid(2.0, 800).times)
    expected = solve_ivp(rates, (0.0, 2.0), (0.7, 5.0), t_eval=times, rtol=1e-11, atol=1e-12).y[0]
    found = turning(800)["crank"]
    np.testing.assert_allclose(found, expected, atol=1e-6)
    # Halving the step leaves a sixteenth of the error: both tend to the same motion.
    coarse = turning(400)["crank"]
    assert np.log2(np.abs(coarse - expected[::2]).max() / np.abs(found - expected).max()) > 3.5


@pytest.mark.slow
def test_adaptive_integration_obeys_the_constraints_as_well():
    system = al.ForwardDynamics(SliderCrank(), start={"crank": 0.7, "crank_rate": 5.0}, guess={"slider": 0.4})
    found = al.simulate(system, al.Grid(2.0, 20), integrator=al.integrators.Tsit5(rtol=1e-10, atol=1e-10))
    np.testing.assert_allclose(found["crank"], turning(800)["crank"][::40], atol=1e-6)
    assert np.asarray(found["constraint_error"]).max() < 1e-13


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


def end_of_crank(lengths):
    model = SliderCrank(a=lengths[0], b=lengths[1])
    system = al.ForwardDynamics(model, start={"crank": 0.9, "crank_rate": 8.0}, guess={"slider": 0.4})
    found = al.simulate(system, al.Grid(0.5, 60), only=("rod", "height_multiplier"))
    return jnp.stack([found["rod"][0], found["rod"][-1], found["height_multiplier"][-1]])


def end_of_bob(numbers):
    system = al.ForwardDynamics(Bob(length=numbers[0], gravity=numbers[1]), start={"x": 0.3}, guess={"y": -1.0})
    found = al.simulate(system, al.Grid(0.5, 60), only=("y", "length_multiplier"))
    return jnp.stack([found["y"][0], found["y"][-1], found["length_multiplier"][-1]])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "numbers", "order"), [(end_of_crank, (0.1, 0.3), 1), (end_of_bob, (1.0, 9.81), 2)], ids=["crank", "bob"]
)
def test_derivatives_by_numbers_are_those_of_finite_differences(end, numbers, order):
    numbers, h = jnp.array(numbers), 1e-5
    functions = [end]
    for _ in range(order):
        functions.append(jax.jacfwd(functions[-1]))
    functions = [jax.jit(one) for one in functions]
    for function, derivative in itertools.pairwise(functions):
        found = derivative(numbers)
        assert np.isfinite(found).all()
        for i, step in enumerate(h * jnp.eye(2)):
            slope = (function(numbers + step) - function(numbers - step)) / (2 * h)
            np.testing.assert_allclose(found[..., i], slope, rtol=1e-6, atol=1e-6 * np.abs(found).max())


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


@pytest.mark.parametrize("start", [{"lower": 0.0, "lower_rate": 1.0}, {"lower_rate": 1.0}])
def test_a_start_at_zero_that_obeys_the_constraints_up_to_rounding_is_taken(start):
    assert Coupled().constraint((0.0, 0.0)) != (0.0,)
    found = al.simulate(al.ForwardDynamics(Coupled(), start=start), al.Grid(0.5, 20))
    np.testing.assert_allclose([found["lower"][-1], found["upper"][-1]], 0.5, rtol=0, atol=1e-12)
