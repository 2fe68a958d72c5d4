"""`InverseDynamics`: motion is given, torques follow by algebra (equation 69). Nothing is integrated."""

from collections.abc import Collection, Mapping
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from aleator._core.errors import ProblemError
from aleator.dynamics import Grid, System
from aleator.mechanics._actuation import Actuation, actuation_of, torques
from aleator.mechanics._given import Given, asks_torque_rates, combined_motion, followed, motions_for
from aleator.mechanics._kinematics import Followed, follow
from aleator.mechanics._mechanical import AbstractMechanical, actuation_map
from aleator.mechanics._motion import Motion
from aleator.mechanics._outputs import standard_outputs
from aleator.mechanics._trouble import trouble_at, trouble_of_path
from aleator.trajectories import AbstractSignal, AbstractTrajectory


@final
class InverseDynamics(System):
    """A mechanical system on a prescribed motion: `τ = B⁻¹ (M v̇ + C v + N)` (Table 5.2: motion known, τ not).

    - `model`: a fully actuated mechanical system; of an over-actuated one the torques of least norm are found;
    - `motion`: a trajectory of all coordinates, or one by name;
    - `torque_rates`: whether the rates of torques are among the outputs.

    Each system of the family follows the same motion, and needs torques of its own. The motion is part of the system:
    its control points are called `motion.free`. Raises `ProblemError` for motions of what the model does not have, and
    for models with fewer torques than velocities.
    """

    model: AbstractMechanical
    motion: Given
    torque_rates: bool = eqx.field(static=True)

    states: ClassVar[tuple[str, ...]] = ()
    signal_fields: ClassVar[tuple[str, ...]] = ("motion",)

    def __init__(self, model: AbstractMechanical, *, motion: Any, torque_rates: bool = True):
        self.model = model
        self.torque_rates = torque_rates
        self.motion = motions_for(model.coordinates, motion, "InverseDynamics, motion")
        if len(model.actuators) < len(model.speeds):
            raise ProblemError(self._unrealisable("under-actuated"))

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """The units that the model declares, and those that its kind tells."""
        return {**self.model.standard_units, **self.model.units}

    def signals(self) -> Mapping[str, AbstractSignal]:
        """See `System.signals`."""
        return followed(self._motion(), self.torque_rates)

    def focused(self, only: Collection[str]) -> "InverseDynamics":
        """See `System.focused`: torque rates take a further derivative of everything."""
        asked = asks_torque_rates(self.model, only)
        return InverseDynamics(self.model, motion=self.motion, torque_rates=asked)

    def rhs(self, t: Any, z: Any) -> tuple[()]:
        """See `System.rhs`: nothing is integrated."""
        del t, z
        return ()

    def outputs(
        self, t: Any, z: Any, position: Array, velocity: Array, acceleration: Array, jolt: Array | None = None
    ) -> dict[str, Any]:
        """See `System.outputs`."""
        del z

        def found(*at: Array) -> tuple[Array, Followed]:
            path = follow(self.model, *at)
            force = self.model.inverse_dynamics(path.q, path.v, path.v_dot)
            return torques(self.model, path.q, force), path

        at = position, velocity, acceleration
        if jolt is None:
            torque, path = found(*at)
            return standard_outputs(self.model, _motion_at(t, path, torque), None)
        torque, torque_rate, path = jax.jvp(found, at, (velocity, acceleration, jolt), has_aux=True)
        return standard_outputs(self.model, _motion_at(t, path, torque), torque_rate)

    def trouble(self, grid: Grid) -> str:
        """See `System.trouble`."""
        model, path = self.model, self._motion().sampled(grid.fractions, grid.t_start, grid.t_final)
        q = model.normalised(path[0])
        if found := trouble_at(model, q, "at the start"):
            return found
        scheme = actuation_of(model, q)
        if scheme not in (Actuation.FULL, Actuation.OVER):
            return self._unrealisable(scheme.value)
        effects = None if model.acts_directly else jax.vmap(lambda at: actuation_map(model, model.normalised(at)))(path)
        return trouble_of_path(model, np.asarray(grid.times), path, effects)

    def holding(self, grid: Grid) -> Mapping[str, Any]:
        """See `System.holding`: the torques, where the motion starts at rest and without acceleration."""
        at = [self._motion().derivative(k).sampled(np.zeros(1), grid.t_start, grid.t_final)[0] for k in range(3)]
        start = follow(self.model, *at)
        if jnp.any(jnp.abs(jnp.stack([start.v, start.v_dot])) > 1e-9):
            return {}
        force = self.model.inverse_dynamics(start.q, start.v, start.v_dot)
        return dict(zip(self.model.actuators, torques(self.model, start.q, force), strict=True))

    def _unrealisable(self, scheme: str) -> str:
        return (
            f"InverseDynamics: {type(self.model).__name__} is {scheme}: its torques "
            f"({', '.join(self.model.actuators) or 'none'}) cannot realise any motion of all its coordinates "
            f"({', '.join(self.model.coordinates)}). Use al.HybridDynamics, which prescribes as many coordinates as "
            "there are torques, or al.ForwardDynamics."
        )

    def _motion(self) -> AbstractTrajectory:
        return combined_motion(self.model.coordinates, self.motion)


def _motion_at(t: Any, path: Followed, torque: Array) -> Motion:
    q, q_dot, q_ddot, v, v_dot = path
    return Motion(t, q, q_dot, q_ddot, v, v_dot, torque)
