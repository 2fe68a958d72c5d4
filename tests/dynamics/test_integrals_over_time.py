"""Integrals over time are as accurate as the states are, whatever integrates them."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

import aleator as al
from aleator.design import functionals_of, responses
from aleator.transcription import transcribe
from compiling import compiled
from zoo import cases

STEPS = np.array([20, 40, 80])
RATE, START, END = 0.7, 2.0, 1.5


class Forced(al.System):
    """`x' = -rate x + cos(3 t)`."""

    states = ("x",)
    rate: al.Number
    start: al.Number = START

    def initial(self):
        return {"x": self.start}

    def rhs(self, t, z):
        return (-self.rate * z.x + jnp.cos(3 * t),)

    def outputs(self, t, z):
        return {"x": z.x, "far": z.x + 5.0}


class Wave(al.System):
    """Nothing is integrated: its output is known at each instant."""

    states = ()
    rate: al.Number

    def rhs(self, t, z, u):
        return ()

    def outputs(self, t, z, u):
        return {"x": self.rate * jnp.exp(jnp.sin(5 * u))}


def state(t):
    particular = (RATE * np.cos(3 * t) + 3 * np.sin(3 * t)) / (RATE**2 + 9)
    return particular + (START - RATE / (RATE**2 + 9)) * np.exp(-RATE * t)


def over(integrand):
    return integrate.quad(integrand, 0.0, END, epsabs=1e-13, epsrel=1e-13)[0]


WORK = al.objectives.power({"far": "x"}), over(lambda t: abs((state(t) + 5.0) * state(t)))
RMS = al.rms("x").mean, np.sqrt(over(lambda t: state(t) ** 2) / END)
EFFORT = al.objectives.effort("x"), over(lambda t: (RATE * np.exp(np.sin(5 * t))) ** 2)


def problem(functional, steps, system=Forced, **options):
    rate = al.Decision(RATE, 0.1, 2.0)
    return al.Problem(system(rate), grid=al.Grid(END, int(steps)), minimize=functional, **options)


def values(*declared, at=RATE):
    """The values of one functional each, by one program."""

    def all_of(x):
        return [responses(one, functionals_of(one.expressions), jnp.zeros((1, 0)), x)[0][0] for one in declared]

    return np.array([float(number) for number in compiled(all_of)(np.array([at]))])


@pytest.mark.parametrize(("functional", "exact"), cases([WORK, RMS]))
def test_integrals_converge_with_the_order_of_the_integrator(functional, exact):
    errors = np.abs(values(*(problem(functional, n) for n in STEPS)) - exact)
    assert np.polyfit(np.log(STEPS), np.log(errors), 1)[0] == pytest.approx(-4.0, abs=0.25)


def test_an_adaptive_integrator_holds_integrals_to_its_tolerance_on_a_coarse_grid():
    declared = problem(WORK[0], 2, integrator=al.integrators.Tsit5())
    np.testing.assert_allclose(values(declared), WORK[1], rtol=1e-7)


def test_integrals_of_what_is_not_integrated_converge_with_order_four():
    ramp = {"u": al.BSpline(np.array([0.0, END]), degree=1)}
    errors = np.abs(values(*(problem(EFFORT[0], n, Wave, inputs=ramp) for n in STEPS)) - EFFORT[1])
    assert np.polyfit(np.log(STEPS), np.log(errors), 1)[0] < -3.7


def test_time_integrals_of_spreads_are_as_accurate():
    """`∫ σ[x] dt` for a uniform start: the spread of `x` is that of the start times `exp(-rate t)`."""
    start = al.Uniform(START, half_width=0.4)
    declared = al.Problem(
        Forced(al.Decision(RATE, 0.1, 2.0), start),
        grid=al.Grid(END, 20),
        minimize=al.time_integral(al.path("x").std) + al.value("rate"),
        expansion=al.Expansion(order=1),
    )
    found = float(transcribe(declared).program.evaluate(np.array([RATE])).objective) - RATE
    assert found == pytest.approx(0.4 / np.sqrt(3) * (1 - np.exp(-RATE * END)) / RATE, abs=1e-7)
