"""`ForwardDynamics`: torques are given, the motion follows by integration (equation 68)."""

from collections.abc import Mapping
from typing import Any, ClassVar, final

import jax.numpy as jnp
from jaxtyping import Array
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.dynamics import Grid
from aleator.mechanics._diagnosis import diagnosis_along, diagnosis_at
from aleator.mechanics._formulation import AbstractFormulation, model_given
from aleator.mechanics._given import Given, checked_start, combined, coordinates_at, signals_for, vector
from aleator.mechanics._instant import at, course, instants_of
from aleator.mechanics._kinematics import accelerations, rates
from aleator.mechanics._mechanical import AbstractMechanical, actuation_map, driven
from aleator.mechanics._motion import Motion
from aleator.mechanics._outputs import standard_outputs
from aleator.trajectories import AbstractSignal, AbstractTrajectory


@final
class ForwardDynamics(AbstractFormulation):
    """A mechanical system driven by torques: `v̇ = M⁻¹ (B τ + Q - C v - N)`, `q̇ = H v` (table 5.2: known torques).

    - `model`: the mechanical system, of any actuation scheme;
    - `torque`: one trajectory (or any signal) for all actuators, or one for each by name; those not named are zero;
    - `start`: initial coordinates and velocities by name; those not named are zero (for a quaternion `(1, 0, 0, 0)`).

    Every realisation receives the same torques. They are part of the system: their control points are named
    `torque.free`. Raises `ProblemError` for torques and starts of actuators, coordinates or velocities that the model
    does not have.
    """

    model: AbstractMechanical
    torque: Given
    start: dict[str, Any]

    states: ClassVar[tuple[str, ...]] = ("q", "v")
    signal_fields: ClassVar[tuple[str, ...]] = ("torque",)

    def __init__(self, model: AbstractMechanical, *, torque: Any = None, start: Mapping[str, Any] | None = None):
        self.model = model_given("ForwardDynamics", model)
        self.torque = signals_for(model.actuators, {} if torque is None else torque, "ForwardDynamics, torque")
        self.start = checked_start(model, (*model.coordinates, *model.speeds), start, "ForwardDynamics")

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """The units that the model declares, and the standard units of its kind."""
        return {**self.model.standard_units, **self.model.units}

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        found = course(self.model, 2)
        if not self.model.actuators:
            return found
        torque = combined(self.model.actuators, self.torque)
        rate = {"torque_rate": torque.derivative()} if isinstance(torque, AbstractTrajectory) else {}
        return {"torque": torque, **rate, **found}

    @override
    def initial(self) -> Mapping[str, Any]:
        q = self.model.normalised(coordinates_at(self.model, self.start))
        return {"q": q, "v": vector(self.model.speeds, self.start)}

    @override
    def rhs(self, t: Any, z: Any, torque: Any = None, parameters: Any = None) -> tuple[Array, Array]:
        model = at(self.model, t, parameters)
        q = model.normalised(z.q)
        return rates(model, q, z.v), _accelerated(model, q, z.v, self._given(torque))

    @override
    def outputs(
        self, t: Any, z: Any, torque: Any = None, torque_rate: Any = None, parameters: Any = None
    ) -> dict[str, Any]:
        model, torque = at(self.model, t, parameters), self._given(torque)
        q = model.normalised(z.q)
        v_dot = _accelerated(model, q, z.v, torque)
        motion = Motion(t, q, rates(model, q, z.v), accelerations(model, q, z.v, v_dot), z.v, v_dot, torque)
        return standard_outputs(model, motion, torque_rate)

    @override
    def diagnose(self, grid: Grid) -> str:
        start = self.initial()
        first = instants_of(self.model, grid).at(0)
        return diagnosis_at(first, start["q"], "at the start") or diagnosis_along(self, grid)

    def _given(self, torque: Any) -> Array:
        n = len(self.model.actuators)
        if torque is None:
            return jnp.zeros(n)
        if jnp.shape(torque) not in ((n,), () if n == 1 else (n,)):
            raise ProblemError(
                f"ForwardDynamics of {type(self.model).__name__}: expected a torque signal of shape ({n},), one value "
                f"for each of {list(self.model.actuators)}; received shape {jnp.shape(torque)}. Give scalar signals in "
                "a dict by these names."
            )
        return jnp.reshape(torque, (n,))


def _accelerated(model: AbstractMechanical, q: Array, v: Array, torque: Array) -> Array:
    return driven(model, q, v, torque if model.acts_directly else actuation_map(model, q) @ torque)
