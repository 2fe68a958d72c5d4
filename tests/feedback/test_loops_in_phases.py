"""Closed loops that go on through phases, against one phase, and against SciPy."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import aleator as al
from zoo import histories, optimum


class Cart(al.System):
    """A cart with an uncertain mass, which is pushed from place to place."""

    states = ("x", "v")
    m: al.Number
    drag: al.Number = 0.5
    events: ClassVar = {"gate": al.Event(lambda self, t, z: z.x - 0.4, direction=1)}

    def initial(self):
        return {"v": 1.0}

    def rhs(self, t, z, u):
        return z.v, (u - self.drag * z.v * jnp.abs(z.v)) / self.m

    def outputs(self, t, z, u):
        return {"x": z.x, "v": z.v}


MASS = al.Uniform(1.0, half_width=0.2)


def feedback(gains: Any = (8.0, 3.0), **options: Any) -> al.Feedback:
    return al.Feedback(gains=list(gains), of=("x", "v"), **options)


def push(value):
    return {"u": al.StepFunction([9.0], [value, 0.0])}


def by_scipy(m, gains, begun, pushed, end, place=None):
    """The time and the states at the end, of a cart and of its plan, up to where one of them passes a place."""

    def rates(t, z):
        u = pushed + gains @ (z[2:] - z[:2])
        return [z[1], (u - 0.5 * z[1] * abs(z[1])) / m, z[3], pushed - 0.5 * z[3] * abs(z[3])]

    events: Any = [lambda t, z: z[0] - 0.4, lambda t, z: z[2] - 0.4]
    for event in events:
        event.terminal = True
    events = [] if place is None else events[place : place + 1]
    ran = scipy.integrate.solve_ivp(rates, (0, end), begun, "DOP853", events=events, rtol=1e-11, atol=1e-12)
    return ran.t[-1], ran.y[:, -1]


def test_where_an_event_ends_a_phase_the_plan_begins_the_next_from_its_own():
    cart, first, second = Cart(MASS), (2.0, 1.0), np.array([8.0, 3.0])
    phases = al.Phases(
        free=al.Phase(cart, al.Grid(until="gate", at_most=2.0, steps=80), push(0.2), feedback=feedback(first)),
        led=al.Phase(
            cart,
            al.Grid(0.8, 80),
            push(0.7),
            feedback=feedback(second),
            subject_to=[al.terminal("x").mean >= al.at("gate_plan", phase="free").mean],
        ),
        coast=al.Phase(cart, al.Grid(0.1, 10), push(0.3)),
        link={"led": lambda self, t, z: {"v": 0.9 * z.v + 0.1 * t}},
    )
    problem = al.Problem(phases, minimize=al.terminal("v").mean)
    found = histories(problem, [[-0.8], [0.0]])
    begun = [0.0, 1.0, 0.0, 1.0]
    for k, m in enumerate((0.84, 1.0)):
        (t, own), (t_plan, plan) = (by_scipy(m, np.array(first), begun, 0.2, 2.0, place) for place in (0, 1))
        assert found["free.x"][k, -1] == pytest.approx(0.4, rel=1e-9)
        states = [own[0], 0.9 * own[1] + 0.1 * t, plan[2], 0.9 * plan[3] + 0.1 * t_plan]
        _, end = by_scipy(m, second, states, 0.7, 0.8)
        assert [found[f"led.{name}"][k, -1] for name in ("x", "v")] == pytest.approx(end[:2], rel=1e-8)
        assert float(found["led.x.error"][k, -1]) == pytest.approx(end[2] - end[0], abs=1e-9)
        # A phase without feedback has a plan, but is not led.
        _, end = by_scipy(m, np.zeros(2), end, 0.3, 0.1)
        assert float(found["coast.v"][k, -1]) == pytest.approx(end[1], rel=1e-8)


class Lag(al.System):
    states = ("x",)
    a: al.Number

    def initial(self):
        return {"x": 1.0}

    def rhs(self, t, z, u):
        return (u - self.a * z.x,)

    def outputs(self, t, z):
        return {"x": z.x}


def test_collocation_begins_a_phase_with_the_end_of_the_plan_before_it():
    lag, inputs = Lag(al.Uniform(1.0, half_width=0.3)), {"u": al.Tabulated([0.0, 1.0], [2.0, 2.0])}
    loop = al.Feedback(gains=[al.Decision(3.0, 0.0, 10.0)])
    phases = al.Phases(
        free=al.Phase(lag, al.Grid(1.0, 10), inputs), led=al.Phase(lag, al.Grid(0.5, 10), inputs, feedback=loop)
    )
    least = {"minimize": al.value("feedback.led.gains.0"), "subject_to": [al.terminal("x").std <= 0.05]}
    (k,) = optimum(al.Problem(phases, **least), transcription=al.Simultaneous()).decisions.values()
    nodes, weights = np.polynomial.legendre.leggauss(8)
    # The plan is 2 - exp(-t); in the led phase a state is a sum of a constant and two exponentials.
    a = 1.0 + 0.3 * nodes
    begun, steady, forced = 2 / a + (1 - 2 / a) * np.exp(-a), 2 * (1 + k) / (a + k), -np.exp(-1) * k / (a + k - 1)
    x = (begun - steady - forced) * np.exp(-(a + k) * 0.5) + steady + forced * np.exp(-0.5)
    assert np.sqrt(weights @ (x - weights @ x / 2) ** 2 / 2) == pytest.approx(0.05, rel=1e-5)


def test_collocation_refuses_what_a_plan_does_at_times_of_its_own():
    cart, loop, regulator = Cart(MASS), feedback(), al.Feedback(gains=al.lqr([1.0, al.Decision(0.5, 0.1, 1.0)], [0.2]))
    for grid, later in ((al.Grid(until="gate", at_most=2.0, steps=4), loop), (al.Grid(0.4, 4), regulator)):
        led = al.Phase(cart, al.Grid(0.4, 4), push(0.1), feedback=later)
        phases = al.Phases(free=al.Phase(cart, grid, push(0.1), feedback=loop), led=led)
        problem = al.Problem(phases, minimize=al.terminal("v").std)
        with pytest.raises(al.ProblemError, match="'led' begins after an event that the plan has at another time"):
            al.Simultaneous().count(problem)


def test_what_has_no_plan_is_refused():
    cart, loop = Cart(MASS), feedback()
    phases = al.Phases(only=al.Phase(cart, al.Grid(1.0, 10), push(0.1), feedback=loop))
    with pytest.raises(al.ProblemError, match=r"simulate: phases with feedback.*al.Problem"):
        al.simulate(phases)
    grid = al.Grid(until="gate", at_most=1.0, steps=10, periodic=True)
    with pytest.raises(al.ProblemError, match=r"a plan that repeats has .* a period of its own"):
        al.Problem(cart, grid=grid, inputs=push(0.1), feedback=loop, minimize=al.terminal("v").mean)
    with pytest.raises(al.ProblemError, match="Give each phase its own"):
        al.Problem(phases, feedback=loop, minimize=al.terminal("v").mean)


class Bouncing(Cart):
    events: ClassVar = {"wall": al.Event(lambda self, t, z: z.x - 0.4, jump=lambda self, t, z: {"v": -z.v})}


def test_a_jump_within_a_loop_is_refused_with_the_phase_that_it_may_end():
    with pytest.raises(al.ProblemError, match=r"'wall' .*end a phase, al.Phase\(system, al.Grid\(until='wall'"):
        al.Problem(
            Bouncing(MASS), grid=al.Grid(1.0, 10), inputs=push(0.1), feedback=feedback(), minimize=al.terminal("v").std
        )
