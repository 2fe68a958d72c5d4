"""Uncertain parameters, an uncertain initial condition and a tolerance to choose, in one small problem.

A drawer closes against a damper. Its mass varies with what is inside, its starting speed with the hand that pushes
it, and the damper with its manufacture: how exactly must the damper be made, if exactness costs?
"""

from typing import ClassVar

import aleator as al


class Drawer(al.System):
    """A mass that a damper slows down: x is the distance closed in m, v the speed."""

    states = ("x", "v")
    units: ClassVar = {"closed": "m", "speed": "m/s"}
    mass: al.Number = al.parameter("kg", positive=True)
    damping: al.Number = al.parameter("N s/m", positive=True)
    push: al.Number = al.parameter("m/s")

    def initial(self):
        """The push of the hand."""
        return {"v": self.push}

    def rhs(self, t, z):
        """Newton's law."""
        return z.v, -self.damping / self.mass * z.v

    def outputs(self, t, z):
        """Distance and speed."""
        return {"closed": z.x, "speed": z.v}


drawer = Drawer(
    mass=al.Uniform(4.0, half_width=0.5),
    damping=al.Uniform(al.Decision(8.0, 3.0, 20.0), half_width=al.Decision(0.5, 0.05, 2.0)),
    push=al.Gamma(mean=1.0, std=0.05, lower=0.5),
)
closed = al.terminal("closed")
problem = al.Problem(
    drawer,
    grid=al.Grid(t_final=3.0, steps=150),
    minimize=al.cost.reciprocal("damping.half_width", bias=1.0, scale=0.5),
    subject_to=[closed.at_least(0.35, sigmas=2.0), closed.at_most(0.65, sigmas=2.0)],
)
print(problem)
solution = al.solve(problem)
print(solution)
print(al.validate(solution, samples=20_000))
