"""A robust crane with many collocation points, transcribed simultaneously: CPU time per iteration by two solvers.

    python benchmarks/many_scenarios.py [POINTS ...]

Carry a swinging load one metre and leave it still, on average and with little spread, whatever the rope's length and
the load's mass are: four states, a hundred intervals. `Condensing` and IPOPT (MUMPS) solve the same program in the same
process. Times are CPU seconds of the whole process, so that other programs on the machine matter little.
"""

import resource
import sys
import time
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

import aleator as al
from aleator.nlp import AbstractSolver, Condensing, Ipopt, NonlinearProgram, Outcome
from aleator.transcription import transcribe

POINTS = (20, 50, 100, 200, 500)


class Crane(al.System):
    """A cart with a pendulum, pushed by a force."""

    states = ("x", "v", "angle", "rate")

    length: Any = 1.0
    mass: Any = 0.3

    def rhs(self, t: Any, z: Any, force: Any) -> Any:
        """Newton's law along the rail and about the pivot."""
        del t
        sine, cosine = jnp.sin(z.angle), jnp.cos(z.angle)
        push = force + self.mass * sine * (self.length * z.rate**2 + 9.81 * cosine)
        acceleration = push / (1.0 + self.mass * sine**2)
        return z.v, acceleration, z.rate, -(acceleration * cosine + 9.81 * sine) / self.length

    def outputs(self, t: Any, z: Any, force: Any) -> Any:
        """What the problem speaks of."""
        del t
        return {"x": z.x, "v": z.v, "angle": z.angle, "rate": z.rate, "effort": force**2}


def crane(points: int) -> al.Problem:
    """The problem with so many collocation points."""
    return al.Problem(
        Crane(length=al.Uniform(1.0, half_width=0.1), mass=al.Uniform(0.3, half_width=0.05)),
        grid=al.Grid(2.0, 100),
        inputs={"force": al.BSpline(al.Decision(np.zeros(16), -20.0, 20.0), degree=3)},
        minimize=al.integral("effort").mean + 1e5 * al.objectives.terminal_variance("angle", "rate"),
        subject_to=[
            al.terminal("x").mean.equals(1.0),
            al.terminal("v").mean.equals(0.0),
            al.terminal("angle").mean.equals(0.0),
            al.terminal("rate").mean.equals(0.0),
        ],
        expansion=al.Expansion(order=2, points=al.points.SobolPoints(points)),
    )


class Clock:
    """Adds up the CPU time of some calls."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def timed(self, function: Any) -> Any:
        """The same function."""

        def call(*arguments: Any) -> Any:
            began = time.process_time()
            try:
                return function(*arguments)
            finally:
                self.seconds += time.process_time() - began

        return call


def measured(solver: AbstractSolver, program: NonlinearProgram) -> tuple[Outcome, float, float]:
    """The outcome, with the CPU seconds spent in all and in the model."""
    clock = Clock()
    assert program.hessian is not None
    timed = replace(
        program,
        evaluate=clock.timed(program.evaluate),
        hessian=program.hessian._replace(evaluate=clock.timed(program.hessian.evaluate)),
    )
    began = time.process_time()
    outcome = solver.solve(timed)
    return outcome, time.process_time() - began, clock.seconds


def main() -> None:
    """Print the table and the exponents."""
    counts = [int(one) for one in sys.argv[1:]] or list(POINTS)
    each: dict[str, list[float]] = {}
    for count in counts:
        program = transcribe(crane(count), al.Simultaneous()).program
        assert program.hessian is not None
        # Compiled before the clock starts.
        program.evaluate(program.start)
        program.hessian.evaluate(program.start, 1.0, np.zeros(program.constraint_lower.size))
        objectives = []
        for solver in (Condensing(), Ipopt()):
            outcome, seconds, model = measured(solver, program)
            name, steps = type(solver).__name__, max(outcome.iterations, 1)
            each.setdefault(name, []).append(seconds / steps)
            objectives.append(outcome.evaluation.objective)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            print(
                f"{count:4d} points  {program.start.size:6d} variables  {name:<10} {outcome.status.name:<8} "
                f"{outcome.iterations:3d} iterations  {1e3 * seconds / steps:7.1f} ms each: model "
                f"{1e3 * model / steps:6.1f}, the rest {1e3 * (seconds - model) / steps:7.1f}  objective "
                f"{outcome.evaluation.objective:.9g}  peak so far {peak:.2f} GiB  {outcome.message}",
                flush=True,
            )
        print(f"      objectives differ by {abs(objectives[0] / objectives[1] - 1):.1e} of their size", flush=True)
    if len(counts) > 1:
        for name, times in each.items():
            exponent = np.polyfit(np.log(counts), np.log(times), 1)[0]
            print(f"{name}: time per iteration grows with points to the power {exponent:.2f}")


if __name__ == "__main__":
    main()
