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


@pytest.mark.parametrize("integrator", cases([FIXED[0], ADAPTIVE[1], FIXED[1]], 2), ids=lambda one: type(one).__name__)
def test_a_ball_bounces_wherever_in_a_step_and_twice_in_one(integrator):
    history = al.simulate(Ball(), al.Grid(1.2, 2), integrator=integrator)
    assert np.asarray(history["h"])[-1] == pytest.approx(second_flight(0.7, 1.0, 1.2), abs=1e-13)


@pytest.mark.parametrize("order", cases([1, 2]))
def test_derivatives_after_jumps_are_those_of_the_closed_form_to_second_order(order):
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

    for ours, right in agreeing(simulated, lambda at: landing(*at, library=jnp), [20.0, 0.7, 1.0], 1):
        assert ours == pytest.approx(right, rel=1e-9, abs=1e-10)


def test_a_body_lands_on_the_ground_to_rounding_and_flies_as_by_scipy_however_late_the_grid_may_end():
    c, start = 0.02, [0.0, 1.0, 20 * np.cos(0.7), 20 * np.sin(0.7)]

    def rates(t, z):
        drag = c * np.hypot(z[2], z[3])
        return [z[2], z[3], -drag * z[2], -G - drag * z[3]]

    right = scipy.integrate.solve_ivp(rates, (0, 3), start, "DOP853", rtol=1e-12, atol=1e-13, dense_output=True).sol
    errors = []
    for steps in (40, 80):
        history = al.simulate(Shot(20.0, 0.7, 1.0, c), al.Grid(until="ground", at_most=30.0, steps=steps))
        assert abs(np.asarray(history["y"])[-1]) < 1e-13
        errors.append(np.max(np.abs(np.asarray(history["x"]) - right(np.asarray(history["time"]))[0])))
    assert errors[0] < 1e-6
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)


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


def test_steps_end_at_the_nodes_of_a_control_whenever_the_grid_ends():
    # Accelerations that are polynomials between nodes are integrated exactly if no step crosses one.
    levels = np.array([0.2, 0.9, -0.4, 0.5])
    control = al.Control(0.0, degree=0)
    problem = al.Problem(
        Pushed(),
        grid=al.Grid(until="there", at_most=4.0, steps=4),
        inputs={"force": control},
        minimize=al.at("there").mean,
    )
    fine = np.linspace(0.0, 4.0, 400_001)
    force = levels[np.minimum(fine.astype(int), 3)]
    speed = np.concatenate([[0.0], np.cumsum((force[1:] + force[:-1]) / 2 * 1e-5)])
    place = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * 1e-5)])
    right = np.interp(0.5, place[: np.argmax(place > 0.5) + 1], fine[: np.argmax(place > 0.5) + 1])
    end = compiled(lambda at: realise(problem.simulation, jnp.zeros(0), at).record(Asked()).grid.t_final)
    assert float(end(levels)) == pytest.approx(right, abs=1e-5)


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


PULLED: dict[str, Any] = {"push": al.StepFunction([0.45], [0.0, 0.0])}


# On the surface exactly, and but for rounding.
STARTS = [(Leaving, 1.0, 0.1 + 0.2), (Returning, -1.0, 0.3), (Leaving, 1.0, 0.3), (Returning, -1.0, 0.1 + 0.2)]


@pytest.mark.parametrize(("system", "sign", "place"), cases(STARTS, 2))
def test_a_start_at_rest_on_an_event_is_the_same_whichever_way_its_function_is_written(system, sign, place):
    refused(system(sign, place), al.Grid(1.0, 10), "starts at 'place'", "t = 0 s", inputs=PULLED)
    # The other way it does not count: x = x_0 cos t.
    history = jax.device_get(al.simulate(system(-sign, place), al.Grid(1.0, 10), PULLED))
    assert history["met"][-1] == 0.0
    assert history["x"][-1] == pytest.approx(place * np.cos(1.0), abs=1e-6)


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
        ended = al.simulate(Emptied(), al.Grid(until=name, at_most=2.0, steps=1))["time"]
        assert np.asarray(ended)[-1] == pytest.approx(1.0 - 0.3**2, rel=1e-12)


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
    with pytest.raises(al.ProblemError, match="at_most"):
        al.Grid(until="floor", steps=4)


# --- Integrators whose steps follow their error -----------------------------------------------------------------------


@pytest.mark.slow
def test_an_adaptive_integrator_ends_at_an_event_with_the_derivatives_of_the_closed_form():
    def simulated(angle):
        return al.simulate(Shot(20.0, angle), al.Grid(until="ground", at_most=4.0, steps=4), integrator=ADAPTIVE[0])

    def ends(angle):
        history = simulated(angle)
        return history["time"][-1], history["x"][-1]

    (time, place), (_, slope) = compiled(lambda angle: (ends(angle), jax.jacfwd(ends)(angle)))(0.7)
    assert (time, place) == pytest.approx((40 * np.sin(0.7) / G, 400 * np.sin(1.4) / G), rel=1e-10)
    assert float(slope) == pytest.approx(800 * np.cos(1.4) / G, rel=1e-8)
    with pytest.warns(al.SimulationWarning, match=r"angle=0.7.*never meets 'ground'"):
        al.simulate(Shot(20.0, 0.7), al.Grid(until="ground", at_most=1.0, steps=4), integrator=ADAPTIVE[0])


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
