"""Optimal control problems whose optima are known: in closed form, or to many digits from the literature."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from collocated_problems import Regulated
from scipy.optimize import brentq

import aleator as al
from zoo import optimum as found

GRAVITY = 9.80665


class Bead(al.System):
    """A bead that slides on a wire at an angle below the horizontal, without friction."""

    states = ("x", "y", "v")

    def rhs(self, t, z, angle):
        return z.v * jnp.sin(angle), -z.v * jnp.cos(angle), GRAVITY * jnp.cos(angle)

    def outputs(self, t, z, angle):
        return {"x": z.x, "y": z.y}


def spline(guess: Any, low: float = -np.inf, high: float = np.inf, degree: int = 1) -> al.BSpline:
    return al.BSpline(al.Decision(np.asarray(guess, dtype=float), low, high), degree=degree)


def optimum(problem: al.Problem, scheme: Any) -> float:
    """Of the program alone: how far it is from that of the continuous problem is what is tested."""
    return found(problem, al.solvers.Ipopt(tolerance=1e-8), al.Simultaneous(scheme)).objective


def cycloid_time(x: float, depth: float) -> float:
    """The least time to slide to a point, s: along a cycloid."""
    angle = brentq(lambda a: (a - np.sin(a)) / (1 - np.cos(a)) - x / depth, 0.1, 6.0, xtol=1e-15)
    return angle * np.sqrt(depth / (1 - np.cos(angle)) / GRAVITY)


@pytest.mark.slow
def test_brachistochrone():
    problem = al.Problem(
        Bead(),
        grid=al.Grid(al.Decision(2.0, 0.5, 10.0), 30),
        inputs={"angle": spline(np.linspace(0.1, 1.7, 12), 0.0, np.pi, degree=3)},
        minimize=al.objectives.final_time(),
        subject_to=[al.terminal("x").mean.equals(10.0), al.terminal("y").mean.equals(-5.0)],
    )
    exact = cycloid_time(10.0, 5.0)
    assert exact == pytest.approx(1.801603122, abs=1e-9)
    assert optimum(problem, al.schemes.GaussLegendre(2)) == pytest.approx(exact, rel=1e-6)


def regulated(intervals: int, duration: float) -> al.Problem:
    """Its optimal control is so close to a polynomial that the scheme's errors are all that is left."""
    return al.Problem(
        Regulated(),
        grid=al.Grid(duration, intervals),
        inputs={"u": spline(np.zeros(12), degree=11)},
        minimize=al.integral("cost").mean,
    )


CONVERGING = {
    "Hermite and Simpson": (al.schemes.HermiteSimpson(), (4, 8)),
    "Radau, three stages": (al.schemes.Radau(3), (4, 8)),
    "segments of two steps": (al.schemes.MultipleShooting(2), (4, 8)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CONVERGING)
def test_errors_of_the_optimum_fall_by_the_order_of_the_scheme(name):
    """The least cost is the solution of Riccati's equation: sinh(w T) / (w cosh(w T) + sinh(w T)), w = sqrt(2)."""
    (scheme, intervals), duration = CONVERGING[name], 2.0
    w = np.sqrt(2.0)
    exact = np.sinh(w * duration) / (w * np.cosh(w * duration) + np.sinh(w * duration))
    first, second = (abs(optimum(regulated(some, duration), scheme) - exact) for some in intervals)
    assert np.log2(first / second) == pytest.approx(scheme.order, abs=0.3)
