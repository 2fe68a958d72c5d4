"""A run of an FMU is a function of its parameters, with derivatives."""

import functools

import jax
import numpy as np
import pytest
import scipy

import aleator as al
from compiling import compiled
from rod_models import Rod
from rods import here

MODEL_EXCHANGE, CO_SIMULATION = "model exchange", "co-simulation"
GRID = al.Grid(2.0, 20)
AT = np.array([0.2, 1.1, 0.9])
EXACT = al.integrators.Tsit5(rtol=1e-12, atol=1e-12)
UNCERTAIN = {"damping": al.Uniform(0.2, half_width=0.05), "rod.length": al.Uniform(1.1, half_width=0.02)}


def own(damping=0.1, length=1.0, angle=1.0, **more):
    return al.simulate(Rod(damping, length, angle), GRID, integrator=EXACT, **more)


def swinging(rods, version=3, kind=None, grid=GRID, *, wall=False, **more):
    return al.foreign.FmuSimulation(here(rods(version, wall=wall), kind=kind), grid, **more)


def with_slopes(motion):
    """Outputs at `AT`, by damping, length and first angle, and their derivatives."""
    found = compiled(lambda at: (motion(at), jax.jacfwd(motion)(at)))(AT)
    return jax.tree.map(np.asarray, found)


own_slopes = functools.cache(lambda: with_slopes(lambda at: own(*at)))


@pytest.mark.parametrize(("version", "kind"), [(2, CO_SIMULATION), (3, MODEL_EXCHANGE)])
def test_an_fmu_swings_like_the_same_rod_written_here_and_has_its_derivatives(rods, version, kind):
    run = swinging(rods, version, kind)
    found, slopes = with_slopes(lambda at: run({"damping": at[0], "rod.length": at[1], "angle": at[2]}))
    expected, expected_slopes = own_slopes()
    assert set(found) == set(expected)
    for name in expected:
        assert found[name] == pytest.approx(expected[name], abs=2e-8)
        assert slopes[name] == pytest.approx(expected_slopes[name], abs=1e-6)


def test_inputs_are_signals_or_constants(rods):
    grid, torque = al.Grid(2.0, 400), al.Tabulated([0.0, 0.5, 2.0], [0.0, 2.0, -1.0])
    expected = np.asarray(al.simulate(Rod(), grid, {"torque": torque}, only=["angle"])["angle"])
    # Co-simulation has the mean of an input in each step, which is of second order.
    for version, kind, error in ((2, CO_SIMULATION, 2e-5), (3, MODEL_EXCHANGE, 1e-6)):
        found = swinging(rods, version, kind, grid, inputs={"torque": torque}, outputs=["angle"])({})
        assert found["angle"] == pytest.approx(expected, abs=error)
    # At rest, a constant torque holds the rod where it balances the weight.
    held = swinging(rods, outputs=["angle"])({"torque": 9.81 / 2 * np.sin(1.0)})
    assert held["angle"] == pytest.approx(np.ones(21), abs=1e-7)


def bounced(wall, damping=0.1):
    """The angle at the end, with SciPy's events: the rod comes back from a wall with 80 % of its speed."""

    def rates(t, y):
        return y[1], 3 * (-9.81 / 2 * np.sin(y[0]) - damping * y[1])

    def hit(t, y):
        return y[0] - wall

    hit.terminal, hit.direction = True, -1  # type: ignore[attr-defined]
    t, y = 0.0, np.array([1.0, 0.0])
    while t < 2.0:
        found = scipy.integrate.solve_ivp(rates, (t, 2.0), y, rtol=1e-11, atol=1e-12, events=hit)
        t, y = found.t[-1], found.y[:, -1] * [1.0, -0.8 if found.status == 1 else 1.0]
    return y[0]


@pytest.mark.parametrize("version", [2, 3])
def test_events_are_found_and_handled(rods, version):
    assert swinging(rods, version, wall=True)({"wall": -0.3})["angle"][-1] == pytest.approx(bounced(-0.3), abs=1e-7)


def test_beyond_events_gradients_are_differences_of_runs(rods):
    run = swinging(rods, wall=True, outputs=["angle"])
    found = compiled(jax.jacfwd(lambda wall: run({"wall": wall})["angle"][-1]))(-0.3)
    assert float(found) == pytest.approx((bounced(-0.2999) - bounced(-0.3001)) / 2e-4, abs=1e-4)


def test_differences_that_disagree_are_warned_of(rods):
    run = swinging(rods, grid=al.Grid(2.0, 20), wall=True, outputs=["angle", "rate"])
    # The rod comes to the wall at the time of an instant: its rate there jumps.
    wall = float(run({"wall": -2.0})["angle"][7])
    with pytest.warns(al.SimulationWarning, match="by 'wall' is unreliable: differences over two steps disagree"):
        jax.block_until_ready(compiled(jax.jacfwd(lambda at: run({"wall": at})["rate"]))(wall))


def test_uncertain_parameters_are_expanded(rods):
    def mine(at):
        return own(at["damping"], at["rod.length"], only=["energy"])["energy"]

    run, order = swinging(rods, outputs=["energy"]), al.Expansion(order=3)
    expected = al.expand(mine, UNCERTAIN, order)
    found = al.expand(run, UNCERTAIN, order, traced=False)["energy"]
    assert np.asarray(found.mean) == pytest.approx(np.asarray(expected.mean), abs=1e-7)
    assert np.asarray(found.std) == pytest.approx(np.asarray(expected.std), abs=1e-7)
