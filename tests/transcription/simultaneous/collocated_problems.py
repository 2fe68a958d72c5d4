"""Problems to be transcribed both ways: small, and with all that a problem may be made of."""

from typing import Any

import jax.numpy as jnp
import numpy as np

import aleator as al
from tiny_models import oscillator_problem


class Cart(al.System):
    """A cart with a pendulum as long as `length`, pushed by a force: a small crane."""

    states = ("x", "v", "angle", "rate")

    length: Any = 1.0
    mass: Any = 0.3
    damping: Any = 0.0

    def rhs(self, t, z, force):
        sine, cosine = jnp.sin(z.angle), jnp.cos(z.angle)
        push = force - self.damping * z.v + self.mass * sine * (self.length * z.rate**2 + 9.81 * cosine)
        acceleration = push / (1.0 + self.mass * sine**2)
        return z.v, acceleration, z.rate, -(acceleration * cosine + 9.81 * sine) / self.length

    def outputs(self, t, z, force):
        return {"x": z.x, "v": z.v, "angle": z.angle, "rate": z.rate, "effort": force**2, "force": force}


def crane(intervals: int = 20, **options: Any) -> al.Problem:
    """Carry a swinging load one metre and leave it still, on average, whatever the rope's length is."""
    defaults: dict[str, Any] = {
        "grid": al.Grid(2.0, intervals),
        "inputs": {"force": al.BSpline(al.Decision(np.zeros(8), -20.0, 20.0), degree=3)},
        "minimize": al.integral("effort").mean,
        "subject_to": [
            al.terminal("x").mean.equals(1.0),
            al.terminal("v").mean.equals(0.0),
            al.terminal("angle").mean.equals(0.0),
            al.terminal("rate").mean.equals(0.0),
            al.path("angle").within(-0.5, 0.5, sigmas=2.0),
        ],
        "expansion": al.Expansion(order=2),
    }
    return al.Problem(
        Cart(length=al.Uniform(1.0, half_width=0.1), mass=al.Uniform(0.3, half_width=0.05)), **(defaults | options)
    )


def free_force(**options: Any) -> al.BSpline:
    return al.BSpline(al.Decision(np.linspace(1.0, -1.0, 5), -20.0, 20.0), degree=2, **options)


def everything(force: al.BSpline | None = None) -> al.Problem:
    """A final time, a damper, a spread and a motion to choose, and every kind of functional."""
    return al.Problem(
        Cart(
            length=al.Uniform(1.0, half_width=al.Decision(0.1, 0.02, 0.2)),
            mass=al.Normal(0.3, std=0.02),
            damping=al.Decision(0.4, 0.0, 2.0),
        ),
        grid=al.Grid(al.Decision(1.5, 0.5, 4.0), 6),
        inputs={"force": force or free_force()},
        minimize=al.objectives.final_time() + 0.1 * al.rms("force").mean + al.integral("effort").std,
        subject_to=[
            al.terminal("x").mean.equals(0.4),
            al.path("angle").within(-0.5, 0.5, sigmas=1.5),
            al.peak("rate").at_most(6.0, sigmas=1.0),
            al.objectives.norm(al.terminal("v").mean, al.terminal("rate").std) <= 3.0,
            al.covariance(al.path("x"), al.path("v")) <= 5.0,
            al.value("length.half_width") >= 0.05,
        ],
        expansion=al.Expansion(order=2),
    )


def integrated() -> al.Problem:
    """Statistics that are integrated over time: alone, in a norm, within a limit, and beside others."""
    problem = everything()
    return al.Problem(
        problem.system,
        grid=problem.grid,
        inputs=problem.inputs,
        minimize=al.objectives.coefficient_power({"force": "v"}, smoothing=0.1) + 0.1 * al.rms("force").mean,
        subject_to=[
            al.terminal("x").mean.equals(0.4),
            al.objectives.norm(al.time_integral(al.path("angle").variance), al.terminal("v").mean) <= 3.0,
            al.time_integral(al.path("x").mean + al.path("rate").variance) + 2.0 * al.terminal("rate").variance <= 9.0,
            al.path("angle").within(-0.5, 0.5, sigmas=1.5),
        ],
        expansion=problem.expansion,
    )


def oscillator(**options: Any) -> al.Problem:
    """See `tiny_models.oscillator_problem`, on a grid that is fine enough."""
    return oscillator_problem(grid=al.Grid(4.0, 250), **options)
