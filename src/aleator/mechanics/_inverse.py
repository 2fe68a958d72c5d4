"""`InverseDynamics`: the motion is given, torques follow algebraically (equation 69). Nothing is integrated."""

from collections.abc import Collection, Mapping
from typing import Any, ClassVar, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.dynamics import Grid
from aleator.mechanics._actuation import Actuation, actuation_of, torques
from aleator.mechanics._diagnosis import diagnosis_at, diagnosis_of_path
from aleator.mechanics._formulation import AbstractFormulation, model_given
from aleator.mechanics._given import Given, asks_torque_rates, combined_motion, followed, motions_for
from aleator.mechanics._instant import along_time, at, course, instants_of
from aleator.mechanics._kinematics import Followed, follow
from aleator.mechanics._mechanical import AbstractMechanical, actuation_map, required_force
from aleator.mechanics._motion import Motion
from aleator.mechanics._outputs import standard_outputs
from aleator.trajectories import AbstractSignal, AbstractTrajectory


@final
class InverseDynamics(AbstractFormulation):
    """A mechanical system on a prescribed motion: `τ = B⁻¹ (M v̇ + C v + N - Q)` (table 5.2: known motion).

    - `model`: a fully actuated mechanical system, or an over-actuated one, for which the torques of least norm are
      found;
    - `motion`: one trajectory of all coordinates, or one for each by name;
    - `torque_rates`: whether the rates of torques are among the outputs.

    Every realisation follows the same motion, with its own torques. The motion is part of the system: its control
    points are named `motion.free`. Raises `ProblemError` for motions of unknown coordinates, and for models with fewer
    torques than velocities.
    """

    model: AbstractMechanical
    motion: Given
    torque_rates: bool = eqx.field(static=True)

    states: ClassVar[tuple[str, ...]] = ()
    signal_fields: ClassVar[tuple[str, ...]] = ("motion",)

    def __init__(self, model: AbstractMechanical, *, motion: Any, torque_rates: bool = True):
        self.model = model_given("InverseDynamics", model)
        self.torque_rates = torque_rates
        self.motion = motions_for(model.coordinates, motion, "InverseDynamics, motion")
        if len(model.actuators) < len(model.speeds):
            raise ProblemError(self._unrealisable("under-actuated"))

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """The units that the model declares, and the standard units of its kind."""
        return {**self.model.standard_units, **self.model.units}

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        return {**followed(self._motion(), self.torque_rates), **course(self.model, 2 + self.torque_rates)}

    @override
    def focused(self, only: Collection[str]) -> "InverseDynamics":
        """Without torque rates where they are not asked for: they need one more derivative of everything."""
        asked = asks_torque_rates(self.model, only)
        return InverseDynamics(self.model, motion=self.motion, torque_rates=asked)

    @override
    def rhs(self, t: Any, z: Any) -> tuple[()]:
        """Nothing is integrated."""
        del t, z
        return ()

    @override
    def outputs(
        self,
        t: Any,
        z: Any,
        position: Array,
        velocity: Array,
        acceleration: Array,
        jerk: Array | None = None,
        parameters: Array | None = None,
    ) -> dict[str, Any]:
        del z
        model, curve = at(self.model, t, parameters), (position, velocity, acceleration)
        if jerk is None:
            torque, path = _torques(model, *curve)
            return standard_outputs(model, _motion_at(t, path, torque), None)
        along = velocity, acceleration, jerk
        torque, torque_rate, path = along_time(_torques, model, curve, along, has_aux=True)
        return standard_outputs(model, _motion_at(t, path, torque), torque_rate)

    @override
    def diagnose(self, grid: Grid) -> str:
        now, path = instants_of(self.model, grid), self._motion().sampled(grid.fractions, grid.t_start, grid.t_final)
        model = now.at(0)
        q = model.normalised(path[0])
        if found := diagnosis_at(model, q, "at the start"):
            return found
        scheme = actuation_of(model, q)
        if scheme not in (Actuation.FULL, Actuation.OVER):
            return self._unrealisable(scheme.value)
        effects = None if model.acts_directly else now.each(lambda one, q: actuation_map(one, one.normalised(q)), path)
        return diagnosis_of_path(now, path, effects)

    @override
    def holding(self, grid: Grid) -> Mapping[str, Any]:
        """The holding torques, where the motion starts at rest and without acceleration."""
        curve = [self._motion().derivative(k).sampled(np.zeros(1), grid.t_start, grid.t_final)[0] for k in range(3)]
        torque, start = _torques(instants_of(self.model, grid).at(0), *curve)
        if jnp.any(jnp.abs(jnp.stack([start.v, start.v_dot])) > 1e-9):
            return {}
        return dict(zip(self.model.actuators, torque, strict=True))

    def _unrealisable(self, scheme: str) -> str:
        return (
            f"InverseDynamics: {type(self.model).__name__} is {scheme}: its torques "
            f"({', '.join(self.model.actuators) or 'none'}) cannot realise any motion of all its coordinates "
            f"({', '.join(self.model.coordinates)}). Use al.HybridDynamics, which prescribes as many coordinates as "
            "there are torques, or al.ForwardDynamics."
        )

    def _motion(self) -> AbstractTrajectory:
        return combined_motion(self.model.coordinates, self.motion)


def _torques(
    model: AbstractMechanical, position: Array, velocity: Array, acceleration: Array
) -> tuple[Array, Followed]:
    """The torques that a motion requires, and the motion."""
    path = follow(model, position, velocity, acceleration)
    return torques(model, path.q, required_force(model, path.q, path.v, path.v_dot)), path


def _motion_at(t: Any, path: Followed, torque: Array) -> Motion:
    q, q_dot, q_ddot, v, v_dot = path
    return Motion(t, q, q_dot, q_ddot, v, v_dot, torque)
