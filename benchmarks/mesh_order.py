"""Meshes refined by dividing intervals alone, and by raising the order of the scheme where that takes fewer points.

    python benchmarks/mesh_order.py [ERROR ...]

By Radau's scheme: a robust crane, a robust oscillator, Van der Pol's oscillator with a smooth control, and with one
that is refined with the mesh, and a mass pushed with a kink in time that no node meets. For each: the points
of the last mesh, the CPU seconds of a first solution in this process, which compiles, and of a second one, the optimum,
and the meshes as intervals x stages with their errors.
"""

import sys
import time
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from typing_extensions import override

import aleator as al

ERRORS = (1e-6, 1e-9)
MOST_STAGES = 10


class Crane(al.System):
    """A cart with a pendulum, pushed by a force."""

    states = ("x", "v", "angle", "rate")

    length: Any = 1.0
    mass: Any = 0.3

    @override
    def rhs(self, t: Any, z: Any, force: Any) -> Any:
        """Newton's law along the rail and about the pivot."""
        del t
        sine, cosine = jnp.sin(z.angle), jnp.cos(z.angle)
        push = force + self.mass * sine * (self.length * z.rate**2 + 9.81 * cosine)
        acceleration = push / (1.0 + self.mass * sine**2)
        return z.v, acceleration, z.rate, -(acceleration * cosine + 9.81 * sine) / self.length

    @override
    def outputs(self, t: Any, z: Any, force: Any) -> Any:
        """What the problem speaks of."""
        del t
        return {"x": z.x, "v": z.v, "angle": z.angle, "rate": z.rate, "effort": force**2}


class Damped(al.System):
    """A mass on a spring with a damper that is to be chosen."""

    states = ("x", "v")

    stiffness: Any
    damping: Any

    @override
    def rhs(self, t: Any, z: Any) -> Any:
        del t
        return z.v, -self.stiffness * z.x - self.damping * z.v

    @override
    def outputs(self, t: Any, z: Any) -> Any:
        del t
        return {"cost": self.damping**2 + z.v**2, "back": -z.x}

    @override
    def initial(self) -> Any:
        return {"x": 1.0}


class VanDerPol(al.System):
    """Van der Pol's oscillator, to be brought to rest."""

    states = ("x1", "x2")

    @override
    def rhs(self, t: Any, z: Any, u: Any) -> Any:
        del t
        return (1 - z.x2**2) * z.x1 - z.x2 + u, z.x1

    @override
    def outputs(self, t: Any, z: Any, u: Any) -> Any:
        del t
        return {"cost": z.x1**2 + z.x2**2 + u**2}

    @override
    def initial(self) -> Any:
        return {"x2": 1.0}


class Kinked(al.System):
    """A mass against drag and a force that is sharply least at one instant."""

    states = ("x", "v")

    @override
    def rhs(self, t: Any, z: Any, u: Any) -> Any:
        return z.v, u - 5.0 * jnp.abs(t - 0.73) - 0.1 * z.v * jnp.sqrt(1 + z.v**2)

    @override
    def outputs(self, t: Any, z: Any, u: Any) -> Any:
        del t
        return {"x": z.x, "v": z.v, "cost": u**2}


def _spline(count: int, most: float) -> al.BSpline:
    return al.BSpline(al.Decision(np.linspace(0.1, -0.1, count), -most, most), degree=3)


def crane() -> al.Problem:
    """Carry the load one metre and leave it still on average, whatever the rope's length and the load are."""
    goal = {"x": 1.0, "v": 0.0, "angle": 0.0, "rate": 0.0}
    return al.Problem(
        Crane(length=al.Uniform(1.0, half_width=0.1), mass=al.Uniform(0.3, half_width=0.05)),
        grid=al.Grid(2.0, 8),
        inputs={"force": _spline(8, 20.0)},
        minimize=al.integral("effort").mean,
        subject_to=[
            *(al.terminal(name).mean.equals(value) for name, value in goal.items()),
            al.path("angle").within(-0.5, 0.5, sigmas=2.0),
        ],
        expansion=al.Expansion(order=2),
    )


def oscillator() -> al.Problem:
    """The least damped oscillators that do not swing too far to the other side."""
    damping = al.Uniform(al.Decision(1.0, 0.2, 3.0), half_width=0.1)
    return al.Problem(
        Damped(stiffness=al.Uniform(4.0, half_width=0.4), damping=damping),
        grid=al.Grid(4.0, 10),
        minimize=al.integral("cost").mean,
        subject_to=[al.path("back").at_most(0.45, sigmas=1.0)],
        expansion=al.Expansion(order=2),
    )


def van_der_pol(control: Any) -> al.Problem:
    """The least cost, which is 2.87330 for the best control of all."""
    return al.Problem(VanDerPol(), grid=al.Grid(10.0, 10), inputs={"u": control}, minimize=al.integral("cost").mean)


def kinked() -> al.Problem:
    """Move the mass one metre with the least effort."""
    return al.Problem(
        Kinked(),
        grid=al.Grid(2.0, 8),
        inputs={"u": _spline(6, 20.0)},
        minimize=al.integral("cost").mean,
        subject_to=[al.terminal("x").mean.equals(1.0), al.terminal("v").mean.equals(0.0)],
    )


PROBLEMS: dict[str, Callable[[], al.Problem]] = {
    "crane, robust": crane,
    "oscillator, robust": oscillator,
    "Van der Pol, spline": lambda: van_der_pol(_spline(13, 1.0)),
    "Van der Pol, control": lambda: van_der_pol(al.Control(np.zeros(11), -1.0, 1.0, degree=1)),
    "kinked": kinked,
}


def measured(problem: al.Problem, way: al.Simultaneous) -> str:
    """A line of the table."""
    seconds, solution = [], None
    for _ in range(2):
        begun = time.process_time()
        solution = al.solve(problem, transcription=way, between=1)
        seconds.append(time.process_time() - begun)
    assert solution is not None
    assert solution.states is not None
    history = " ".join(f"{one.intervals}x{len(one.scheme.nodes)}({one.worst:.0e})" for one in solution.meshes)
    points = len(solution.mesh_states.times)
    return f"{points:6d} points {seconds[0]:6.2f} s {seconds[1]:6.2f} s {solution.objective:.9f} | {history}"


def main() -> None:
    """Print a table for each error."""
    for error in map(float, sys.argv[1:] or ERRORS):
        for name, problem in PROBLEMS.items():
            for most in (None, MOST_STAGES):
                way = al.Simultaneous(al.schemes.Radau(3), error=error, most_stages=most)
                told = "divided" if most is None else f"to {most} stages"
                print(f"{error:.0e} {name:21} {told:13} {measured(problem(), way)}", flush=True)


if __name__ == "__main__":
    main()
