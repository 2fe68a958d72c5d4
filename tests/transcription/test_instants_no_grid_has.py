"""What happens between the instants of a grid and of all its refinements is seen: ripples, pulses, shocks."""

import warnings
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.nlp import Status


class Rippled(al.System):
    """A level with a ripple or a pulse on it, which is known in closed form."""

    states = ("q",)
    level: Any
    depth: Any
    ripple: float = 0.0
    pulse: float = 0.0
    where: float = 0.3375
    best: float = 3.0

    def rhs(self, t, z):
        return (self.level - z.q,)

    def outputs(self, t, z):
        wave = jnp.sin(2 * jnp.pi * self.ripple * t)
        bump = jnp.where(self.pulse > 0, jnp.exp(-(((t - self.where) / (self.pulse + 1e-9)) ** 2)), 0.0)
        return {"i": self.level * (1.0 + self.depth * (wave + bump)), "loss": (self.level - self.best) ** 2}


def answer(limits=None, steps=100, sign=1.0, peak=False, **shape):
    system = Rippled(al.Decision(1.0, 0.1, 10.0), al.Uniform(0.5, half_width=0.05), **shape)
    functional = al.peak("i") if peak else al.path("i")
    limit = functional.at_most(1.5, sigmas=2.0) if sign > 0 else functional.at_least(1.0)
    problem = al.Problem(
        system,
        grid=al.Grid(1.0, steps),
        minimize=al.terminal("loss").mean,
        subject_to=[limit],
        expansion=al.Expansion(order=2),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return al.solve(problem, throw=False)


@pytest.mark.parametrize("frequency", [100.0, 200.0, 400.0])
def test_a_ripple_that_all_instants_share_breaks_the_limit(frequency):
    solution = answer(ripple=frequency)
    assert solution.status is Status.NOT_HELD
    # At the instants the level reaches the limit; at its peaks the middle system exceeds it by half.
    assert solution.decisions["level"] == pytest.approx(1.5, rel=1e-6)
    assert solution.certificate.between.worst == pytest.approx(0.5, abs=0.03)
    assert solution.certificate.between.time * frequency % 1 == pytest.approx(0.25, abs=0.1)
    assert "use more steps" in solution.why()


def test_a_trough_breaks_a_lower_limit_too():
    # Half of the level is left in the troughs.
    assert answer(ripple=100.0, sign=-1.0, best=3.0).ok
    solution = answer(ripple=100.0, sign=-1.0, best=1.2)
    assert solution.status is Status.NOT_HELD
    assert solution.certificate.between.worst == pytest.approx(0.4, abs=0.03)


@pytest.mark.parametrize("width", [2e-3, 5e-4])
@pytest.mark.parametrize("peak", [False, True])
def test_a_pulse_between_instants_breaks_the_limit_of_a_path_and_of_its_peak(width, peak):
    solution = answer(pulse=width, peak=peak)
    assert solution.status is Status.NOT_HELD
    if not peak:
        assert solution.certificate.between.time == pytest.approx(0.3375, abs=2 * width)


def test_more_steps_see_the_ripple_and_hold_the_limit():
    solution = answer(ripple=100.0, steps=4000)
    assert solution.ok
    # Mean and two standard deviations of the depth, at the peaks.
    assert solution.decisions["level"] == pytest.approx(1.5 / (1 + 0.5 + 2 * 0.05 / np.sqrt(3)), rel=1e-3)


class Shaken(al.System):
    """A mount that is hit by a half-sine of 11 ms."""

    states = ("x", "v")
    k: Any
    size: Any

    def rhs(self, t, z):
        s = (t - 2.003) / 0.011
        hit = jnp.where((s > 0) & (s < 1), self.size * jnp.sin(jnp.pi * s), 0.0)
        return z.v, -self.k * z.x - 2.0 * z.v - hit

    def outputs(self, t, z):
        return {"x": z.x, "a": -self.k * z.x - 2.0 * z.v}


@pytest.mark.parametrize("steps", [25, 50])
def test_a_shock_that_no_instant_meets_is_not_the_best_of_all_designs(steps):
    problem = al.Problem(
        Shaken(al.Decision(300.0, 50.0, 5000.0), al.Uniform(300.0, half_width=30.0)),
        grid=al.Grid(10.0, steps),
        minimize=al.rms("a").mean,
        subject_to=[al.path("x").within(-0.05, 0.05, sigmas=2.0)],
        expansion=al.Expansion(order=2),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = al.solve(problem, throw=False)
    assert not solution.ok
    assert solution.status in (Status.NOT_HELD, Status.COARSE)
