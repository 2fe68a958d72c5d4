"""Events: jumps of states, and grids that end by one, against closed forms and SciPy's own events."""

import typing
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import aleator as al
from aleator.dynamics import Asked
from aleator.uncertainty import realise
from bouncing import (
    ADAPTIVE,
    LANDED,
    Ball,
    Grazing,
    Parts,
    Rooted,
    Stopped,
    agreeing,
    refused,
    second_flight,
)
from compiling import compiled
from zoo import G, Shot, cases

FIXED = [al.integrators.RungeKutta4(), al.integrators.RungeKutta4().reference()]


def landing(speed, angle, height, library=np):
    """When and where a body without drag lands."""
    up = speed * library.sin(angle)
    t = (up + library.sqrt(up**2 + 2 * G * height)) / G
    return library.stack([t, speed * library.cos(angle) * t])


@pytest.mark.parametrize(
    "integrator", cases([FIXED[0], ADAPTIVE[1], FIXED[1], ADAPTIVE[0]], 2), ids=lambda one: type(one).__name__
)
def test_a_ball_bounces_wherever_in_a_step_and_twice_in_one(integrator):
    history = al.simulate(Ball(), al.Grid(1.2, 2), integrator=integrator)
    assert np.asarray(history["h"])[-1] == pytest.approx(second_flight(0.7, 1.0, 1.2), abs=1e-13)


@pytest.mark.parametrize("order", cases([2, 3]))
def test_derivatives_after_jumps_are_those_of_the_closed_form_to_third_order(order):
    def simulated(at):
        return al.simulate(Ball(at[0], at[1]), al.Grid(1.2, 12), only=["h"])["h"][-1]

    def exact(at):
        return second_flight(at[0], at[1], 1.2, jnp.sqrt)

    for ours, right in agreeing(simulated, exact, [0.7, 1.0], order):
        assert ours == pytest.approx(right, rel=1e-9)


def test_the_end_of_a_grid_and_its_derivatives_are_those_of_the_closed_form():
    def simulated(at):
        history = al.simulate(Shot(at[0], at[1], at[2]), LANDED)
        return jnp.stack([history["time"][-1], history["x"][-1]])

    for ours, right in agreeing(simulated, lambda at: landing(*at, library=jnp), [20.0, 0.7, 1.0], 2):
        assert ours == pytest.approx(right, rel=1e-9, abs=1e-10)


def test_a_body_lands_on_the_ground_to_rounding_with_the_order_of_the_integrator():
    c, start = 0.02, [0.0, 1.0, 20 * np.cos(0.7), 20 * np.sin(0.7)]

    def rates(t, z):
        drag = c * np.hypot(z[2], z[3])
        return [z[2], z[3], -drag * z[2], -G - drag * z[3]]

    ground: Any = lambda t, z: z[1]  # noqa: E731
    ground.terminal, ground.direction = True, -1
    right = scipy.integrate.solve_ivp(rates, (0, 10), start, "DOP853", events=ground, rtol=1e-12, atol=1e-13).y[0, -1]
    errors = []
    for steps in (20, 40):
        history = al.simulate(Shot(20.0, 0.7, 1.0, c), al.Grid(until="ground", at_most=10.0, steps=steps))
        x, y = (np.asarray(history[name])[-1] for name in "xy")
        assert abs(y) < 1e-13
        errors.append(abs(x - right))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.1)


def test_what_is_told_at_an_instant_of_an_own_time_happened_then_however_late_the_grid_may_end():
    def rates(t, z):
        drag = 0.02 * np.hypot(z[2], z[3])
        return [z[2], z[3], -drag * z[2], -G - drag * z[3]]

    start = [0.0, 1.0, 20 * np.cos(0.7), 20 * np.sin(0.7)]
    right = scipy.integrate.solve_ivp(rates, (0, 3), start, "DOP853", rtol=1e-12, atol=1e-13, dense_output=True).sol
    errors = []
    for steps in (40, 80):
        history = al.simulate(Shot(20.0, 0.7, 1.0, 0.02), al.Grid(until="ground", at_most=30.0, steps=steps))
        errors.append(np.max(np.abs(np.asarray(history["x"]) - right(np.asarray(history["time"]))[0])))
    assert errors[0] < 1e-6
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)


def test_the_probability_to_land_beyond_a_distance_is_that_of_the_speed_that_reaches_it():
    def slowest(angle, height):
        return np.sqrt(G * 41.0**2 / 2 / (height + 41.0 * np.tan(angle))) / np.cos(angle)

    numbers = {"speed": al.Normal(20.0, std=0.3), "angle": al.Uniform(0.7, half_width=0.05)}
    numbers["height"] = al.Uniform(1.0, half_width=0.5)
    found = al.expand(lambda at: al.simulate(Shot(**at), LANDED)["x"][-1], numbers, al.Expansion(order=6))
    nodes, weights = np.polynomial.legendre.leggauss(16)
    at = np.meshgrid(0.7 + 0.05 * nodes, 1.0 + 0.5 * nodes, indexing="ij")
    right = weights @ scipy.special.ndtr((20.0 - slowest(*at)) / 0.3) @ weights / 4
    assert float(found.probability(above=41.0)) == pytest.approx(right, abs=1e-8)


@pytest.mark.parametrize("integrator", cases([None, *ADAPTIVE]), ids=lambda one: type(one).__name__)
def test_an_uncertain_restitution_spreads_the_height_as_the_closed_form_says(integrator):
    found = al.expand(
        lambda at: al.simulate(Ball(at["e"]), al.Grid(1.2, 12), integrator=integrator)["h"][-1],
        {"e": al.Uniform(0.7, half_width=0.1)},
        al.Expansion(order=4),
    )
    assert float(found.mean) == pytest.approx(0.1558396995, abs=1e-10)
    assert float(found.std) == pytest.approx(0.0302186563, abs=1e-10)


class Pushed(al.System):
    """`x'' = force`, until `x` is 0.5."""

    states = ("x", "v")
    events: ClassVar = {"there": al.Event(lambda self, t, z: z.x - 0.5)}

    def rhs(self, t, z, force):
        return z.v, force

    def outputs(self, t, z):
        return {"v": z.v}


THERE = al.Grid(until="there", at_most=4.0, steps=8)


def test_an_input_is_the_same_function_of_time_whenever_the_grid_ends():
    # A ramp over the 4 s of the grid, force = t: x = t^3 / 6.
    history = al.simulate(Pushed(), THERE, {"force": al.PowerSeries(start=(0.0,), end=(4.0,))})
    assert np.asarray(history["time"])[-1] == pytest.approx(3 ** (1 / 3), rel=1e-12)


def test_a_declared_jump_before_the_end_divides_its_step():
    # Force 1 up to 0.7 s, 0 later: x = 0.245 + 0.7 (t - 0.7).
    history = al.simulate(Pushed(), THERE, {"force": al.StepFunction([0.7], [1.0, 0.0])})
    assert np.asarray(history["time"])[-1] == pytest.approx(0.7 + 0.255 / 0.7, rel=1e-12)


@pytest.mark.parametrize("degree", cases([0, 1]))
def test_steps_end_at_the_nodes_of_a_control_whenever_the_grid_ends(degree):
    # Accelerations that are polynomials between nodes are integrated exactly if no step crosses one.
    levels = np.array([0.2, 0.9, -0.4, 0.5, 0.3])[: 4 + degree]
    control = al.Control(0.0, degree=degree)
    problem = al.Problem(
        Pushed(),
        grid=al.Grid(until="there", at_most=4.0, steps=4),
        inputs={"force": control},
        minimize=al.at("there").mean,
    )
    fine = np.linspace(0.0, 4.0, 400_001)
    force = np.interp(fine, np.arange(5.0), levels) if degree else levels[np.minimum(fine.astype(int), 3)]
    speed = np.concatenate([[0.0], np.cumsum((force[1:] + force[:-1]) / 2 * 1e-5)])
    place = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * 1e-5)])
    right = np.interp(0.5, place[: np.argmax(place > 0.5) + 1], fine[: np.argmax(place > 0.5) + 1])
    end = compiled(lambda at: realise(problem.simulation, jnp.zeros(0), at).record(Asked()).grid.t_final)
    assert float(end(levels)) == pytest.approx(right, abs=1e-5)


class Filled(al.System):
    """A volume, until the inflow reaches a level."""

    states = ("volume",)
    level: al.Number
    events: ClassVar = {"full": al.Event(lambda self, t, z, inflow: inflow - self.level, direction=1)}

    def rhs(self, t, z, inflow):
        return (inflow,)

    def outputs(self, t, z):
        return {"volume": z.volume}


RISING = {
    "t^3": (al.processes.signal(lambda t, p: t**3), lambda k: (k ** (1 / 3), k ** (4 / 3) / 4)),
    "a table": (al.Tabulated([0.0, 4.0], [0.0, 8.0]), lambda k: (k / 2, k**2 / 4)),
}


@pytest.mark.parametrize(
    ("integrator", "inflow", "order"), cases([*((one, "t^3", 1) for one in [None, *ADAPTIVE]), (None, "a table", 2)])
)
def test_a_grid_ends_where_an_input_alone_says_with_the_derivatives_of_the_closed_form(integrator, inflow, order):
    signal, right = RISING[inflow]

    def simulated(level):
        grid = al.Grid(until="full", at_most=4.0, steps=7)
        history = al.simulate(Filled(level), grid, {"inflow": signal}, integrator=integrator)
        return jnp.stack([history["time"][-1], history["volume"][-1]])

    for ours, exact in agreeing(simulated, lambda level: jnp.stack(right(level)), 1.13, order):
        assert ours == pytest.approx(exact, rel=1e-8)


class Switched(Ball):
    """A ball on a plate at rest, which is thrown off by what the input says."""

    events: ClassVar = {
        "floor": al.Event(lambda self, t, z: z.y, direction=-1, jump=lambda self, t, z, speed: {"v": speed}),
    }


def test_functions_of_events_take_inputs():
    # The plate throws it off with 1 m/s, whenever it falls.
    grid = al.Grid(0.6, 6)
    history = al.simulate(Switched(), grid, {"speed": al.StepFunction([0.1], [3.0, 1.0])})
    after = 0.6 - np.sqrt(2 / G)
    assert np.asarray(history["h"])[-1] == pytest.approx(after - G / 2 * after**2, abs=1e-12)
    with pytest.raises(al.ProblemError, match="speed"):
        al.simulate(Switched(), grid)


def test_what_has_no_simulation_is_nan_and_said_in_a_sentence_with_the_numbers():
    refused(Ball(0.5), al.Grid(3.0, 12), "meets 'floor' again and again", "e=0.5", "t = 1.3")
    refused(Shot(angle=-0.7), LANDED, "starts at 'ground'", "angle=-0.7")
    refused(Rooted(-1.0), al.Grid(1.0, 10), "meets 'floor' at t = 0.4515 s", "sets 'v' to what is not", "e=-1")


class Leaving(al.System):
    """What a spring, or a push, takes from the place of an event, at rest: the function is written in two ways."""

    states = ("x", "v", "met")
    sign: al.Number
    place: al.Number = 0.1 + 0.2

    def level(self, t, z):
        return self.sign * (z.x - 0.3)

    def leapt(self, t, z):
        return {"v": 5.0 + 0.0 * z.v, "met": z.met + 1.0}

    events: ClassVar = {"place": al.Event(level, direction=-1, jump=leapt)}

    def initial(self):
        return {"x": self.place}

    def rhs(self, t, z, push):
        return z.v, push - z.x, 0.0

    def outputs(self, t, z):
        return {"x": z.x, "met": z.met}


class Returning(Leaving):
    events: ClassVar = {"place": al.Event(Leaving.level, direction=1, jump=Leaving.leapt)}


class Passing(Leaving):
    events: ClassVar = {"place": al.Event(Leaving.level, jump=Leaving.leapt)}


PULLED: dict[str, Any] = {"push": al.StepFunction([0.45], [0.0, 0.0])}


@pytest.mark.parametrize(("system", "sign"), cases([(Leaving, 1.0), (Returning, -1.0)], 2))
def test_a_start_at_rest_on_an_event_is_the_same_whichever_way_its_function_is_written(system, sign):
    # On the surface exactly, and but for rounding.
    for place in (0.3, 0.1 + 0.2):
        refused(system(sign, place), al.Grid(1.0, 10), "starts at 'place'", "t = 0 s", inputs=PULLED)
        # The other way it does not count: x = x_0 cos t.
        history = al.simulate(system(-sign, place), al.Grid(1.0, 10), PULLED)
        assert history["met"][-1] == 0.0
        assert history["x"][-1] == pytest.approx(place * np.cos(1.0), abs=1e-6)


@pytest.mark.slow
def test_a_start_at_rest_on_an_event_of_both_directions_is_told_and_so_is_what_leaves_it_later():
    refused(Passing(1.0), al.Grid(1.0, 10), "starts at 'place'", "t = 0 s", inputs=PULLED)
    held: dict[str, Any] = {"push": al.StepFunction([0.45], [0.3, 0.0])}
    for system, sign in ((Leaving, 1.0), (Returning, -1.0)):
        refused(system(sign, 0.3), al.Grid(1.0, 10), "starts at 'place'", "from t = 0.45 s", inputs=held)


class Emptied(al.System):
    """A tank whose level falls evenly; behind its bottom the root has no rate."""

    states = ("h",)
    events: ClassVar = {
        "falls": al.Event(lambda self, t, z: self.depth(z), direction=-1),
        "rises": al.Event(lambda self, t, z: -self.depth(z), direction=1),
    }

    def depth(self, z):
        return jnp.sqrt(jnp.maximum(z.h, 0.0)) - 0.3

    def initial(self):
        return {"h": 1.0}

    def rhs(self, t, z):
        return (-1.0,)

    def outputs(self, t, z):
        return {"h": z.h}


def test_a_function_without_a_rate_behind_its_zero_crosses_it_whichever_way_it_is_written():
    for name in Emptied.events:
        ended = al.simulate(Emptied(), al.Grid(until=name, at_most=2.0, steps=1))["time"][-1]
        assert ended == pytest.approx(1.0 - 0.3**2, rel=1e-12)


class Drained(al.System):
    """A tank that runs empty through a hole: `sqrt(h)` falls evenly, and has no value below zero."""

    states = ("h",)
    c: al.Number = 0.57
    events: ClassVar = {
        "low": al.Event(lambda self, t, z: z.h - 0.1, direction=-1),
        "half": al.Event(lambda self, t, z: z.h - 0.5, direction=-1, jump=lambda self, t, z: {"h": z.h}),
    }

    def initial(self):
        return {"h": 0.95}

    def rhs(self, t, z):
        return (-self.c * jnp.sqrt(z.h),)

    def outputs(self, t, z):
        return {"h": z.h}


@pytest.mark.slow
def test_a_step_that_leads_beyond_an_event_to_rates_that_are_none_is_told_with_what_to_do():
    refused(Drained(), al.Grid(until="low", at_most=30.0, steps=40), "not finite after t = 2.25 s", "Take more steps")
    refused(Drained(), al.Grid(until="low", at_most=2.0, steps=40), "never meets 'low'", "from 0 to 2 s")
    ended = al.simulate(Drained(), al.Grid(until="low", at_most=3.0, steps=40))["time"][-1]
    assert ended == pytest.approx(2 * (np.sqrt(0.95) - np.sqrt(0.1)) / 0.57, rel=1e-6)


@pytest.mark.slow
def test_a_jump_that_stays_two_events_at_once_and_one_that_is_only_touched_are_told_too():
    refused(Stopped(), al.Grid(1.0, 10), "stays at 'floor'", "t = 0.4515 s")
    refused(Parts(), al.Grid(1.0, 10), "meets 'floor' and 'wall' at the same time", "t = 0.4515 s")
    refused(Shot(), al.Grid(until="ground", at_most=2.0, steps=9), "never meets 'ground'", "from 0 to 2 s")
    refused(Grazing(), al.Grid(until="ceiling", at_most=2.0, steps=9), "'ceiling'")


def test_events_that_nothing_can_look_for_are_refused():
    with pytest.raises(al.ProblemError, match=r"no event 'grond'.*Did you mean 'ground'"):
        al.simulate(Shot(), al.Grid(until="grond", at_most=1.0, steps=4))


def declaring(*event, **fields):
    return type("Own", (Ball,), {"__annotations__": {}, "events": {"floor": al.Event(*event, **fields)}})()


def traced(*arguments):
    """Simulate, but for the numbers."""
    jax.eval_shape(lambda: al.simulate(*arguments))


def test_an_event_is_checked_where_it_is_declared():
    for wrong in ((1.0,), (lambda self, t, z: z.y, 2), (lambda self, t, z: z.y, 0, {"v": 1.0})):
        with pytest.raises(al.ProblemError, match=r"Event: .*expected"):
            al.Event(*typing.cast(Any, wrong))
    grid = al.Grid(1.0, 4)
    with pytest.raises(al.ProblemError, match=r"events\['floor'\]: expected one real number"):
        traced(declaring(lambda self, t, z: jnp.stack([z.y, z.v]), jump=lambda self, t, z: {}), grid)
    with pytest.raises(al.ProblemError, match=r"crosses zero, such as z.y; received bool"):
        traced(declaring(lambda self, t, z: z.y <= 0, jump=lambda self, t, z: {}), grid)
    with pytest.raises(al.ProblemError, match=r"events\['floor'\].jump: expected new values by the names"):
        traced(declaring(lambda self, t, z: z.y, jump=lambda self, t, z: {"w": 1.0}), grid)
    with pytest.raises(al.ProblemError, match=r"events\['floor'\].jump, 'v': expected a number|shape"):
        traced(declaring(lambda self, t, z: z.y, jump=lambda self, t, z: {"v": jnp.zeros(2)}), grid)
    with pytest.raises(al.ProblemError, match="Grid: until"):
        al.Grid(at_most=1.0, steps=4)
    with pytest.raises(al.ProblemError, match="at_most"):
        al.Grid(1.0, 4, until="floor")
    with pytest.raises(al.ProblemError, match="at_most"):
        al.Grid(until="floor", steps=4)


class Hanging(al.Lagrangian):
    """A mass on a spring, above a stop."""

    coordinates = ("height",)
    k: al.Number = 4.0
    e: al.Number = 0.5
    events: ClassVar = {
        "stop": al.Event(lambda self, t, z: z.q[0] + 0.5, direction=-1, jump=lambda self, t, z: {"v": -self.e * z.v})
    }

    def kinetic_energy(self, q, v):
        return 0.5 * v[0] ** 2

    def potential_energy(self, q):
        return 0.5 * self.k * q[0] ** 2


def test_a_mechanical_model_has_events_in_forward_dynamics_alone():
    # cos 2t from 1 reaches -1/2 at 2t = 2 pi / 3 with the rate -sqrt 3; then it goes on from there.
    grid, hit = al.Grid(1.5, 150), np.pi / 3
    history = al.simulate(al.ForwardDynamics(Hanging(), start={"height": 1.0}), grid)
    after = 2 * (1.5 - hit)
    right = -0.5 * np.cos(after) + 0.25 * np.sqrt(3) * np.sin(after)
    assert np.asarray(history["height"])[-1] == pytest.approx(right, abs=1e-8)
    prescribed = al.InverseDynamics(Hanging(), motion={"height": al.PowerSeries(start=(1.0,), end=(-1.0,))})
    assert np.isfinite(al.simulate(prescribed, grid)["height"]).all()
