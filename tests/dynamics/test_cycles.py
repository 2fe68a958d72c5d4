"""Motions that repeat, by events and by forces, against published numbers and closed forms."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.dynamics import Asked, simulation_of
from zoo import optimum

# For mu = 1.
PERIOD = 6.6632868593231301896996820305


class VanDerPol(al.System):
    """A section through its crest, an event without a jump, ends its cycle."""

    states = ("x", "v")
    mu: al.Number = 1.0
    guess: al.Number = 2.0
    events: ClassVar = {"crest": al.Event(lambda self, t, z: z.v, direction=-1)}

    def rhs(self, t, z):
        return z.v, self.mu * (1 - z.x**2) * z.v - z.x

    def initial(self):
        return {"x": self.guess}

    def outputs(self, t, z):
        return {"x": z.x, "v": z.v}


CREST = al.Grid(until="crest", at_most=10.0, steps=400, periodic=True)


def test_the_period_of_van_der_pol_is_the_published_one():
    history = al.simulate(VanDerPol(), CREST)
    x, times = np.asarray(history["x"]), np.asarray(history["time"])
    assert abs(x[-1] - x[0]) < 1e-13
    assert abs(times[-1] - PERIOD) < 1e-7


@pytest.mark.slow
def test_the_derivative_of_a_period_is_that_of_central_differences():
    def period(mu):
        return al.simulate(VanDerPol(mu), coarse, only=["x"])["time"][-1]

    coarse = al.Grid(until="crest", at_most=10.0, steps=100, periodic=True)
    found = jax.jit(jax.vmap(lambda mu: (period(mu), jax.jacfwd(period)(mu))))(np.array([0.999, 1.0, 1.001]))
    values, slopes = map(np.asarray, found)
    assert slopes[1] == pytest.approx((values[2] - values[0]) / 2e-3, rel=1e-5)


@pytest.mark.slow
def test_a_cycle_that_does_not_close_is_named_with_its_numbers():
    with pytest.warns(al.SimulationWarning, match=r"mu=-1.*does not close its cycle.*after 'crest'"):
        al.simulate(VanDerPol(-1.0, 9.0), CREST)


@pytest.mark.slow
def test_cycles_of_a_conserved_energy_are_told_as_a_family():
    with pytest.warns(al.SimulationWarning, match=r"mu=0.*no single cycle: .*begin just behind 'crest'"):
        al.simulate(VanDerPol(0.0), CREST)


class Forced(al.System):
    """`x'' + c x' + k x = cos t`, whose period is known."""

    states = ("x", "v")
    c: al.Number = 0.1

    def rhs(self, t, z):
        return z.v, jnp.cos(t) - self.c * z.v - 2 * z.x

    def outputs(self, t, z):
        return {"x": z.x}


def test_a_grid_that_is_no_period_of_the_force_does_not_repeat():
    with pytest.warns(al.SimulationWarning, match="a time that does not come again"):
        al.simulate(Forced(0.3), al.Grid(3.5, 20, periodic=True))


class Dosed(al.System):
    """It decays, and gets a dose of one each second; a clock tells when."""

    states = ("x", "clock")
    rate: al.Number = 1.0
    events: ClassVar = {
        "dose": al.Event(
            lambda self, t, z: z.clock - 1.0, direction=1, jump=lambda self, t, z: {"x": z.x + 1.0, "clock": 0.0 * z.x}
        )
    }

    def rhs(self, t, z):
        return -self.rate * z.x, 1.0

    def initial(self):
        return {"x": 1.5}

    def outputs(self, t, z):
        return {"x": z.x}


def test_a_cycle_with_a_jump_has_the_start_and_the_multiplier_of_its_closed_form_in_each_realisation():
    # x = exp(-rate) x + 1, and the clock forgets where it began.
    grid, rates = al.Grid(until="dose", at_most=2.0, steps=40, periodic=True), np.array([0.5, 1.0, 2.0])

    def one(rate):
        record = simulation_of(Dosed(rate), grid, None, None).record(Asked(frozenset({"x"}), multipliers=True))
        return record.grid.t_final, record.history["x"][0], record.monodromy

    periods, starts, monodromies = map(np.asarray, jax.jit(jax.vmap(one))(rates))
    np.testing.assert_allclose(periods, 1.0, rtol=1e-10)
    np.testing.assert_allclose(starts, 1 / (1 - np.exp(-rates)), rtol=1e-6)
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(monodromies)).max(axis=1), np.exp(-rates), rtol=1e-6)


WAY = al.Simultaneous(al.schemes.Radau(4))


def test_a_collocated_cycle_has_the_published_period():
    grid = al.Grid(until="crest", at_most=10.0, steps=40, periodic=True)
    longest = {"minimize": al.value("mu"), "subject_to": [al.at("crest").mean >= PERIOD]}
    found = optimum(al.Problem(VanDerPol(al.Decision(1.2, 0.5, 2.0)), grid=grid, **longest), transcription=WAY)
    assert found.decisions["mu"] == pytest.approx(1.0, abs=1e-6)


def test_what_has_no_meaning_with_cycles_is_refused_where_it_is_declared():
    with pytest.raises(al.ProblemError, match=r"al.floquet_multiplier\(\) is that of a cycle.*periodic=True"):
        al.Problem(VanDerPol(mu=al.Decision(1.0)), grid=al.Grid(1.0, 4), minimize=al.floquet_multiplier().mean)
    with pytest.raises(al.ProblemError, match=r"Phase: .*does not repeat"):
        al.Phase(Forced(), al.Grid(1.0, 4, periodic=True))
    problem = al.Problem(VanDerPol(mu=al.Decision(1.0)), grid=CREST, minimize=al.floquet_multiplier().mean)
    with pytest.raises(al.ProblemError, match=r"that of a simulation around the cycle: use al.Sequential"):
        al.solve(problem, transcription=al.Simultaneous())
