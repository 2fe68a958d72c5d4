"""A run of an FMU is a function of its parameters, with derivatives."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import aleator as al
from rod_models import HangingRod, Rod
from rods import here

MODEL_EXCHANGE, CO_SIMULATION = "model exchange", "co-simulation"
KINDS = [(version, kind) for version in (2, 3) for kind in (MODEL_EXCHANGE, CO_SIMULATION)]
GRID = al.Grid(2.0, 20)
AT = jnp.array([0.2, 1.1, 0.9])
EXACT = al.integrators.Tsit5(rtol=1e-12, atol=1e-12)
UNCERTAIN = {"damping": al.Uniform(0.2, half_width=0.05), "rod.length": al.Uniform(1.1, half_width=0.02)}


def own(damping=0.1, length=1.0, angle=1.0, **more):
    return al.simulate(Rod(damping, length, angle), GRID, integrator=EXACT, **more)


def swinging(rods, version=3, kind=None, grid=GRID, **more):
    how = {name: more.pop(name) for name in ("settings",) if name in more}
    made = {name: more.pop(name) for name in ("wall", "slopes") if name in more}
    return al.foreign.FmuSimulation(here(rods(version, **made), kind=kind, **how), grid, **more)


@pytest.mark.parametrize(("version", "kind"), KINDS)
def test_an_fmu_swings_like_the_same_rod_written_here(rods, version, kind):
    found, expected = swinging(rods, version, kind)({}), own()
    assert set(found) == set(expected)
    for name, values in found.items():
        assert values == pytest.approx(np.asarray(expected[name]), abs=2e-8)


def test_an_fmu_swings_like_a_body_on_a_hinge(rods):
    body = al.ForwardDynamics(HangingRod(), start={"rod": 1.0})
    found = al.simulate(body, GRID, integrator=EXACT, only=["rod"])["rod"]
    assert swinging(rods)({})["angle"] == pytest.approx(np.asarray(found), abs=2e-8)


def test_parameters_and_initial_values_are_set_by_name(rods):
    found = swinging(rods)({"damping": 0.3, "rod.length": 1.2, "angle": 0.5})
    assert found["energy"] == pytest.approx(np.asarray(own(0.3, 1.2, 0.5)["energy"]), abs=2e-8)


@functools.cache
def own_gradient():
    """The derivatives of the energy by damping, length and first angle, at `AT`."""
    return np.asarray(jax.jacfwd(lambda p: own(*p, only=["energy"])["energy"])(AT))


@pytest.mark.parametrize(("version", "kind"), KINDS)
def test_gradients_are_those_of_the_same_rod_written_here(rods, version, kind):
    run = swinging(rods, version, kind, outputs=["energy"])
    found = jax.jacfwd(lambda p: run({"damping": p[0], "rod.length": p[1], "angle": p[2]})["energy"])(AT)
    assert np.asarray(found) == pytest.approx(own_gradient(), abs=1e-6)


def test_gradients_agree_with_differences_of_runs(rods):
    run = swinging(rods, outputs=["energy"], tolerance=1e-11)
    found = jax.jacrev(lambda damping: run({"damping": damping})["energy"])(0.2)
    step = 1e-4
    expected = (run({"damping": 0.2 + step})["energy"] - run({"damping": 0.2 - step})["energy"]) / (2 * step)
    assert np.asarray(found) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("made", "how"),
    [
        ({"slopes": False}, "offers none"),
        ({"settings": {"behaviour": 5}}, "wrong by parameters"),
        ({"settings": {"behaviour": 6}}, "refused by parameters"),
    ],
    ids=lambda it: it if isinstance(it, str) else "",
)
def test_derivatives_that_an_fmu_lacks_or_gets_wrong_are_found_by_differences(rods, made, how):
    run = swinging(rods, outputs=["energy"], **made)
    found = jax.jacfwd(lambda p: run({"damping": p[0], "rod.length": p[1], "angle": p[2]})["energy"])(AT)
    assert np.asarray(found) == pytest.approx(own_gradient(), abs=1e-6), how


@pytest.mark.slow
def test_second_derivatives_are_differences_of_the_first(rods):
    run = swinging(rods, grid=al.Grid(2.0, 1), outputs=["energy"])
    found = jax.hessian(lambda damping: run({"damping": damping})["energy"][-1])(0.2)
    slope = jax.jit(jax.jacfwd(lambda damping: own(damping, only=["energy"])["energy"][-1]))
    expected = (slope(0.2 + 1e-4) - slope(0.2 - 1e-4)) / 2e-4
    assert float(found) == pytest.approx(float(expected), rel=1e-4)


@pytest.mark.parametrize(("version", "kind"), [(2, CO_SIMULATION), (3, MODEL_EXCHANGE)])
def test_inputs_are_signals(rods, version, kind):
    torque = al.Tabulated([0.0, 0.5, 2.0], [0.0, 2.0, -1.0])
    found = swinging(rods, version, kind, al.Grid(2.0, 400), inputs={"torque": torque}, outputs=["angle"])({})
    expected = al.simulate(Rod(), al.Grid(2.0, 400), {"torque": torque}, only=["angle"])
    # Co-simulation has the mean of an input in each step, which is of second order.
    assert found["angle"] == pytest.approx(np.asarray(expected["angle"]), abs=1e-6 if version == 3 else 2e-5)


def test_a_constant_input_is_a_parameter(rods):
    run = swinging(rods, outputs=["angle"])
    found = jax.jacfwd(lambda torque: run({"torque": torque})["angle"])(0.5)
    higher, lower = (run({"torque": 0.5 + step})["angle"] for step in (1e-3, -1e-3))
    assert np.asarray(found) == pytest.approx((higher - lower) / 2e-3, abs=1e-6)


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
    found = jax.jacfwd(lambda wall: run({"wall": wall})["angle"][-1])(-0.3)
    assert float(found) == pytest.approx((bounced(-0.2999) - bounced(-0.3001)) / 2e-4, abs=1e-4)


def test_differences_that_disagree_are_warned_of(rods):
    run = swinging(rods, grid=al.Grid(2.0, 20), wall=True, outputs=["angle", "rate"])
    # The rod comes to the wall at the time of an instant: its rate there jumps.
    wall = float(run({"wall": -2.0})["angle"][7])
    with pytest.warns(al.SimulationWarning, match="by 'wall' is unreliable: differences over two steps disagree"):
        jax.jacfwd(lambda at: run({"wall": at})["rate"])(wall)


def test_uncertain_parameters_are_expanded(rods):
    def mine(at):
        return own(at["damping"], at["rod.length"], only=["energy"])["energy"]

    run, order = swinging(rods, grid=GRID, outputs=["energy"]), al.Expansion(order=3)
    expected = al.expand(mine, UNCERTAIN, order)
    for traced in (False, True):
        found = al.expand(run, UNCERTAIN, order, traced=traced)["energy"]
        assert np.asarray(found.mean) == pytest.approx(np.asarray(expected.mean), abs=1e-7)
        assert np.asarray(found.std) == pytest.approx(np.asarray(expected.std), abs=1e-7)


def test_monte_carlo_and_linearisation_take_a_run(rods):
    run = swinging(rods, 2, CO_SIMULATION, al.Grid(1.0, 2), outputs=["energy"])
    expanded = al.expand(run, UNCERTAIN, al.Expansion(order=3), traced=False)["energy"]
    sample = al.references.monte_carlo(run, UNCERTAIN, 400, seed=1, traced=False)["energy"]
    assert float(sample.std.value[-1]) == pytest.approx(float(expanded.std[-1]), rel=0.15)
    linear = al.references.linearise(run, UNCERTAIN)
    assert float(linear.std["energy"][-1]) == pytest.approx(float(expanded.std[-1]), rel=0.05)


@pytest.mark.slow
def test_a_tolerance_analysis_takes_a_run(rods):
    run = swinging(rods, 2, CO_SIMULATION, al.Grid(1.0, 2), outputs=["energy"])
    found = al.tolerance_analysis(UNCERTAIN, lambda at: run(at)["energy"][-1], upper=2.0)
    # The longer the rod and the weaker the damping, the more energy is left.
    corner = run({"damping": 0.15, "rod.length": 1.12})["energy"][-1]
    assert found.mean + 3 * found.std < 2.5
    assert corner > found.mean


@pytest.mark.slow
def test_a_design_with_a_run_is_optimal_as_with_the_same_rod_written_here(rods):
    class Swing(al.AlgebraicSystem):
        damping: al.Number
        length: al.Number
        energy: object

        def outputs(self):
            return {"energy": self.energy(self.damping, self.length)}

    grid = al.Grid(1.0, 4)
    run = swinging(rods, 2, CO_SIMULATION, grid, outputs=["energy"])

    def by_fmu(damping, length):
        return run({"damping": damping, "rod.length": length})["energy"][-1]

    def by_rod(damping, length):
        return al.simulate(Rod(damping, length), grid, integrator=EXACT, only=["energy"])["energy"][-1]

    def solution(energy):
        damping = al.Uniform(al.Decision(0.3, 0.05, 3.0), half_width=0.05)
        left = al.output("energy")
        return al.solve(
            al.Problem(
                Swing(damping, al.Uniform(1.0, half_width=0.05), energy),
                minimize=al.value("damping.mean"),
                subject_to=[left.mean + 2 * left.std <= 1.0],
                expansion=al.Expansion(order=2),
            )
        )

    found = solution(by_fmu)
    assert found.ok
    assert found.objective == pytest.approx(solution(by_rod).objective, rel=1e-7)
