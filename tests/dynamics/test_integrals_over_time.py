"""Integrals over time are as accurate as the states are, whatever integrates them, and see what happens between."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

import aleator as al
from aleator.design import functionals_of, integrated_paths, responses, sampled
from compiling import compiled

STEPS = np.array([10, 20, 40, 80])
DECAY, START, END = 0.7, 2.0, 1.5


class Decay(al.System):
    """`x' = -rate x + cos(3 t)`, from 2."""

    states = ("x",)
    rate: Any

    def initial(self):
        return {"x": START}

    def rhs(self, t, z):
        return (-self.rate * z.x + jnp.cos(3 * t),)

    def outputs(self, t, z):
        return {"x": z.x, "slope": self.rhs(t, z)[0], "far": z.x + 5.0}


class Wave(al.System):
    """Nothing is integrated: its output is known at each instant."""

    states = ()
    rate: Any

    def rhs(self, t, z, u):
        return ()

    def outputs(self, t, z, u):
        return {"x": self.rate * jnp.exp(jnp.sin(5 * u)), "slope": u, "far": 1.0 + u}


def exact_state(t, rate=DECAY):
    particular = (rate * np.cos(3 * t) + 3 * np.sin(3 * t)) / (rate**2 + 9)
    return particular + (START - rate / (rate**2 + 9)) * np.exp(-rate * t)


def exact(functional, x, slope):
    def over(integrand):
        return integrate.quad(integrand, 0.0, END, epsabs=1e-13, epsrel=1e-13)[0]

    return {
        "integral": lambda: over(x),
        "rms": lambda: np.sqrt(over(lambda t: x(t) ** 2) / END),
        "effort": lambda: over(lambda t: x(t) ** 2),
        "work": lambda: over(lambda t: abs((x(t) + 5.0) * x(t))),
    }[functional]()


FUNCTIONALS = {
    "integral": al.integral("x").mean,
    "rms": al.rms("x").mean,
    "effort": al.objectives.effort("x"),
    "work": al.objectives.power({"far": "x"}),
}


def problem(functional, steps, integrator=None):
    return al.Problem(
        Decay(al.Decision(DECAY, 0.1, 2.0)), grid=al.Grid(END, steps), minimize=functional, integrator=integrator
    )


def value(declared):
    functionals = functionals_of(declared.expressions)
    found = compiled(lambda x: responses(declared, functionals, jnp.zeros((1, 0)), x))(jnp.array([DECAY]))
    return float(found[0][0])


@pytest.mark.parametrize("name", FUNCTIONALS)
def test_integrals_converge_with_the_order_of_the_integrator(name):
    errors = [abs(value(problem(FUNCTIONALS[name], int(n))) - exact(name, exact_state, None)) for n in STEPS]
    slope = np.polyfit(np.log(STEPS), np.log(errors), 1)[0]
    assert slope == pytest.approx(-4.0, abs=0.25)


@pytest.mark.parametrize(
    "integrator", [al.integrators.Tsit5(), al.integrators.Kvaerno5()], ids=lambda one: type(one).__name__
)
@pytest.mark.parametrize("name", ["rms", "work"])
def test_adaptive_integrators_hold_integrals_to_their_tolerance_on_a_coarse_grid(name, integrator):
    assert value(problem(FUNCTIONALS[name], 2, integrator)) == pytest.approx(exact(name, exact_state, None), rel=1e-7)


@pytest.mark.parametrize("name", ["integral", "rms", "effort"])
def test_integrals_of_what_is_not_integrated_converge_with_order_four(name):
    def found(steps):
        ramp = al.BSpline(np.array([0.0, END]), degree=1)
        wave = Wave(al.Decision(DECAY, 0.1, 2.0))
        return value(al.Problem(wave, grid=al.Grid(END, steps), inputs={"u": ramp}, minimize=FUNCTIONALS[name]))

    def x(t):
        return DECAY * np.exp(np.sin(5 * t))

    errors = [abs(found(int(n)) - exact(name, x, None)) for n in STEPS]
    assert np.polyfit(np.log(STEPS), np.log(errors), 1)[0] < -3.7


def test_time_integrals_of_spreads_converge_with_order_four():
    """`∫ σ[x] dt` for a uniform start: the spread of `x` is that of the start times `exp(-rate t)`."""

    class Started(Decay):
        first: Any = 0.0

        def initial(self):
            return {"x": self.first}

    half_width = 0.4
    truth = half_width / np.sqrt(3) * (1 - np.exp(-DECAY * END)) / DECAY

    def found(steps):
        declared = al.Problem(
            Started(al.Decision(DECAY, 0.1, 2.0), al.Uniform(START, half_width=half_width)),
            grid=al.Grid(END, steps),
            minimize=al.time_integral(al.path("x").std) + al.value("rate"),
            expansion=al.Expansion(order=1),
        )
        from aleator.transcription import transcribe

        return float(transcribe(declared).program.evaluate(np.array([DECAY])).objective) - DECAY

    errors = [abs(found(int(n)) - truth) for n in STEPS[:3]]
    assert np.polyfit(np.log(STEPS[:3]), np.log(errors), 1)[0] == pytest.approx(-4.0, abs=0.3)


def test_paths_between_the_instants_are_as_accurate_as_those_at_them():
    declared = problem(al.time_integral(al.path("x").mean), 40)
    paths = integrated_paths(declared.expressions)
    found = sampled(declared, paths, paths, jnp.zeros((1, 0)), jnp.array([DECAY]))
    times = np.linspace(0.0, END, 81)
    # What a cubic through both ends and their slopes leaves: h⁴ / 384 of the fourth derivative, which is below 30.
    np.testing.assert_allclose(found.nodes[0][0], exact_state(times), rtol=0, atol=30 * (END / 40) ** 4 / 384)
    np.testing.assert_allclose(found.nodes[0][0][::2], found.values[0][0], rtol=1e-15)


def test_a_control_that_is_wild_between_the_instants_is_not_cheap():
    """Zero at every instant, 10 between: what it costs is seen by states and integrals alike."""

    class Cart(al.System):
        states = ("v",)

        def rhs(self, t, z, u):
            return (u,)

        def outputs(self, t, z, u):
            return {"u": u, "v": z.v}

    knots = np.linspace(0.0, 1.0, 21)
    control = al.BSpline(np.where(np.arange(21) % 2 == 0, 0.0, 10.0), knots=knots[1:-1], degree=1)
    declared = al.Problem(
        Cart(), grid=al.Grid(al.Decision(1.0, 0.5, 2.0), 10), inputs={"u": control}, minimize=al.objectives.effort("u")
    )
    functionals = functionals_of(declared.expressions)
    assert float(responses(declared, functionals, jnp.zeros((1, 0)), jnp.array([1.0]))[0][0]) == pytest.approx(
        200 / 3, rel=1e-12
    )
