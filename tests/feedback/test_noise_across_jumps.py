"""White noise where states jump: at events, and between phases."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import aleator as al
from aleator._core.arrays import jax_array
from aleator.uncertainty import realise
from zoo import G, cases, optimum

INTENSITY = 4e-4
STIFF, DAMPED = 2.0, 0.3


def history(problem):
    """The outputs at the initial decisions."""
    start = jax_array(problem.placements.vector("initial"))
    found = jax.jit(lambda: realise(problem.simulation, jnp.zeros(0), start).history())()
    return jax.tree.map(np.asarray, found)


class Struck(al.System):
    """An oscillator with a noisy force, which is struck where it passes a place."""

    states = ("x", "v")
    place: al.Number = 0.5
    events: ClassVar = {
        "strike": al.Event(
            lambda self, t, z: z.x - self.place - 0.1 * t,
            direction=1,
            jump=lambda self, t, z: {"x": z.x + 0.2 * z.v, "v": -0.8 * z.v + 0.3 * t},
        )
    }

    def initial(self):
        return {"v": 1.5}

    def rhs(self, t, z, w):
        return z.v, -STIFF * z.x - DAMPED * z.v + w

    def outputs(self, t, z):
        return {"x": z.x, "v": z.v}


NOISE = {"w": al.processes.WhiteNoise(INTENSITY)}
A, B = np.array([[0.0, 1.0], [-STIFF, -DAMPED]]), np.array([0.0, 1.0])


def carried(P, t):
    """A covariance some time later, by the equation of Lyapunov."""
    stationary = scipy.linalg.solve_continuous_lyapunov(A, -INTENSITY * np.outer(B, B))
    grown = scipy.linalg.expm(A * t)
    return stationary + grown @ (P - stationary) @ grown.T


def struck():
    """The time of the strike, and the states there."""
    t = scipy.optimize.brentq(
        lambda t: (scipy.linalg.expm(A * t) @ [0.0, 1.5])[0] - 0.5 - 0.1 * t, 0.1, 0.8, xtol=1e-14
    )
    return t, scipy.linalg.expm(A * t) @ [0.0, 1.5]


def test_a_covariance_crosses_a_jump_by_the_saltation_matrix():
    t, z = struck()
    jump, by_time, level = np.array([[1.0, 0.2], [0.0, -0.8]]), np.array([0.0, 0.3]), np.array([1.0, 0.0])
    after = jump @ z + by_time * t
    rate = level @ A @ z - 0.1
    S = jump + np.outer(A @ after - jump @ A @ z - by_time, level) / rate
    P = carried(S @ carried(np.zeros((2, 2)), t) @ S.T, 1.0 - t)
    problem = al.Problem(
        Struck(al.Decision(0.5, 0.4, 0.6)), grid=al.Grid(1.0, 200), inputs=NOISE, minimize=al.terminal("x").std
    )
    found = history(problem)
    assert [found[f"{name}.variance"][-1] for name in "xv"] == pytest.approx(np.diag(P), rel=1e-7)


class Ball(al.System):
    """A ball in a noisy draught."""

    states = ("y", "v")
    e: al.Number = 0.8
    events: ClassVar = {"floor": al.Event(lambda self, t, z: z.y, direction=-1)}

    def initial(self):
        return {"y": 1.0}

    def rhs(self, t, z, w=0.0):
        return z.v, w - G

    def outputs(self, t, z):
        return {"y": z.y, "v": z.v}


DRAUGHT, LATER = 0.002, 0.3


@pytest.mark.parametrize("way", cases([al.Sequential(), al.Simultaneous()]), ids=lambda way: type(way).__name__)
def test_a_covariance_crosses_the_end_of_a_phase(way):
    noise = {"w": al.processes.WhiteNoise(DRAUGHT)}
    ball = Ball(al.Decision(0.75, 0.7, 0.9))
    phases = al.Phases(
        fall=al.Phase(ball, al.Grid(until="floor", at_most=1.0, steps=10), inputs=noise),
        rise=al.Phase(ball, al.Grid(LATER, 10), inputs=noise),
        link={"rise": lambda self, t, z: {"v": -self.e * z.v}},
    )
    best = al.Problem(phases, minimize=-al.value("fall.e"), subject_to=[al.terminal("v").std <= 0.028])
    (e,) = optimum(best, transcription=way).decisions.values()
    # At the floor a speed deviates by that of the ball there less that of its height in the time of the fall.
    speed_variance = DRAUGHT * np.sqrt(2 / G) / 3
    assert e**2 == pytest.approx((0.028**2 - DRAUGHT * LATER) / speed_variance, rel=1e-5)


@pytest.mark.slow
def test_the_covariance_of_a_cycle_is_stationary():
    class Forced(Struck):
        events: ClassVar = {}

        def rhs(self, t, z, w):
            return z.v, jnp.cos(t) - STIFF * z.x - DAMPED * z.v + w

    grid = al.Grid(2 * np.pi, 100, periodic=True)
    found = history(al.Problem(Forced(), grid=grid, inputs=NOISE, minimize=al.terminal("x").std))
    for name, variance in {"x": INTENSITY / (2 * DAMPED * STIFF), "v": INTENSITY / (2 * DAMPED)}.items():
        np.testing.assert_allclose(found[f"{name}.variance"], variance, rtol=1e-5)
