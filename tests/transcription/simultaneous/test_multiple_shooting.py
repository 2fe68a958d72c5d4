"""Multiple shooting: segments of the order of their rule, and the same answers as by simulation and collocation."""

from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from collocated_problems import crane
from scipy.integrate import solve_ivp

import aleator as al
from aleator.dynamics import SegmentRate
from stirred_tanks import Tank


def _swung(steps: int, segments: int) -> np.ndarray:
    """A pendulum and the integral of its angle squared after two seconds, pushed by cos(3 t)."""

    def rate(place, signal, z):
        return jnp.array([z[1], signal[0] - jnp.sin(z[0]), z[0] ** 2])

    mean, moved, nodes = SegmentRate(steps), jnp.array([1.0, 0.0, 0.0]), np.linspace(0.0, 2.0, segments + 1)
    for first, last in pairwise(nodes):
        times = first + (last - first) * mean.told
        places = jnp.stack([jnp.asarray(times), jnp.zeros(len(times))], axis=1)
        moved = moved + (last - first) * mean(rate, places, jnp.cos(3 * jnp.asarray(times))[:, None], moved[:2])
    return np.asarray(moved)


@pytest.mark.parametrize("refined", ["steps", "segments"])
def test_states_and_integrals_are_of_order_4_in_steps_and_in_segments(refined):
    def rate(t, z):
        return [z[1], np.cos(3 * t) - np.sin(z[0]), z[0] ** 2]

    exact = solve_ivp(rate, (0.0, 2.0), [1.0, 0.0, 0.0], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    counts = [(32, 2), (64, 2)] if refined == "steps" else [(2, 32), (2, 64)]
    first, second = (np.abs(_swung(*count) - exact) for count in counts)
    np.testing.assert_allclose(np.log2(first / second), 4.0, atol=0.15)


def test_its_quadrature_is_that_of_its_steps():
    mean = SegmentRate(3)
    assert mean.quadrature.sum() == pytest.approx(1.0, rel=1e-14)
    assert mean.quadrature @ mean.told**3 == pytest.approx(1 / 4, rel=1e-14)


def test_a_model_is_traced_as_often_whatever_the_steps_are():
    """And what is compiled is as large."""
    sizes, traced = [], []
    for steps in (1, 2, 40):
        mean, calls = SegmentRate(steps), []

        def rate(place, signal, z, calls=calls):
            calls.append(1)
            return jnp.append(-z, signal)

        given = np.zeros((len(mean.told), 2)), np.zeros((len(mean.told), 1)), np.zeros(1)
        closed = jax.make_jaxpr(lambda *some, mean=mean, rate=rate: mean(rate, *some))(*given)
        sizes.append(len(str(closed.jaxpr.pretty_print()).splitlines()))
        traced.append(len(calls))
    assert len(set(sizes)) == len(set(traced)) == 1


MOVES = [
    al.terminal("x").mean.equals(1.0),
    *(al.terminal(name).mean.equals(0.0) for name in ("v", "angle", "rate")),
]


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "segments"), [(1, 20), (4, 5)])
def test_a_family_of_systems_has_the_answer_of_single_shooting_by_the_same_steps(steps, segments):
    """Both take the same steps of the same rule: without limits in between, the programs have the same optimum."""
    usual = al.solve(crane(20, subject_to=MOVES), between=1, accuracy=0.5)
    way = al.Simultaneous(al.schemes.MultipleShooting(steps))
    other = al.solve(crane(segments, subject_to=MOVES), transcription=way, between=1, accuracy=0.5)
    assert other.objective == pytest.approx(usual.objective, rel=1e-9)
    np.testing.assert_allclose(other.vector, usual.vector, atol=1e-6)


@pytest.mark.slow
def test_algebraic_variables_are_solved_for_on_the_way():
    problem = al.Problem(
        Tank(),
        grid=al.Grid(2.0, 6),
        inputs={"feed": al.BSpline(al.Decision(np.full(4, 0.5), 0.0, 5.0), degree=2)},
        minimize=al.integral("miss").mean,
    )
    way = al.Simultaneous(al.schemes.MultipleShooting(1))
    usual, other = (al.solve(problem, transcription=one, between=1, throw=False) for one in (al.Sequential(), way))
    assert other.objective == pytest.approx(usual.objective, rel=1e-8)
    np.testing.assert_allclose(other.vector, usual.vector, atol=1e-6)


class Placed(al.System):
    """A unit mass on a rail, from rest wherever that is best."""

    states = ("x", "v")
    start: al.Number = 0.0

    def rhs(self, t, z, u):
        return z.v, u

    def outputs(self, t, z, u):
        return {"x": z.x, "v": z.v, "u²": u**2}

    def initial(self):
        return {"x": self.start}


def test_a_start_may_be_decided():
    """Half a metre from rest to rest within a second: 12 d² = 3, from the bound of the start, in two segments."""
    problem = al.Problem(
        Placed(start=al.Decision(0.1, -1.0, 0.5)),
        grid=al.Grid(1.0, 2),
        inputs={"u": al.BSpline(al.Decision(np.zeros(3), -50.0, 50.0), degree=2)},
        minimize=al.integral("u²").mean,
        subject_to=[al.terminal("x").mean.equals(1.0), al.terminal("v").mean.equals(0.0)],
    )
    solution = al.solve(problem, transcription=al.Simultaneous(al.schemes.MultipleShooting()))
    assert solution.objective == pytest.approx(3.0, rel=1e-7)
    assert solution.decisions["start"] == pytest.approx(0.5, abs=1e-7)


class Pole(al.System):
    """A pole near its top, where what differs at the start grows by e^(rate T)."""

    states = ("angle", "speed")

    rate: Any = 4.0

    def rhs(self, t, z, u):
        return z.speed, self.rate**2 * jnp.sin(z.angle) + u

    def outputs(self, t, z, u):
        return {"angle": z.angle, "speed": z.speed, "u²": u**2}

    def initial(self):
        return {"angle": 0.5}


def test_a_pole_is_caught_where_single_shooting_fails():
    """Over 12 s, e^48 of growth: what is simulated in one piece tumbles at every control on the way."""
    duration = 12.0
    problem = al.Problem(
        Pole(),
        grid=al.Grid(duration, 72),
        inputs={"u": al.Control(0.0, -500.0, 500.0, degree=1)},
        minimize=al.integral("u²").mean,
        subject_to=[al.terminal("angle").mean.equals(0.0), al.terminal("speed").mean.equals(0.0)],
    )
    single = al.solve(problem, between=1, throw=False)
    assert not single.ok
    assert single.certificate.violation > 0.1

    def straight(t):
        return {"angle": 0.5 * (1 - t / duration), "speed": 0.0}

    schemes = al.schemes.MultipleShooting(4), al.schemes.GaussLegendre(3)
    ways = [al.Simultaneous(scheme, guess=straight) for scheme in schemes]
    one, other = (al.solve(problem, transcription=way, between=1, throw=False) for way in ways)
    assert one.certificate.violation < 1e-9
    assert one.certificate.stationarity < 1e-6
    assert one.objective == pytest.approx(other.objective, rel=1e-5)


@pytest.mark.slow
def test_segments_are_divided_until_their_error_is_what_is_asked():
    asked = 1e-6
    way = al.Simultaneous(al.schemes.MultipleShooting(2), error=asked)
    solution = al.solve(crane(5, subject_to=MOVES), transcription=way, throw=False, between=1)
    worst = [one.worst for one in solution.meshes]
    assert worst[-1] <= asked < worst[0]
    assert worst == sorted(worst, reverse=True)
    exact = al.solve(crane(400, subject_to=MOVES), throw=False, between=1)
    assert solution.objective == pytest.approx(exact.objective, rel=20 * asked)


@pytest.mark.parametrize("steps", [0, -1, 1.5, "4", True, None])
def test_steps_are_a_whole_number(steps):
    with pytest.raises(al.ProblemError, match="MultipleShooting: steps is a whole number"):
        al.schemes.MultipleShooting(steps)


def test_very_many_steps_of_a_segment_are_refused():
    with pytest.raises(al.ProblemError, match="at most 100 steps in a segment"):
        al.schemes.MultipleShooting(2000)
