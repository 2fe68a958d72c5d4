import itertools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import aleator as al
from compiling import compiled
from zoo import Decay, Oscillator, derivative_error, sine

TIMES = np.linspace(0.0, 5.0, 41)
PUSH = np.cos(1.7 * TIMES) + 0.3 * np.sin(5.0 * TIMES)


class Pendulum(al.System):
    """A driven, damped pendulum: nonlinear, with an input."""

    states = ("angle", "speed")
    damping: float = 0.3
    start: float = 0.8

    def rhs(self, t, z, push):
        return z.speed, push - self.damping * z.speed * z.angle**2 - 4.0 * jnp.sin(z.angle)

    def outputs(self, t, z, push):
        return {
            "angle": z.angle,
            "speed": z.speed,
            "energy": 0.5 * z.speed**2 + 4.0 * (1 - jnp.cos(z.angle)),
            "u": push,
        }

    def initial(self):
        return {"angle": self.start}


def scipy_pendulum(times, damping=0.3, start=0.8):
    def rhs(t, z):
        return [z[1], np.interp(t, TIMES, PUSH) - damping * z[1] * z[0] ** 2 - 4.0 * np.sin(z[0])]

    # The input has kinks: restart at each of them, so that the reference is as good as its tolerance.
    knots = np.union1d(TIMES, times)
    state, states = np.array([start, 0.0]), [[start, 0.0]]
    for a, b in itertools.pairwise(knots):
        state = solve_ivp(rhs, (a, b), state, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        states.append(state)
    return np.array(states)[np.searchsorted(knots, times)].T


def test_runge_kutta_converges_with_order_four():
    # Damped oscillator from rest at 1, no force: closed form.
    m, c, k, end = 1.0, 0.4, 9.0, 2.0
    system = Oscillator(m=m, c=c, k=k, x0=1.0)
    silence = al.Tabulated(np.array([0.0, end]), np.zeros(2))
    times, damping = np.linspace(0.0, end, 11), c / (2 * m)
    frequency = np.sqrt(k / m - damping**2)
    exact = np.exp(-damping * times) * (np.cos(frequency * times) + damping / frequency * np.sin(frequency * times))
    steps = np.array([40, 160, 640])
    errors = [
        np.abs(np.asarray(al.simulate(system, al.Grid(end, int(n)), {"force": silence})["x"])[:: n // 10] - exact).max()
        for n in steps
    ]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(-4.0, abs=0.1)


def test_runge_kutta_agrees_with_scipy_on_a_nonlinear_system_with_a_tabulated_input():
    grid = al.Grid(5.0, 4000)
    outputs = al.simulate(Pendulum(), grid, {"push": al.Tabulated(TIMES, PUSH)})
    outputs = {name: np.asarray(values) for name, values in outputs.items()}
    at = np.arange(0, 4001, 400)
    angle, speed = scipy_pendulum(np.asarray(grid.times)[at])
    np.testing.assert_allclose(outputs["angle"][at], angle, atol=1e-10)
    np.testing.assert_allclose(outputs["speed"][at], speed, atol=1e-10)
    np.testing.assert_allclose(outputs["energy"][at], 0.5 * speed**2 + 4 * (1 - np.cos(angle)), atol=1e-9)
    np.testing.assert_allclose(outputs["u"], np.interp(grid.times, TIMES, PUSH), atol=1e-14)


class Robertson(al.System):
    """Chemical kinetics with rates from 0.04 to 3e7: stiff (Robertson, 1966)."""

    states = ("a", "b", "c")

    def rhs(self, t, z):
        slow, fast, quadratic = 0.04 * z.a, 1e4 * z.b * z.c, 3e7 * z.b**2
        return -slow + fast, slow - fast - quadratic, quadratic

    def outputs(self, t, z):
        return {"a": z.a, "b": z.b, "c": z.c}

    def initial(self):
        return {"a": 1.0}


@pytest.mark.parametrize(
    "integrator",
    # The other method is the one by which the error of the first is estimated.
    [al.integrators.Kvaerno5(), pytest.param(al.integrators.Kvaerno5().reference(), marks=pytest.mark.slow)],
    ids=lambda one: type(one).__name__,
)
def test_implicit_methods_solve_a_stiff_problem(integrator):
    def rhs(t, z):
        slow, fast, quadratic = 0.04 * z[0], 1e4 * z[1] * z[2], 3e7 * z[1] ** 2
        return [-slow + fast, slow - fast - quadratic, quadratic]

    grid = al.Grid(40.0, 8)
    reference = solve_ivp(rhs, (0, 40), [1, 0, 0], "Radau", np.asarray(grid.times), rtol=1e-11, atol=1e-14).y
    outputs = al.simulate(Robertson(), grid, integrator=integrator)
    for name, values in zip("abc", reference, strict=True):
        np.testing.assert_allclose(outputs[name], values, rtol=1e-6, atol=1e-12)


class Chain(al.System):
    """Masses in a row as two array-valued states, after a scalar one."""

    states = ("clock", "positions", "speeds")

    def rhs(self, t, z):
        padded = jnp.pad(z.positions, 1)
        return 1.0, z.speeds, padded[2:] - 2 * z.positions + padded[:-2]

    def outputs(self, t, z):
        return {"clock": z.clock, "positions": z.positions, "matrix": jnp.outer(z.positions, z.positions)}

    def initial(self):
        return {"positions": np.array([1.0, 0.0, -0.5]), "speeds": np.zeros(3)}


@pytest.mark.parametrize(
    "integrator", [al.integrators.RungeKutta4(), al.integrators.Tsit5()], ids=["RungeKutta4", "Tsit5"]
)
def test_states_may_be_arrays(integrator):
    grid = al.Grid(2.0, 200)
    outputs = al.simulate(Chain(), grid, integrator=integrator)
    stiffness = 2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    squares, modes = np.linalg.eigh(stiffness)
    amplitudes = modes.T @ [1.0, 0.0, -0.5]
    exact = np.cos(np.outer(grid.times, np.sqrt(squares))) * amplitudes @ modes.T
    assert outputs["positions"].shape == (201, 3)
    np.testing.assert_allclose(outputs["positions"], exact, atol=1e-7)
    np.testing.assert_allclose(outputs["matrix"], exact[:, :, None] * exact[:, None, :], atol=1e-7)
    np.testing.assert_allclose(outputs["clock"], grid.times, atol=1e-12)


def test_states_that_are_not_named_start_at_zero_and_a_grid_may_start_late():
    grid = al.Grid(3.0, 100, t_start=1.0)
    outputs = al.simulate(Oscillator(m=1.0, c=0.0, k=4.0, x0=0.7), grid, {"force": sine(0.0)})
    assert float(outputs["v"][0]) == 0.0
    np.testing.assert_allclose(outputs["x"], 0.7 * np.cos(2.0 * (np.asarray(grid.times) - 1.0)), atol=1e-6)


@pytest.mark.parametrize(
    "integrator",
    [
        al.integrators.RungeKutta4(),
        al.integrators.Tsit5(1e-12, 1e-13),
        pytest.param(al.integrators.Kvaerno5(1e-12, 1e-13), marks=pytest.mark.slow),
    ],
    ids=lambda one: type(one).__name__,
)
def test_derivatives_through_every_integrator_agree_with_finite_differences(integrator):
    # A smooth input: an adaptive step that crosses a kink makes noise in the differences, not in the derivative.
    grid, inputs = al.Grid(3.0, 60), {"push": al.Tabulated(np.array([0.0, 3.0]), np.array([-1.0, 1.0]))}

    def angles(numbers):
        return al.simulate(Pendulum(damping=numbers[0], start=numbers[1]), grid, inputs, integrator)["angle"]

    both = compiled(lambda x: (angles(x), jax.jacfwd(angles)(x)))
    point = np.array([0.3, 0.8])
    assert derivative_error(lambda x: np.asarray(both(x)[0]), both(point)[1], point) < 1e-6


@pytest.mark.parametrize(
    "integrator",
    [al.integrators.Tsit5(1e-9, 1e-11), pytest.param(al.integrators.Kvaerno5(1e-9, 1e-11), marks=pytest.mark.slow)],
    ids=lambda one: type(one).__name__,
)
def test_adaptive_integrators_agree_with_scipy_behind_the_same_call(integrator):
    grid = al.Grid(5.0, 10)
    outputs = al.simulate(Pendulum(), grid, {"push": al.Tabulated(TIMES, PUSH)}, integrator)
    angle, speed = scipy_pendulum(np.asarray(grid.times))
    np.testing.assert_allclose(outputs["angle"], angle, atol=1e-6)
    np.testing.assert_allclose(outputs["speed"], speed, atol=1e-6)


class Explosion(al.System):
    """`x' = x²`, which is infinite at `1 / x(0)`."""

    states = ("x",)

    start: al.Number = 1.0

    def rhs(self, t, z):
        return (z.x**2,)

    def outputs(self, t, z):
        return {"x": z.x, "constant": 1.0}

    def initial(self):
        return {"x": self.start}


def test_what_runs_away_is_named_at_its_first_time():
    with pytest.warns(al.SimulationWarning, match=r"Explosion: output 'x' is not finite at t = (\d+\.?\d*) s") as told:
        x = np.asarray(al.simulate(Explosion(), al.Grid(40.0, 40))["x"])
    first = int(np.argmax(~np.isfinite(x)))
    assert first > 0
    assert f"t = {first} s" in str(told[0].message)
    # What stays finite is not warned of, nor what is traced.
    assert np.isfinite(al.simulate(Explosion(), al.Grid(0.5, 40))["x"]).all()
    assert not np.isfinite(compiled(lambda x: al.simulate(Explosion(x), al.Grid(40.0, 40))["x"])(1.0)[-1])


@pytest.mark.parametrize(
    ("system", "end", "integrator", "message"),
    [
        (Explosion(), 2.0, al.integrators.Tsit5(max_steps=300), r"is not finite at any instant\. .* stops at t = 1 s"),
        pytest.param(
            Explosion(),
            2.0,
            al.integrators.Kvaerno5(max_steps=300),
            r"is not finite at any instant",
            marks=pytest.mark.slow,
        ),
        (Decay(1.0), 50.0, al.integrators.Tsit5(max_steps=3), "used up its 3 steps at t = "),
    ],
)
def test_adaptive_integration_that_fails_gives_no_number(system, end, integrator, message):
    with pytest.warns(al.SimulationWarning, match=message):
        outputs = al.simulate(system, al.Grid(end, 4), integrator=integrator)
    assert np.isnan(outputs["x"]).all()


class Falling(al.System):
    """`x² = 1 - 2 rate t`: the rate of `x` is a root of a negative number once `x` has vanished, at `0.5 / rate`."""

    states = ("x",)
    rate: al.Number

    def rhs(self, t, z):
        return (-self.rate / jnp.sqrt(1 - 2 * self.rate * t),)

    def outputs(self, t, z):
        return {"x": z.x}

    def initial(self):
        return {"x": 1.0}


def family(integrator):
    """Systems whose rate is spread around a decided number."""
    return al.Problem(
        Falling(al.Uniform(al.Decision(2.0, 1.0, 3.0), half_width=0.1)),
        grid=al.Grid(1.0, 4),
        minimize=al.terminal("x").mean,
        expansion=al.Expansion(order=1),
        integrator=integrator,
    )


@pytest.mark.slow
def test_a_stiff_integrator_that_fails_within_a_design_is_a_status_and_names_the_time_it_reached():
    solution = al.solve(family(al.integrators.Kvaerno5(max_steps=200)), throw=False)
    assert solution.status is al.Status.EVALUATION_FAILED
    rate = float(re.search(r"\(rate=([\d.]+)\)", solution.message)[1])
    reached = float(re.search(r"stops at t = ([\d.]+) s", solution.message)[1])
    assert reached == pytest.approx(0.5 / rate, rel=1e-2)


def test_an_integrator_that_runs_out_of_steps_asks_for_more_and_not_for_itself():
    said = al.integrators.Tsit5(max_steps=3).explain(Falling(2.0), al.Grid(0.15, 4), {})
    assert re.search(r"Tsit5 used up its 3 steps .* al.integrators.Tsit5\(max_steps=30\)", said)
    assert al.integrators.Tsit5().explain(Falling(1.0), al.Grid(0.25, 4), {}) == ""


@pytest.mark.parametrize(("t_final", "steps"), [(15.8, 49), (0.7, 49)])
def test_adaptive_integrators_take_any_grid_whatever_its_rounding(t_final, steps):
    grid = al.Grid(t_final, steps)
    assert float(grid.times[-1]) == t_final
    outputs = al.simulate(Decay(1.0), grid, integrator=al.integrators.Tsit5())
    np.testing.assert_allclose(outputs["x"], np.exp(-np.linspace(0.0, t_final, steps + 1)), atol=1e-7)
