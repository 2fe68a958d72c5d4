"""Events by integrators whose steps follow their error: closed forms, and what has no simulation."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from bouncing import ADAPTIVE, LANDED, Ball, Grazing, Parts, Rooted, Stopped, agreeing, refused
from compiling import compiled
from zoo import G, Shot, cases


class Dragged(Ball):
    """A ball in a fluid, whose weight is a variable of an equation: `w = g + 0.3 v`, solved as `w + w^3 = ...`."""

    algebraic = ("w",)

    def rhs(self, t, z):
        return z.v, -z.w

    def residual(self, t, z):
        right = G + 0.3 * z.v
        return (z.w + z.w**3 - right - right**3,)

    def algebraic_guess(self, t, z):
        return {"w": G}


def dragged(e, t):
    """The height after one bounce, between the first one and the second one."""

    def fall(t, h, v):
        """Height and speed: `v' = -g - 0.3 v`."""
        c = v + G / 0.3
        return h - G / 0.3 * t + c * (1 - jnp.exp(-0.3 * t)) / 0.3, c * jnp.exp(-0.3 * t) - G / 0.3

    first = jnp.asarray(0.45)
    for _ in range(6):
        height, speed = fall(first, 1.0, 0.0)
        first = first - height / speed
    return fall(t - first, 0.0, -e * fall(first, 1.0, 0.0)[1])[0]


@pytest.mark.slow
def test_adaptive_steps_end_at_events_with_derivatives_and_algebraic_variables():
    grid, integrator = al.Grid(0.9, 2), ADAPTIVE[1]

    def simulated(e):
        return al.simulate(Dragged(e), grid, integrator=integrator, only=["h"])["h"][-1]

    (height, right), slopes = agreeing(simulated, lambda e: dragged(e, 0.9), 0.7, 1)
    assert height == pytest.approx(right, abs=1e-9)
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-7)


@pytest.mark.parametrize("integrator", cases(ADAPTIVE), ids=lambda one: type(one).__name__)
def test_an_adaptive_integrator_ends_at_an_event_with_the_derivatives_of_the_closed_form(integrator):
    def simulated(angle):
        return al.simulate(Shot(20.0, angle), al.Grid(until="ground", at_most=4.0, steps=4), integrator=integrator)

    def ends(angle):
        history = simulated(angle)
        return history["time"][-1], history["x"][-1]

    (time, place), (_, slope) = compiled(lambda angle: (ends(angle), jax.jacfwd(ends)(angle)))(0.7)
    assert (time, place) == pytest.approx((40 * np.sin(0.7) / G, 400 * np.sin(1.4) / G), rel=1e-10)
    assert float(slope) == pytest.approx(800 * np.cos(1.4) / G, rel=1e-8)
    with pytest.warns(al.SimulationWarning, match=r"angle=0.7.*never meets 'ground'"):
        al.simulate(Shot(20.0, 0.7), al.Grid(until="ground", at_most=1.0, steps=4), integrator=integrator)


class Clock(al.System):
    """A clock that counts at certain times and then goes on at another one, beyond what it would count there."""

    states = ("t", "count")
    events: ClassVar = {
        "leap": al.Event(lambda self, t, z: z.t - 0.5, jump=lambda self, t, z: {"t": z.t + 1.0}),
        "passed": al.Event(lambda self, t, z: z.t - 1.0, jump=lambda self, t, z: {"count": z.count + 1.0}),
        "met": al.Event(lambda self, t, z: z.t - 1.8, jump=lambda self, t, z: {"count": z.count + 10.0}),
    }

    def rhs(self, t, z):
        return 1.0, 0.0

    def outputs(self, t, z):
        return {"t": z.t, "count": z.count}


def test_an_event_at_an_instant_leaves_no_time_to_step_over_and_a_jump_over_another_event_is_none():
    history = al.simulate(Clock(), al.Grid(1.0, 10), integrator=ADAPTIVE[0])
    assert (history["t"][-1], history["count"][-1]) == (pytest.approx(2.0, abs=1e-12), 10.0)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ADAPTIVE, ids=lambda one: type(one).__name__)
def test_adaptive_steps_say_the_same_of_what_has_no_simulation(integrator):
    refused(Ball(0.5), al.Grid(3.0, 12), "meets 'floor' again and again", "e=0.5", "t = 1.3", integrator=integrator)
    refused(Shot(angle=-0.7), LANDED, "starts at 'ground'", "angle=-0.7", integrator=integrator)
    refused(Stopped(), al.Grid(1.0, 10), "stays at 'floor'", "t = 0.4515 s", integrator=integrator)
    refused(Parts(), al.Grid(1.0, 10), "'floor' and 'wall' at the same time", "t = 0.4515 s", integrator=integrator)
    refused(Rooted(-1.0), al.Grid(1.0, 10), "sets 'v' to what is not", "t = 0.4515 s", integrator=integrator)
    refused(Grazing(), al.Grid(until="ceiling", at_most=2.0, steps=9), "'ceiling'", integrator=integrator)
