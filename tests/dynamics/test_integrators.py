import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import aleator as al
from aleator.dynamics import Asked, simulation_of
from compiling import compiled
from zoo import Decay, cases, derivative_error

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


class Clock(al.System):
    """A cubic rate of the time alone, which rules of the fourth order integrate without error."""

    states = ("x",)

    def rhs(self, t, z):
        return (4.0 * t**3,)

    def outputs(self, t, z):
        return {"x": z.x}


def test_each_stage_of_a_step_sees_its_own_time_from_a_late_start_too():
    times = np.linspace(0.5, 2.0, 4)
    found = al.simulate(Clock(), al.Grid(2.0, 3, t_start=0.5))["x"]
    np.testing.assert_allclose(found, times**4 - 0.5**4, rtol=1e-13)


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


def test_an_implicit_method_solves_a_stiff_problem():
    def rhs(t, z):
        slow, fast, quadratic = 0.04 * z[0], 1e4 * z[1] * z[2], 3e7 * z[1] ** 2
        return [-slow + fast, slow - fast - quadratic, quadratic]

    grid = al.Grid(40.0, 8)
    reference = solve_ivp(rhs, (0, 40), [1, 0, 0], "Radau", np.asarray(grid.times), rtol=1e-11, atol=1e-14).y
    outputs = al.simulate(Robertson(), grid, integrator=al.integrators.Rodas5P())
    for name, values in zip("abc", reference, strict=True):
        np.testing.assert_allclose(outputs[name], values, rtol=1e-6, atol=1e-12)


class Driven(al.System):
    """A state, an algebraic variable and the time in one another's equations."""

    states = ("x",)
    algebraic = ("y",)

    def rhs(self, t, z):
        return (jnp.sin(t) - z.y,)

    def residual(self, t, z):
        return (z.y + z.y**3 - z.x * (1 + 0.5 * jnp.cos(2 * t)),)

    def outputs(self, t, z):
        return {"x": z.x}

    def initial(self):
        return {"x": 1.0}


@pytest.mark.parametrize("integrator", cases([al.integrators.Tsit5, al.integrators.Rodas5P]))
def test_adaptive_methods_have_order_five_with_algebraic_variables_too(integrator):
    def rates(t, x):
        y = np.roots([1.0, 0.0, 1.0, -x[0] * (1 + 0.5 * np.cos(2 * t))])
        return [np.sin(t) - y[np.argmin(np.abs(y.imag))].real]

    right = solve_ivp(rates, (0.0, 2.0), [1.0], "DOP853", rtol=1e-12, atol=1e-14).y[0, -1]
    # Tolerances that accept any step: one between two instants.
    loose, steps = integrator(1e9, 1e9), np.array([8, 24])
    ends = [np.asarray(al.simulate(Driven(), al.Grid(2.0, int(n)), integrator=loose)["x"])[-1] for n in steps]
    errors = np.abs(np.array(ends) - right)
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] < -4.7


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


def test_states_may_be_arrays():
    grid = al.Grid(2.0, 200)
    outputs = al.simulate(Chain(), grid)
    stiffness = 2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    squares, modes = np.linalg.eigh(stiffness)
    amplitudes = modes.T @ [1.0, 0.0, -0.5]
    exact = np.cos(np.outer(grid.times, np.sqrt(squares))) * amplitudes @ modes.T
    assert outputs["positions"].shape == (201, 3)
    np.testing.assert_allclose(outputs["positions"], exact, atol=1e-7)
    np.testing.assert_allclose(outputs["matrix"], exact[:, :, None] * exact[:, None, :], atol=1e-7)
    np.testing.assert_allclose(outputs["clock"], grid.times, atol=1e-12)


@pytest.mark.parametrize(
    "integrator",
    cases([al.integrators.Tsit5(1e-12, 1e-13), al.integrators.Rodas5P(1e-12, 1e-13)]),
    ids=lambda one: type(one).__name__,
)
def test_derivatives_through_adaptive_integrators_agree_with_finite_differences(integrator):
    # A smooth input: an adaptive step that crosses a kink makes noise in the differences, not in the derivative.
    grid, inputs = al.Grid(3.0, 60), {"push": al.Tabulated(np.array([0.0, 3.0]), np.array([-1.0, 1.0]))}

    def angles(numbers):
        return al.simulate(Pendulum(damping=numbers[0], start=numbers[1]), grid, inputs, integrator)["angle"]

    both = compiled(lambda x: (angles(x), jax.jacfwd(angles)(x)))
    point = np.array([0.3, 0.8])
    assert derivative_error(lambda x: np.asarray(both(x)[0]), both(point)[1], point) < 1e-6


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
    assert not np.isfinite(np.asarray(compiled(lambda x: al.simulate(Explosion(x), al.Grid(40.0, 40))["x"])(1.0))[-1])


@pytest.mark.parametrize(
    ("system", "end", "steps", "message"),
    cases(
        [
            (Explosion(), 2.0, 300, r"is not finite at any instant\. .* stops at t = 1 s"),
            (Decay(1.0), 50.0, 3, r"used up its 3 steps at t = .* al.integrators.Tsit5\(max_steps=30\)"),
        ]
    ),
)
def test_adaptive_integration_that_fails_gives_no_number(system, end, steps, message):
    with pytest.warns(al.SimulationWarning, match=message):
        outputs = al.simulate(system, al.Grid(end, 4), integrator=al.integrators.Tsit5(max_steps=steps))
    assert np.isnan(next(iter(outputs.values()))).all()


def test_derivatives_by_many_decisions_are_those_of_the_pendulum_alone():
    # An output of the input alone is the same in all realisations, and so are its derivatives.
    grid = al.Grid(2.0, 20)

    def motion(points, damping):
        inputs = {"push": al.BSpline(points)}
        record = simulation_of(Pendulum(damping, points[0]), grid, inputs, None).declared().record
        asked = Asked(frozenset({"angle", "energy"}), integrands=(lambda now: now["u"] ** 2,), integrated=({"u"},))
        few, all_of_them = (record(asked._replace(directions=n)) for n in (12, 0))
        return [[*one.history.values(), *one.integrals] for one in (few, all_of_them)]

    every = jax.vmap(motion, (None, 0))
    values, slopes = jax.jit(lambda *at: (every(*at), jax.jacfwd(every)(*at)))(
        jnp.linspace(0.5, -0.3, 12), jnp.array([0.2, 0.4])
    )
    for few, all_of_them in values, slopes:
        assert len(few) == 3
        for one, other in zip(few, all_of_them, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-13)
