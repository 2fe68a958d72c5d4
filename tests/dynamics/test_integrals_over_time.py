"""Integrals over time are as accurate as the states are, whatever integrates them, and see what happens between."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

import aleator as al
from aleator.design import functionals_of, integrated_paths, responses, sampled
from aleator.transcription import transcribe
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


def exact(functional, x):
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


def values(*declared, at=DECAY):
    """The values of one functional each, by one program."""

    def all_of(x):
        return [responses(one, functionals_of(one.expressions), jnp.zeros((1, 0)), x)[0][0] for one in declared]

    return np.array([float(number) for number in compiled(all_of)(np.array([at]))])


def slope_of(problems, truth):
    errors = np.abs(values(*problems) - truth)
    return np.polyfit(np.log(STEPS), np.log(errors), 1)[0]


@pytest.mark.parametrize("name", FUNCTIONALS)
def test_integrals_converge_with_the_order_of_the_integrator(name):
    problems = [problem(FUNCTIONALS[name], int(n)) for n in STEPS]
    assert slope_of(problems, exact(name, exact_state)) == pytest.approx(-4.0, abs=0.25)


@pytest.mark.parametrize(
    ("integrator", "name"),
    [
        (al.integrators.Tsit5(), "work"),
        pytest.param(al.integrators.Kvaerno5(), "rms", marks=pytest.mark.slow),
    ],
)
def test_adaptive_integrators_hold_integrals_to_their_tolerance_on_a_coarse_grid(name, integrator):
    declared = problem(FUNCTIONALS[name], 2, integrator)
    np.testing.assert_allclose(values(declared), exact(name, exact_state), rtol=1e-7)


def test_integrals_of_what_is_not_integrated_converge_with_order_four():
    def waves(steps, name):
        ramp = al.BSpline(np.array([0.0, END]), degree=1)
        wave = Wave(al.Decision(DECAY, 0.1, 2.0))
        return al.Problem(wave, grid=al.Grid(END, steps), inputs={"u": ramp}, minimize=FUNCTIONALS[name])

    def x(t):
        return DECAY * np.exp(np.sin(5 * t))

    for name in ("integral", "effort"):
        assert slope_of([waves(int(n), name) for n in STEPS], exact(name, x)) < -3.7


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
        return float(transcribe(declared).program.evaluate(np.array([DECAY])).objective) - DECAY

    errors = [abs(found(int(n)) - truth) for n in STEPS[:3]]
    assert np.polyfit(np.log(STEPS[:3]), np.log(errors), 1)[0] == pytest.approx(-4.0, abs=0.3)


def test_paths_between_the_instants_are_as_accurate_as_those_at_them():
    declared = problem(al.time_integral(al.path("x").mean), 40)
    paths = integrated_paths(declared.expressions)
    found = compiled(lambda x: sampled(declared, paths, paths, jnp.zeros((1, 0)), x))(np.array([DECAY]))
    times, nodes = np.linspace(0.0, END, 81), np.asarray(found.nodes[0])[0]
    # What a cubic through both ends and their slopes leaves: h⁴ / 384 of the fourth derivative, which is below 30.
    np.testing.assert_allclose(nodes, exact_state(times), rtol=0, atol=30 * (END / 40) ** 4 / 384)
    np.testing.assert_allclose(nodes[::2], np.asarray(found.values[0])[0], rtol=1e-15)


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
    np.testing.assert_allclose(values(declared, at=1.0), 200 / 3, rtol=1e-12)
