"""Motions that repeat: limit cycles and gaits against published numbers and SciPy's own events."""

from functools import cache
from itertools import pairwise
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import aleator as al
from aleator.dynamics import Asked, simulation_of
from zoo import cases, optimum

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
        return {"x": z.x, "v": z.v, "divergence": self.mu * (1 - z.x**2)}


CREST = al.Grid(until="crest", at_most=10.0, steps=400, periodic=True)


def test_the_period_of_van_der_pol_is_the_published_one_with_the_order_of_the_integrator():
    errors = []
    for steps in (200, 400):
        history = al.simulate(VanDerPol(), al.Grid(until="crest", at_most=10.0, steps=steps, periodic=True))
        x, times = np.asarray(history["x"]), np.asarray(history["time"])
        assert abs(x[-1] - x[0]) < 1e-13
        errors.append(abs(times[-1] - PERIOD))
    assert errors[1] < 1e-7
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.1)


class Sawtooth(al.System):
    """It begins just behind its reset."""

    states = ("x",)
    rate: al.Number = 1.0
    events: ClassVar = {
        "top": al.Event(lambda self, t, z: z.x - 1.0, direction=1, jump=lambda self, t, z: {"x": 0.0 * z.x})
    }

    def rhs(self, t, z):
        return (self.rate,)

    def outputs(self, t, z):
        return {"x": z.x}


def test_a_generous_latest_time_makes_no_two_cycles_of_one():
    def period(model, event, at_most, steps):
        grid = al.Grid(until=event, at_most=at_most, steps=steps, periodic=True)
        return float(al.simulate(model, grid, only=["x"])["time"][-1])

    assert period(VanDerPol(), "crest", 150.0, 3000) == pytest.approx(PERIOD, abs=1e-6)
    assert period(Sawtooth(), "top", 30.0, 300) == pytest.approx(1.0, abs=1e-9)


class Late(VanDerPol):
    """It begins right before or behind its crest."""

    speed: al.Number = 0.0

    def initial(self):
        return {"x": 2.0, "v": self.speed}


def test_a_crossing_right_behind_the_start_ends_no_cycle():
    for speed in (0.05, -0.05):
        assert float(al.simulate(Late(speed=speed), CREST, only=["x"])["time"][-1]) == pytest.approx(PERIOD, abs=1e-6)


@pytest.mark.parametrize("order", cases([1, 2]))
def test_derivatives_of_a_period_are_those_of_central_differences_to_second_order(order):
    def period(mu):
        return al.simulate(VanDerPol(mu), coarse, only=["x"])["time"][-1]

    coarse = al.Grid(until="crest", at_most=10.0, steps=100, periodic=True)
    every = [period]
    for _ in range(order):
        every.append(jax.jacfwd(every[-1]))
    found = jax.jit(jax.vmap(lambda mu: [one(mu) for one in every]))(np.array([0.999, 1.0, 1.001]))
    for values, slopes in pairwise(map(np.asarray, found)):
        assert slopes[1] == pytest.approx((values[2] - values[0]) / 2e-3, rel=1e-5)


def test_the_multiplier_of_a_cycle_is_the_exponential_of_its_divergence():
    # Liouville: the multipliers' product is exp(∫ div dt), and that along the cycle, 1, does not count.
    asked = Asked(
        frozenset(),
        integrands=(lambda now: now["divergence"],),
        integrated=(frozenset({"divergence"}),),
        multipliers=True,
    )
    grid = al.Grid(until="crest", at_most=10.0, steps=1600, periodic=True)
    record = jax.jit(lambda mu: simulation_of(VanDerPol(mu), grid, None, None).record(asked)._replace(grid=None))(1.0)
    multipliers = sorted(np.abs(np.linalg.eigvals(record.monodromy)))
    assert multipliers == pytest.approx([0.0, np.exp(float(record.integrals[0]))], rel=1e-7, abs=1e-9)


def test_a_cycle_that_does_not_close_is_named_with_its_numbers():
    with pytest.warns(al.SimulationWarning, match=r"mu=-1.*does not close its cycle.*after 'crest'"):
        al.simulate(VanDerPol(-1.0, 9.0), CREST)


def test_cycles_of_a_conserved_energy_are_told_as_a_family_with_what_finds_their_period():
    with pytest.warns(al.SimulationWarning, match=r"mu=0.*no single cycle: .*begin just behind 'crest'"):
        al.simulate(VanDerPol(0.0), CREST)
    followed = al.Grid(until="crest", at_most=10.0, steps=400)
    assert float(al.simulate(Late(0.0, speed=-1e-6), followed)["time"][-1]) == pytest.approx(2 * np.pi, abs=1e-5)


@pytest.mark.slow
def test_a_cycle_without_a_force_on_a_grid_of_known_length_has_those_shifted_in_time_beside_it():
    with pytest.warns(al.SimulationWarning, match=r"no single cycle: .*event end the grid if they are shifts in time"):
        al.simulate(VanDerPol(), al.Grid(PERIOD, 400, periodic=True))


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


def test_a_forced_vibration_repeats_with_the_period_of_its_force():
    # Its complex amplitude is 1 / (k - 1 + i c).
    found = al.expand(
        lambda at: al.simulate(Forced(at["c"]), al.Grid(2 * np.pi, 200, periodic=True))["x"][0],
        {"c": al.Uniform(0.2, half_width=0.1)},
        al.Expansion(order=5),
    )
    nodes, weights = np.polynomial.legendre.leggauss(12)
    values = 1 / (1 + (0.2 + 0.1 * nodes) ** 2)
    assert float(found.mean) == pytest.approx(weights @ values / 2, rel=1e-7)


SLOPE = float(np.radians(3.0))


class Walker(al.System):
    """The compass gait of Goswami, Thuilot and Espiau (IJRR 17, 1998): angles of both legs from the vertical."""

    states = ("swing", "stance", "swing_rate", "stance_rate")
    hip: al.Number = 10.0
    m: al.Number = 5.0
    slope: al.Number = SLOPE
    events: ClassVar = {
        "strike": al.Event(
            lambda self, t, z: z.swing + z.stance + 2 * self.slope,
            direction=-1,
            jump=lambda self, t, z: self.after_strike(*z),
        )
    }

    def rhs(self, t, z):
        return walking(self.hip, self.m, z)

    def after_strike(self, swing, stance, swing_rate, stance_rate):
        rates = struck(self.hip, self.m, swing - stance, swing_rate, stance_rate)
        return {"swing": stance, "stance": swing, "swing_rate": rates[0], "stance_rate": rates[1]}

    def initial(self):
        return {"swing": -0.3234, "stance": 0.2187, "swing_rate": -0.377, "stance_rate": -1.092}

    def outputs(self, t, z):
        return {"stance_rate": z.stance_rate}


def solved(a, b, c, d, p, q):
    """The solution of `a x + b y = p, c x + d y = q`."""
    return (d * p - b * q) / (a * d - b * c), (a * q - c * p) / (a * d - b * c)


def walking(hip, m, z, a=0.5, b=0.5):
    swing, stance, swing_rate, stance_rate = z
    c, s, l = jnp.cos(stance - swing), jnp.sin(stance - swing), a + b  # noqa: E741
    first = -m * l * b * s * stance_rate**2 - 9.81 * m * b * jnp.sin(swing)
    second = m * l * b * s * swing_rate**2 + 9.81 * (hip * l + m * (a + l)) * jnp.sin(stance)
    coupling = -m * l * b * c
    return swing_rate, stance_rate, *solved(m * b**2, coupling, coupling, (hip + m) * l**2 + m * a**2, first, second)


def struck(hip, m, apart, swing_rate, stance_rate, a=0.5, b=0.5):
    """The rates after the swing leg has struck: angular momenta about it, and about the hip, are kept."""
    c, l = jnp.cos(apart), a + b  # noqa: E741
    about_foot = -m * a * b * swing_rate + ((hip * l**2 + 2 * m * a * l) * c - m * a * b) * stance_rate
    about_hip = -m * a * b * stance_rate
    one, two = m * b * (b - l * c), m * l * (l - b * c) + m * a**2 + hip * l**2
    return solved(one, two, m * b**2, -m * b * l * c, about_foot, about_hip)


@cache
def gait():
    """Periods, initial rates and largest multipliers of walkers with 50 masses of the hip."""
    grid = al.Grid(until="strike", at_most=1.5, steps=80, periodic=True)

    def one(hip):
        record = simulation_of(Walker(hip), grid, None, None).record(
            Asked(frozenset({"stance_rate"}), multipliers=True)
        )
        return record.grid.t_final, record.history["stance_rate"][0], record.monodromy

    hips = np.linspace(8.5, 11.5, 50)
    return hips, *map(np.asarray, jax.jit(jax.vmap(one))(hips))


RATES = jax.jit(lambda hip, z: jnp.stack(walking(hip, 5.0, z)))
AFTER = jax.jit(lambda hip, apart, swing_rate, stance_rate: struck(hip, 5.0, apart, swing_rate, stance_rate))


def by_scipy(hip, slope=SLOPE):
    """The same by SciPy: the period, the first rate of the stance leg, and the derivatives of a step by differences."""
    strike: Any = lambda t, z: z[0] + z[1] + 2 * slope if t > 0.4 else 1.0  # noqa: E731
    strike.terminal, strike.direction = True, -1

    def step(z):
        ran = scipy.integrate.solve_ivp(
            lambda t, z: np.asarray(RATES(hip, z)), (0, 2), z, "DOP853", events=strike, rtol=1e-11, atol=1e-12
        )
        swing, stance, *before = ran.y[:, -1]
        return np.array([stance, swing, *map(float, AFTER(hip, swing - stance, *before))]), ran.t[-1]

    z = scipy.optimize.fsolve(lambda z: step(z)[0] - z, [-0.3234, 0.2187, -0.377, -1.092], xtol=1e-9)
    slopes = [(step(z + d)[0] - step(z - d)[0]) / 2e-6 for d in 1e-6 * np.eye(4)]
    return step(z)[1], z[3], np.abs(np.linalg.eigvals(np.transpose(slopes))).max()


@pytest.mark.slow
def test_a_compass_walker_repeats_its_step_in_each_of_fifty_realisations():
    hips, periods, rates, monodromies = gait()
    assert np.interp(10.0, hips, periods) == pytest.approx(0.734, abs=5e-4)
    for k in (0, 49):
        right = by_scipy(hips[k])
        assert (periods[k], rates[k]) == pytest.approx(right[:2], rel=1e-6)
        assert np.abs(np.linalg.eigvals(monodromies[k])).max() == pytest.approx(right[2], rel=1e-4)


WAY = al.Simultaneous(al.schemes.Radau(4))


def test_a_collocated_cycle_has_the_published_period():
    grid = al.Grid(until="crest", at_most=10.0, steps=40, periodic=True)
    longest = {"minimize": al.value("mu"), "subject_to": [al.at("crest").mean >= PERIOD]}
    found = optimum(al.Problem(VanDerPol(al.Decision(1.2, 0.5, 2.0)), grid=grid, **longest), transcription=WAY)
    assert found.decisions["mu"] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow
def test_a_collocated_cycle_of_a_force_has_the_exact_amplitude():
    grid = al.Grid(2 * np.pi, 20, periodic=True)
    limits = {"minimize": al.value("c"), "subject_to": [al.initial("x").mean <= 0.9]}
    found = optimum(al.Problem(Forced(al.Decision(0.1, 0.05, 0.9)), grid=grid, **limits), transcription=WAY)
    # The real part of its complex amplitude is 1 / (1 + c²).
    assert found.decisions["c"] == pytest.approx(1 / 3, rel=1e-7)


@pytest.mark.slow
def test_the_gentlest_slope_on_which_a_walker_is_stable_by_a_margin_is_that_of_scipy():
    # Down a gentler slope it needs less energy for its way, and forgets a disturbance more slowly.
    slope = al.Decision(*np.radians([3.0, 2.0, 4.0]))
    problem = al.Problem(
        Walker(hip=al.Uniform(10.0, half_width=1.0), slope=slope),
        grid=al.Grid(until="strike", at_most=1.5, steps=80, periodic=True),
        minimize=al.value("slope"),
        subject_to=[al.floquet_multiplier().at_most(0.585, sigmas=2)],
    )
    solution = al.solve(problem)
    assert solution.ok, solution
    nodes, weights = np.polynomial.legendre.leggauss(3)

    def margin(slope):
        largest = np.array([by_scipy(10.0 + node, slope)[2] for node in nodes])
        mean = weights @ largest / 2
        return mean + 2 * np.sqrt(weights @ (largest - mean) ** 2 / 2) - 0.585

    # The derivatives by differences have errors of about 1e-5.
    assert margin(solution.decisions["slope"]) == pytest.approx(0.0, abs=1e-4)
    assert margin(solution.decisions["slope"] - 2e-3) > 1e-3


def test_what_has_no_meaning_with_cycles_is_refused_where_it_is_declared():
    with pytest.raises(al.ProblemError, match=r"al.floquet_multiplier\(\) is that of a cycle.*periodic=True"):
        al.Problem(VanDerPol(mu=al.Decision(1.0)), grid=al.Grid(1.0, 4), minimize=al.floquet_multiplier().mean)
    with pytest.raises(al.ProblemError, match="Grid: periodic: expected True or False"):
        al.Grid(1.0, 4, periodic=1)  # pyright: ignore[reportArgumentType]
    with pytest.raises(al.ProblemError, match=r"Phase: .*does not repeat"):
        al.Phase(Forced(), al.Grid(1.0, 4, periodic=True))
    problem = al.Problem(VanDerPol(mu=al.Decision(1.0)), grid=CREST, minimize=al.floquet_multiplier().mean)
    with pytest.raises(al.ProblemError, match=r"that of a simulation around the cycle: use al.Sequential"):
        al.solve(problem, transcription=al.Simultaneous())
