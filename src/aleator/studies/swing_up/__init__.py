"""Swing-up of a double pendulum driven only at its first joint: hybrid dynamics (dissertation, section 5.5.3).

The first joint follows a B-spline exactly; the motion of the second follows from the dynamics, differently for each
mass of the second link, as does the torque of the first joint. The robust plan swings the mean of the family up, keeps
mean and spread of the torque within its limits, and bounds the spread of the tip at the end (81), (92).

The viscous damping at the joints matters: without it the passive motion would not depend on the second link's mass at
all, and any motion of positive power would exchange the same energy.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import aleator as al
from aleator.studies.two_link_arm import TwoLinks

MASS_2 = al.Uniform(1.0, std=0.1)
TORQUE = 10.0
VARIANCE = 0.01
"""Largest norm of the tip's variances at the end, m²."""

STEPS = 450
FREE = 12
DEGREE = 5
ENDS: dict[str, Any] = {"start": (-np.pi, 0.0), "end": (0.0, 0.0)}
"""The first joint hangs at rest and ends upright at rest."""


SMOOTHING = 0.01
"""W: the magnitude of a power has a kink wherever the power changes sign, where a search stalls. Rounding the kink
lowers the energy by at most this many joules per second.
"""

SWINGS = (-3.208, -3.3414, -3.3707, -2.342, -4.0307, -3.1935, -1.6233, -4.9035, -4.0438, 1.0433, -0.8108, 0.3314)
DURATION = 7.5558
FAMILY_SWINGS = (-2.866, -2.461, -3.128, -4.033, -3.458, -1.564, -3.278, -4.843, -3.604, 0.934, -0.696, 0.415)
FAMILY_DURATION = 6.36
"""Where the searches start, for the mean pendulum and for the family: the best of local searches from many swings at
random, most of which end elsewhere or nowhere. `benchmarks/swing_up_starts.py` searches in this way."""


class DoublePendulum(TwoLinks):
    """Two uniform rods under gravity with viscous friction at both joints; only the first joint has a torque.

    `q1` is measured from upright. The inertia of the second link scales with its mass.
    """

    actuator_names = ("q1_torque",)
    units: ClassVar = {
        **dict.fromkeys(TwoLinks.names, "rad"),
        **dict.fromkeys(("q1_rate", "q2_rate"), "rad/s"),
        "q1_torque": "N m",
        **dict.fromkeys(("tip_x", "tip_y"), "m"),
    }

    length_1: al.Number = al.parameter("m", positive=True, default=0.5)
    damping: al.Number = al.parameter("N m s/rad", default=0.1)
    gravity: al.Number = al.parameter("m/s²", default=9.81)

    def forces(self, q: Float[Array, " 2"], v: Float[Array, " 2"]) -> Float[Array, " 2"]:
        """Friction and weight, N m: both links are in unstable equilibrium when upright."""
        outer = self.mass_2 * self.length_2 / 2 * jnp.sin(q[0] + q[1])
        inner = (self.mass_1 / 2 + self.mass_2) * self.length_1 * jnp.sin(q[0])
        return self.damping * v - self.gravity * jnp.array([inner + outer, outer])

    def actuation(self, q: Float[Array, " 2"]) -> Float[Array, "2 1"]:
        """Only the first joint is driven."""
        return jnp.array([[1.0], [0.0]])

    def outputs(self, motion: al.Motion) -> dict[str, Any]:
        """The position of the tip relative to the first joint, m."""
        first, second = motion.q[0], motion.q[0] + motion.q[1]
        elbow = self.length_1 * jnp.array([-jnp.sin(first), jnp.cos(first)])
        tip = elbow + self.length_2 * jnp.array([-jnp.sin(second), jnp.cos(second)])
        return {"tip_x": tip[0], "tip_y": tip[1]}


POWER = {"q1_torque": "q1_rate"}
TIP = ("tip_x", "tip_y")


def deterministic_problem() -> al.Problem:
    """The swing-up with minimum energy exchange, for the mean pendulum (74)."""
    return al.deterministic(_problem(al.objectives.power(POWER, smoothing=SMOOTHING), 0.0, np.array(SWINGS), DURATION))


def robust_problem(
    sigmas: float = 1.0,
    *,
    expected: str = "torque",
    guess: np.ndarray | None = None,
    duration: float = FAMILY_DURATION,
) -> al.Problem:
    """The swing-up with minimum energy exchange for the family (81), (92).

    `expected`: minimise the energy of the expected torque (`"torque"`, the sum in (83), since the first joint's rate is
    certain) or the expected energy (`"energy"`).
    """
    energy = al.objectives.coefficient_power if expected == "torque" else al.objectives.power
    spread = (al.objectives.terminal_variance(*TIP) <= VARIANCE).named("terminal variance")
    points = np.array(FAMILY_SWINGS) if guess is None else guess
    return _problem(energy(POWER, smoothing=SMOOTHING), sigmas, points, duration, spread)


def _problem(
    objective: al.Expression, sigmas: float, points: np.ndarray, duration: float, *limits: al.Constraint
) -> al.Problem:
    motion = al.BSpline(al.Decision(points, -12.0, 12.0), degree=DEGREE, **ENDS)
    return al.Problem(
        al.HybridDynamics(DoublePendulum(mass_2=MASS_2), motion={"q1": motion}),
        grid=al.Grid(al.Decision(duration, 2.0, 8.0), STEPS),
        minimize=objective,
        subject_to=[
            al.path("q1_torque").within(-TORQUE, TORQUE, sigmas=sigmas).named("torque"),
            *(al.terminal(name).mean.equals(0.0).named("upright") for name in ("q2", "q2_rate")),
            *limits,
        ],
        expansion=al.Expansion(order=5),
    )
