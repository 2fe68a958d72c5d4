"""Swing-up of a double pendulum that only its first joint drives: hybrid dynamics (dissertation, section 5.5.3).

The first joint follows a B-spline exactly; the second swings as it must, differently for each mass of the second link,
and the torque that the first joint takes follows. The robust plan brings the mean of the family up, keeps the spread
of the torque within its limits and that of the tip at the end small (81), (92).

The viscous damping at the joints matters: without it the passive motion would not depend on the second link's mass at
all, and any motion of positive power would exchange the same energy.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import aleator as al

MASS_2 = al.Uniform(1.0, std=0.1)
TORQUE = 10.0
VARIANCE = 0.01
"""Largest norm of the tip's variances at the end, m²."""

STEPS = 150
FREE = 12
DEGREE = 5
ENDS: dict[str, Any] = {"start": (-np.pi, 0.0), "end": (0.0, 0.0)}
"""The first joint hangs at rest and ends upright at rest."""


class DoublePendulum(al.Mechanical):
    """Two uniform rods under gravity with viscous friction at both joints; only the first joint has a torque.

    `q1` is measured from upright, `q2` from the first link. The inertia of the second link scales with its mass.
    """

    names = ("q1", "q2")
    actuator_names = ("q1_torque",)
    units: ClassVar = {
        "q1": "rad",
        "q2": "rad",
        "q1_rate": "rad/s",
        "q2_rate": "rad/s",
        "q1_torque": "N m",
        "tip_x": "m",
        "tip_y": "m",
    }

    mass_1: al.Number = al.parameter("kg", positive=True, default=1.0)
    mass_2: al.Number = al.parameter("kg", positive=True, default=1.0)
    length_1: al.Number = al.parameter("m", positive=True, default=0.5)
    length_2: al.Number = al.parameter("m", positive=True, default=1.0)
    damping: al.Number = al.parameter("N m s/rad", default=0.1)
    gravity: al.Number = al.parameter("m/s²", default=9.81)

    def mass_matrix(self, q: Float[Array, " 2"]) -> Float[Array, "2 2"]:
        """`M(q)`, kg m²."""
        l_1, l_2 = self.length_1, self.length_2
        inner = (self.mass_1 / 3 + self.mass_2) * l_1**2
        outer = self.mass_2 * l_2**2 / 3
        coupling = self.mass_2 * l_1 * l_2 / 2 * jnp.cos(q[1])
        return jnp.array([[inner + outer + 2 * coupling, outer + coupling], [outer + coupling, outer]])

    def coriolis(self, q: Float[Array, " 2"], v: Float[Array, " 2"]) -> Float[Array, "2 2"]:
        """`C(q, v)`, kg m²/s."""
        h = self.mass_2 * self.length_1 * self.length_2 / 2 * jnp.sin(q[1])
        return jnp.array([[-h * v[1], -h * (v[0] + v[1])], [h * v[0], 0.0]])

    def forces(self, q: Float[Array, " 2"], v: Float[Array, " 2"]) -> Float[Array, " 2"]:
        """Friction and weight, N m: upright, both links are in unstable balance."""
        outer = self.mass_2 * self.length_2 / 2 * jnp.sin(q[0] + q[1])
        inner = (self.mass_1 / 2 + self.mass_2) * self.length_1 * jnp.sin(q[0])
        return self.damping * v - self.gravity * jnp.array([inner + outer, outer])

    def actuation(self, q: Float[Array, " 2"]) -> Float[Array, "2 1"]:
        """Only the first joint is driven."""
        return jnp.array([[1.0], [0.0]])

    def outputs(self, motion: al.Motion) -> dict[str, Any]:
        """Where the tip is, from the first joint, m."""
        first, second = motion.q[0], motion.q[0] + motion.q[1]
        return {
            "tip_x": -self.length_1 * jnp.sin(first) - self.length_2 * jnp.sin(second),
            "tip_y": self.length_1 * jnp.cos(first) + self.length_2 * jnp.cos(second),
        }


POWER = {"q1_torque": "q1_rate"}
TIP = ("tip_x", "tip_y")


def deterministic_problem(
    *, guess: np.ndarray | None = None, duration: float = 5.0, smoothing: float = 0.0
) -> al.Problem:
    """The swing-up that exchanges the least energy, for the mean pendulum (74)."""
    plan = _plan(DoublePendulum(mass_2=MASS_2), guess)
    return al.deterministic(_problem(plan, al.power(POWER, smoothing=smoothing), 0.0, [], duration))


def robust_problem(
    sigmas: float = 1.0,
    *,
    expected: str = "torque",
    guess: np.ndarray | None = None,
    duration: float = 5.0,
    mass_2: al.Uniform = MASS_2,
) -> al.Problem:
    """The swing-up that exchanges the least energy and holds for the family (81), (92).

    `expected`: whether the energy is that of the expected torque (`"torque"`, the sum that (83) prints: the first
    joint's rate is certain) or the expected energy (`"energy"`).
    """
    objective = al.coefficient_power(POWER) if expected == "torque" else al.power(POWER)
    plan = _plan(DoublePendulum(mass_2=mass_2), guess)
    spread = (al.terminal_variance(*TIP) <= VARIANCE).named("terminal variance")
    return _problem(plan, objective, sigmas, [spread], duration)


def _plan(pendulum: DoublePendulum, guess: np.ndarray | None) -> al.HybridDynamics:
    points = first_guess() if guess is None else guess
    motion = al.BSpline(al.Decision(points, -12.0, 12.0), degree=DEGREE, **ENDS)
    return al.HybridDynamics(pendulum, motion={"q1": motion})


def _problem(
    plan: al.HybridDynamics,
    objective: al.Expression,
    sigmas: float,
    limits: list[al.Constraint],
    duration: float,
) -> al.Problem:
    return al.Problem(
        plan,
        grid=al.Grid(al.Decision(duration, 2.0, 8.0), STEPS),
        minimize=objective,
        subject_to=[
            al.path("q1_torque").within(-TORQUE, TORQUE, sigmas=sigmas),
            *(al.terminal(name).mean.equals(0.0) for name in ("q2", "q2_rate")),
            *limits,
        ],
        expansion=al.Expansion(order=5),
    )


def first_guess() -> np.ndarray:
    """Control points of a few swings of growing width."""
    fractions = np.linspace(0.0, 1.0, 80)
    swing = -np.pi * (1 - fractions**2) + 0.8 * np.sin(3 * np.pi * fractions) * fractions
    return al.fit_control_points(swing, FREE, degree=DEGREE, **ENDS)
