"""Optimal control problems whose optima are known: in closed form, or to many digits from the literature."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from collocated_problems import Regulated
from scipy.optimize import brentq

import aleator as al
from aleator.transcription import transcribe
from zoo import Launched
from zoo import optimum as found

GRAVITY = 9.80665


class Bead(al.System):
    """A bead that slides on a wire at an angle below the horizontal, without friction."""

    states = ("x", "y", "v")

    def rhs(self, t, z, angle):
        return z.v * jnp.sin(angle), -z.v * jnp.cos(angle), GRAVITY * jnp.cos(angle)

    def outputs(self, t, z, angle):
        return {"x": z.x, "y": z.y}


class VanDerPol(al.System):
    """The oscillator, pushed."""

    states = ("x1", "x2")

    def rhs(self, t, z, u):
        return (1 - z.x2**2) * z.x1 - z.x2 + u, z.x1

    def outputs(self, t, z, u):
        return {"cost": z.x1**2 + z.x2**2 + u**2}

    def initial(self):
        return {"x2": 1.0}


class Particle(al.System):
    """A particle with a thrust of constant size and a free direction."""

    states = ("x", "y", "vx", "vy")

    def rhs(self, t, z, angle):
        return z.vx, z.vy, 100.0 * jnp.cos(angle), 100.0 * jnp.sin(angle)

    def outputs(self, t, z, angle):
        return {"y": z.y, "vx": z.vx, "vy": z.vy}


def spline(guess: Any, low: float = -np.inf, high: float = np.inf, degree: int = 1) -> al.BSpline:
    return al.BSpline(al.Decision(np.asarray(guess, dtype=float), low, high), degree=degree)


def optimum(problem: al.Problem, scheme: Any) -> float:
    """Of the program alone: how far it is from that of the continuous problem is what is tested."""
    return found(problem, al.solvers.Ipopt(tolerance=1e-8), al.Simultaneous(scheme)).objective


def cycloid_time(x: float, depth: float) -> float:
    """The least time to slide to a point, s: along a cycloid."""
    angle = brentq(lambda a: (a - np.sin(a)) / (1 - np.cos(a)) - x / depth, 0.1, 6.0, xtol=1e-15)
    return angle * np.sqrt(depth / (1 - np.cos(angle)) / GRAVITY)


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


def test_least_time_to_move_a_block():
    """Full ahead, then full astern: 2 sqrt(d). A linear spline of n odd pieces needs one of them to turn round, and so
    T² (1 - 1 / (3 n²)) = 4 d.
    """
    pieces, distance = 21, 2.0
    problem = al.Problem(
        Launched(),
        grid=al.Grid(al.Decision(4.0, 1.0, 10.0), pieces),
        inputs={"force": spline(np.zeros(pieces + 1), -1.0, 1.0)},
        minimize=al.objectives.final_time(),
        subject_to=[al.terminal("x").mean.equals(distance), al.terminal("v").mean.equals(0.0)],
    )
    exact = 2 * np.sqrt(distance / (1 - 1 / (3 * pieces**2)))
    assert optimum(problem, al.schemes.GaussLegendre(2)) == pytest.approx(exact, rel=1e-7)


def test_bryson_and_denham():
    """Bryson, Denham and Dreyfus 1963: 4 / (9 l), with forces that are linear between thirds of the time."""
    limit, pieces = 1 / 9, 60
    problem = al.Problem(
        Launched(speed=1.0),
        grid=al.Grid(1.0, pieces),
        inputs={"force": spline(np.zeros(pieces + 1))},
        minimize=0.5 * al.integral("effort").mean,
        subject_to=[
            al.terminal("x").mean.equals(0.0),
            al.terminal("v").mean.equals(-1.0),
            al.path("x").at_most(limit),
        ],
    )
    assert optimum(problem, al.schemes.HermiteSimpson()) == pytest.approx(4 / (9 * limit), rel=1e-6)


def test_van_der_pol():
    pieces = 100
    problem = al.Problem(
        VanDerPol(),
        grid=al.Grid(10.0, pieces),
        inputs={"u": al.Control(0.0, -1.0, 1.0, degree=1)},
        minimize=al.integral("cost").mean,
    )
    assert optimum(problem, al.schemes.HermiteSimpson()) == pytest.approx(2.87330, abs=1.5e-5)


def test_steering_a_particle():
    """Betts, Practical Methods for Optimal Control, example 4.1: thrust by the law of a linear tangent."""
    problem = al.Problem(
        Particle(),
        grid=al.Grid(al.Decision(1.0, 0.1, 5.0), 20),
        inputs={"angle": spline(np.linspace(1.0, -1.0, 12), -np.pi / 2, np.pi / 2, degree=3)},
        minimize=al.objectives.final_time(),
        subject_to=[
            al.terminal("y").mean.equals(5.0),
            al.terminal("vx").mean.equals(45.0),
            al.terminal("vy").mean.equals(0.0),
        ],
    )
    assert optimum(problem, al.schemes.GaussLegendre(2)) == pytest.approx(0.554571, rel=1e-6)


def regulated(intervals: int, duration: float) -> al.Problem:
    """Its optimal control is so close to a polynomial that the scheme's errors are all that is left."""
    return al.Problem(
        Regulated(),
        grid=al.Grid(duration, intervals),
        inputs={"u": spline(np.zeros(12), degree=11)},
        minimize=al.integral("cost").mean,
    )


CONVERGING = {
    "trapezoid": (al.schemes.Trapezoid(), (16, 32)),
    "Hermite and Simpson": (al.schemes.HermiteSimpson(), (4, 8)),
    "Radau, two stages": (al.schemes.Radau(2), (16, 32)),
    "Radau, three stages": (al.schemes.Radau(3), (4, 8)),
    "Gauss, two stages": (al.schemes.GaussLegendre(2), (4, 8)),
    "Gauss, three stages": (al.schemes.GaussLegendre(3), (2, 4)),
    "segments of one step": (al.schemes.MultipleShooting(1), (8, 16)),
    "segments of two steps": (al.schemes.MultipleShooting(2), (4, 8)),
}


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=[pytest.mark.slow] * (i != 1)) for i, one in enumerate(CONVERGING)]
)
def test_errors_of_the_optimum_fall_by_the_order_of_the_scheme(name):
    """The least cost is the solution of Riccati's equation: sinh(w T) / (w cosh(w T) + sinh(w T)), w = sqrt(2)."""
    (scheme, intervals), duration = CONVERGING[name], 2.0
    w = np.sqrt(2.0)
    exact = np.sinh(w * duration) / (w * np.cosh(w * duration) + np.sinh(w * duration))
    first, second = (abs(optimum(regulated(some, duration), scheme) - exact) for some in intervals)
    assert np.log2(first / second) == pytest.approx(scheme.order, abs=0.3)


class Sprung(al.System):
    """A mass on a spring and a damper, both to be chosen."""

    states = ("x", "v")

    stiffness: Any = al.Decision(1.0, 0.5, 2.0)
    damping: Any = al.Decision(0.5, 0.1, 1.0)

    def rhs(self, t, z):
        return z.v, -self.stiffness * z.x - self.damping * z.v

    def outputs(self, t, z):
        return {"x²": z.x**2}

    def initial(self):
        return {"x": 1.0}


class Arm(al.System):
    """Two links, held by motors of limited torque; time runs at a pace, so that controls switch when it is best."""

    states = ("first", "second", "between", "turned")

    def rhs(self, t, z, u1, u2, pace):
        sine, cosine = jnp.sin(z.between), jnp.cos(z.between)
        mass = 31 / 36 + 9 / 4 * sine**2
        push = 9 / 4 * cosine * z.first**2 + 2 * z.second**2
        pull = 7 / 2 * z.first**2 + 9 / 4 * cosine * z.second**2
        first = (sine * push + 4 / 3 * (u1 - u2) - 3 / 2 * cosine * u2) / mass
        second = -(sine * pull - 7 / 3 * u2 + 3 / 2 * cosine * (u1 - u2)) / mass
        return pace * first, pace * second, pace * (z.second - z.first), pace * z.first

    def outputs(self, t, z, u1, u2, pace):
        return {name: getattr(z, name) for name in self.states} | {"time": pace}

    def initial(self):
        return {"between": 0.5}


@pytest.mark.slow
def test_luus_arm_in_least_time():
    """Luus, Iterative Dynamic Programming (2000), section 12: bang-bang control takes 2.98228."""
    intervals = 6
    begun = 0.5 * np.repeat([1.0, -1.0], intervals // 2)
    goal = {"first": 0.0, "second": 0.0, "between": 0.5, "turned": 0.522}
    problem = al.Problem(
        Arm(),
        grid=al.Grid(1.0, intervals),
        inputs={
            **{name: al.Control(begun, -1.0, 1.0, degree=0) for name in ("u1", "u2")},
            "pace": al.Control(3.0, 0.05, 6.0, degree=0),
        },
        minimize=al.integral("time").mean,
        subject_to=[al.terminal(name).mean.equals(value) for name, value in goal.items()],
    )
    way = al.Simultaneous(al.schemes.GaussLegendre(8))
    solution = found(problem, al.solvers.Ipopt(tolerance=1e-8), way)
    assert solution.objective == pytest.approx(2.98228, abs=5e-6)
    for name in ("u1", "u2"):
        np.testing.assert_allclose(np.abs(solution.decisions[f"inputs.{name}"]), 1.0, atol=1e-6)


def test_eulers_method_makes_a_program_as_large_as_the_dissertation_says():
    """Section 3.3: 10 steps of Euler's method over a second make 20 equalities in 22 variables: the implicit method is
    Radau's with one stage. All else that we lift follows from these, row by row.
    """
    problem = al.Problem(Sprung(), grid=al.Grid(1.0, 10), minimize=al.integral("x²").mean)
    transcribed = transcribe(problem, al.Simultaneous(al.schemes.Radau(1)))
    program, numbers = transcribed.program, transcribed.layout.numbers
    free, states = program.lower < program.upper, numbers.states[0, 1:]
    ties = transcribed.assembled.rows.ties.variables
    assert free[numbers.decisions].sum() + states.size == 22
    assert np.isin(ties, states).sum() == 20
    # Every other free variable has a row of its own that says what it is.
    lifted = np.setdiff1d(np.flatnonzero(free), np.append(numbers.decisions, states))
    np.testing.assert_array_equal(np.sort(ties[~np.isin(ties, states)]), lifted)
