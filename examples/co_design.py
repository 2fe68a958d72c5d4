"""An arm, its counterweight, its fastest motion and the tolerance of its payload, decided together.

A lifting arm with one joint carries a payload whose mass the supplier keeps within a tolerance. A tighter tolerance
costs more; a longer counterweight arm balances the payload better but has to be moved as well. The motion is a B-spline
from rest to rest. The objective is the total cost of time, of the tolerance, and of the counterweight.

    python examples/co_design.py
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

import aleator as al


class Lift(al.Lagrangian):
    """A beam on a joint: the payload on one side, a counterweight on the other; `angle` is measured from horizontal."""

    names = ("angle",)
    units: ClassVar = {"angle_torque": "N m", "height": "m"}

    payload: al.Number = al.parameter("kg", positive=True)
    reach: al.Number = al.parameter("m", positive=True)
    counterweight: al.Number = al.parameter("kg", positive=True)
    lever: al.Number = al.parameter("m", positive=True)

    def kinetic_energy(self, q: Any, v: Any) -> Any:
        """Both masses and a slender beam of 0.5 kg/m turn with the joint."""
        beam = 0.5 * (self.reach**3 + self.lever**3) / 3
        return (self.payload * self.reach**2 + self.counterweight * self.lever**2 + beam) * v[0] ** 2 / 2

    def potential_energy(self, q: Any) -> Any:
        """The payload rises as the counterweight descends."""
        return 9.81 * (self.payload * self.reach - self.counterweight * self.lever) * jnp.sin(q[0])

    def outputs(self, motion: al.Motion) -> dict[str, Any]:
        """The height of the payload, m."""
        return {"height": self.reach * jnp.sin(motion.q[0])}


ends: dict[str, Any] = {"start": (-0.6, 0.0), "end": (0.9, 0.0)}
lift = Lift(
    payload=al.Uniform(4.0, half_width=al.Decision(0.4, 0.05, 1.5)),
    reach=al.Decision(0.9, 0.7, 1.2),
    counterweight=6.0,
    lever=al.Decision(0.4, 0.1, 0.8),
)
motion = al.BSpline(al.Decision(al.fit_control_points(np.linspace(-0.6, 0.9, 40), 6, **ends), -1.5, 1.5), **ends)
problem = al.Problem(
    al.InverseDynamics(lift, motion={"angle": motion}),
    grid=al.Grid(al.Decision(1.5, 0.2, 5.0), steps=56),
    minimize=2.0 * al.objectives.final_time()
    + al.cost.reciprocal("payload.half_width", bias=0.0, scale=0.05)
    + 0.5 * al.value("lever"),
    subject_to=[
        al.path("angle_torque").within(-12.0, 12.0, worst_case=True),
        al.path("angle_rate").within(-4.0, 4.0),
        al.terminal("height").mean >= 0.7,
    ],
    expansion=al.Expansion(order=1),
)

if __name__ == "__main__":
    solution = al.solve(problem)
    print(problem)
    print(solution)
    print(al.validate(solution, samples=2000))
