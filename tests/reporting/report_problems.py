"""Problems and results that tests of figures, files and pages share: each is solved once for each worker."""

from functools import cache
from typing import Any, ClassVar

import jax.numpy as jnp

import aleator as al


class Oscillator(al.System):
    """A mass released from rest on a damped spring."""

    states = ("x", "v")
    units: ClassVar = {"back": "m", "effort": "m²/s⁴"}

    k: al.Number = al.parameter("N/m", positive=True)
    c: al.Number = al.parameter("N s/m")

    def rhs(self, t: Any, z: Any) -> tuple[Any, ...]:
        return z.v, -self.k * z.x - self.c * z.v

    def outputs(self, t: Any, z: Any) -> dict[str, Any]:
        return {"back": -z.x, "effort": self.c**2 + z.v**2}

    def initial(self) -> dict[str, float]:
        return {"x": 1.0}


def problem(reach: float = 0.45) -> al.Problem:
    """The least damped oscillator whose swing to the other side stays within `reach`."""
    return al.Problem(
        Oscillator(k=al.Uniform(4.0, half_width=0.4), c=al.Uniform(al.Decision(1.0, 0.2, 3.0), half_width=0.1)),
        grid=al.Grid(t_final=4.0, steps=50),
        minimize=al.integral("effort").mean,
        subject_to=[al.path("back").at_most(reach, sigmas=1.0).named("reach <b>&")],
        expansion=al.Expansion(order=2),
    )


NAME = "reach <b>&"


class Block(al.System):
    """A block of uncertain mass that is pushed along a bumpy way."""

    states = ("x", "v")
    mass: al.Number = al.parameter("kg")

    def rhs(self, t: Any, z: Any, push: Any) -> tuple[Any, ...]:
        return z.v, push / self.mass - jnp.sin(3.0 * z.x)

    def outputs(self, t: Any, z: Any, push: Any) -> dict[str, Any]:
        return {"x": z.x, "v": z.v, "effort": push**2}


def move() -> al.Problem:
    """Half a metre from rest to rest, with the least effort."""
    x, v = al.terminal("x"), al.terminal("v")
    return al.Problem(
        Block(al.Uniform(1.0, half_width=0.1)),
        grid=al.Grid(1.0, 3),
        inputs={"push": al.Control(0.0, -20.0, 20.0, degree=1)},
        minimize=al.integral("effort").mean,
        subject_to=[
            x.mean.equals(0.5).named("there"),
            v.mean.equals(0.0).named("at rest"),
            (x.std <= 0.05).named("spread"),
        ],
        expansion=al.Expansion(order=2),
    )


class Bar(al.AlgebraicSystem):
    """A bar that carries an uncertain load, with units."""

    units: ClassVar = {"stress": "N/mm"}

    width: al.Number = al.parameter("mm", positive=True)
    load: al.Number = al.parameter("N")

    def outputs(self) -> dict[str, Any]:
        return {"stress": self.load / self.width, "mass": self.width}


def bar_problem(*limits: Any) -> al.Problem:
    """The lightest bar within limits."""
    model = Bar(al.Decision(4.0, 1.0, 10.0), al.Uniform(1.0, half_width=0.3))
    return al.Problem(model, minimize=al.output("mass").mean, subject_to=limits)


@cache
def bar() -> al.Solution:
    """Without time, and with a limit on a statistic that is no moment."""
    return al.solve(bar_problem((al.output("stress").quantile(0.9) <= 2.0).named("chance")))


@cache
def solution() -> al.Solution:
    return al.solve(problem(0.2))


@cache
def collocated() -> al.Solution:
    """By direct collocation on several meshes."""
    return al.solve(move(), transcription=al.Simultaneous(error=1e-4))


@cache
def infeasible() -> al.Solution:
    return al.solve(problem(-0.5), throw=False)


@cache
def evidence() -> al.results.Evidence:
    return al.validate(solution(), 400, seed=3, keep=20)


@cache
def front() -> al.results.Front:
    return al.pareto(problem(), NAME, [0.9, 0.3, 0.2, -0.5])


@cache
def calibration() -> al.results.Calibration:
    return al.calibrate(problem(0.2), NAME, 0.1, samples=400, precision=0.5)
