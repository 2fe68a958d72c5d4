"""Problems to be transcribed both ways, of small models: with all that a problem may be made of."""

from typing import Any

import jax.numpy as jnp
import numpy as np

import aleator as al
from aleator.transcription import transcribe
from zoo import Tank


class Swing(al.System):
    """A pendulum that a torque turns; upside down it is one with a negative gravity."""

    states = ("angle", "rate")

    length: al.Number = 1.0
    mass: al.Number = 1.0
    damping: al.Number = 0.0
    gravity: al.Number = 9.81
    first: al.Number = 0.0

    def rhs(self, t, z, torque):
        push = (torque - self.damping * z.rate) / (self.mass * self.length**2)
        return z.rate, push - self.gravity / self.length * jnp.sin(z.angle)

    def outputs(self, t, z, torque):
        return {"angle": z.angle, "rate": z.rate, "effort": torque**2, "torque": torque}

    def initial(self):
        return {"angle": self.first}


class Regulated(al.System):
    """`x' = -x / lag + u`."""

    states = ("x",)
    lag: al.Number = 1.0
    first: al.Number = 1.0

    def rhs(self, t, z, u):
        return (-z.x / self.lag + u,)

    def outputs(self, t, z, u):
        return {"cost": z.x**2 + u**2}

    def initial(self):
        return {"x": self.first}


def robustly_fed(steps: int) -> al.Problem:
    """The feed that brings the hydrogen of an uncertain tank near 0.2, within a limit for two standard deviations."""
    tank = Tank(constant=al.Uniform(0.1, half_width=0.01), rate=al.Uniform(1.0, half_width=0.1))
    return al.Problem(
        tank,
        grid=al.Grid(2.0, steps),
        inputs={"feed": al.BSpline(al.Decision(np.full(5, 0.5), 0.0, 5.0), degree=2)},
        minimize=al.integral("miss").mean,
        subject_to=[al.path("hydrogen").at_most(0.18, sigmas=2.0), al.terminal("acid").mean >= 0.45],
        expansion=al.Expansion(order=2),
    )


def free_torque(**options: Any) -> al.BSpline:
    return al.BSpline(al.Decision(np.linspace(1.0, -1.0, 5), -20.0, 20.0), degree=2, **options)


def everything(torque: al.BSpline | None = None, **options: Any) -> al.Problem:
    """A final time, a damper, a spread and a motion to choose, and every kind of functional."""
    angle, rate = al.terminal("angle"), al.terminal("rate")
    defaults: dict[str, Any] = {
        "minimize": al.objectives.final_time() + 0.1 * al.rms("torque").mean + al.integral("effort").std,
        "subject_to": [
            angle.mean.equals(0.4),
            al.path("angle").within(-0.5, 0.5, sigmas=1.5),
            al.peak("rate").at_most(6.0, sigmas=1.0),
            al.objectives.norm(angle.mean, rate.std) <= 3.0,
            al.covariance(al.path("angle"), al.path("rate")) <= 5.0,
            al.value("length.half_width") >= 0.05,
        ],
    }
    swing = Swing(
        length=al.Uniform(1.0, half_width=al.Decision(0.1, 0.02, 0.2)),
        mass=al.Normal(1.0, std=0.02),
        damping=al.Decision(0.4, 0.0, 2.0),
    )
    return al.Problem(
        swing,
        grid=al.Grid(al.Decision(1.5, 0.5, 4.0), 6),
        inputs={"torque": torque or free_torque()},
        expansion=al.Expansion(order=2),
        **(defaults | options),
    )


def integrated() -> al.Problem:
    """Statistics that are integrated over time: alone, in a norm, within a limit, and beside others."""
    angle, rate = al.path("angle"), al.path("rate")
    both = al.time_integral(angle.mean + rate.variance) + 2.0 * al.terminal("rate").variance
    return everything(
        minimize=al.objectives.coefficient_power({"torque": "rate"}, smoothing=0.1) + 0.1 * al.rms("torque").mean,
        subject_to=[
            al.terminal("angle").mean.equals(0.4),
            al.objectives.norm(al.time_integral(angle.variance), al.terminal("rate").mean) <= 3.0,
            both <= 9.0,
            angle.within(-0.5, 0.5, sigmas=1.5),
        ],
    )


def states_at_start(problem: al.Problem, guess: Any) -> tuple[np.ndarray, np.ndarray]:
    """The states of all realisations at the first point of a program, and the instants, s."""
    found = transcribe(problem, al.Simultaneous(guess=guess))
    states = found.states_at(found.program.start)
    assert states is not None
    return np.stack(list(states.values.values()), axis=2), states.times


class VanDerPol(al.System):
    """The oscillator, pushed, that is left at one."""

    states = ("x1", "x2")

    def rhs(self, t, z, u):
        return (1 - z.x2**2) * z.x1 - z.x2 + u, z.x1

    def outputs(self, t, z, u):
        return {"cost": z.x1**2 + z.x2**2 + u**2}

    def initial(self):
        return {"x2": 1.0}
