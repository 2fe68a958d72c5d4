"""`ForwardDynamics`: torques are given, the motion follows by integration (equation 68)."""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.dynamics import Grid
from aleator.mechanics._arguments import (
    Signals,
    checked_guess,
    checked_start,
    combined,
    coordinates_at,
    signals_for,
    start_unknown,
    vector,
)
from aleator.mechanics._constraints import Bound, Loose, Saddle, all_loose, consistent_start, loose_beside, put_back
from aleator.mechanics._formulation import AbstractFormulation, a_model, constrained_outputs, standard_outputs
from aleator.mechanics._instant import at, course, is_timed
from aleator.mechanics._mechanical import (
    AbstractMechanical,
    Motion,
    accelerations,
    actuation_map,
    bias_of,
    driven,
    load_on,
    mass_of,
    rates,
)
from aleator.trajectories import AbstractSignal, AbstractTrajectory


@final
class ForwardDynamics(AbstractFormulation):
    """A mechanical system driven by torques: `v̇ = M⁻¹ (B τ + Q - C v - N)`, `q̇ = H v` (table 5.2: known torques).

    - `model`: the mechanical system, of any actuation scheme;
    - `torque`: one trajectory (or any signal) for all actuators, or one for each by name; those not named are zero;
    - `start`: initial coordinates and velocities by name; those not named are zero (for a quaternion `(1, 0, 0, 0)`);
    - `guess`: for a system with constraints, coordinates near which those not named in `start` are found.

    Constraints are solved together with the accelerations (equation 6), and every output satisfies them. Values named
    in `start` are kept; the other coordinates are those nearest to `guess`, and the other velocities those nearest to
    rest, that satisfy the constraints, in each realisation separately. `constraint_drift` is how far the integrated
    coordinates had left the constraints before they were projected back: a measure of the grid's error.

    Every realisation receives the same torques. They are part of the system: their control points are named
    `torque.free`. Raises `ProblemError` for torques and starts of actuators, coordinates or velocities that the model
    does not have.
    """

    model: AbstractMechanical
    torque: Signals
    start: dict[str, Any]
    guess: dict[str, Any]

    states: ClassVar[tuple[str, ...]] = ("q", "v")
    signal_fields: ClassVar[tuple[str, ...]] = ("torque",)

    def __init__(
        self,
        model: AbstractMechanical,
        *,
        torque: Any = None,
        start: Mapping[str, Any] | None = None,
        guess: Mapping[str, Any] | None = None,
    ):
        self.model = a_model("ForwardDynamics", model)
        self.torque = signals_for(model.actuators, {} if torque is None else torque, "ForwardDynamics, torque")
        self.start = checked_start(model, (*model.coordinates, *model.speeds), start, "ForwardDynamics")
        self.guess = checked_guess("ForwardDynamics", model, model.coordinates, self.start, guess, 0)

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        parameters = course(self.model)
        if not self.model.actuators:
            return parameters
        torque = combined(self.model.actuators, self.torque)
        curve = torque if isinstance(torque, AbstractTrajectory) and torque.derivatives > 0 else None
        rate = {"torque_rate": curve.derivative()} if curve is not None else {}
        return {"torque": torque, **rate, **parameters}

    @override
    def initial(self) -> Mapping[str, Any]:
        if self.model.constraints and is_timed(self.model):
            raise ProblemError(start_unknown("ForwardDynamics", self.model))
        return self.starting(np.zeros(()), {})

    @override
    def started(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        q, v = self._near()
        if self.model.constraints:
            model = at(self.model, t, inputs.get("parameters"))
            q, v = consistent_start(model, q, v, self.loose_at_start)
        return {"q": q, "v": v}

    def _near(self) -> tuple[Array, Array]:
        """Coordinates and velocities as they are given."""
        return coordinates_at(self.model, {**self.guess, **self.start}), vector(self.model.speeds, self.start)

    @override
    def rhs(self, t: Any, z: Any, torque: Any = None, parameters: Any = None) -> tuple[Array, Array]:
        model = at(self.model, t, parameters)
        return _rates_of(model, _moving(model, z.q, z.v, self._given(torque)))

    @override
    def outputs(
        self, t: Any, z: Any, torque: Any = None, torque_rate: Any = None, parameters: Any = None
    ) -> dict[str, Any]:
        model, torque = at(self.model, t, parameters), self._given(torque)
        return _outputs_of(model, t, z, torque, torque_rate, _moving(model, z.q, z.v, torque))

    @override
    def rates_and_outputs(
        self, t: Any, z: Any, torque: Any = None, torque_rate: Any = None, parameters: Any = None
    ) -> tuple[tuple[Array, Array], dict[str, Any]]:
        model, torque = at(self.model, t, parameters), self._given(torque)
        moving = _moving(model, z.q, z.v, torque)
        return _rates_of(model, moving), _outputs_of(model, t, z, torque, torque_rate, moving)

    @override
    def beginning(self, model: AbstractMechanical, grid: Grid) -> tuple[Any, Any]:
        del model, grid
        return self._near()[0], None

    @property
    @override
    def loose_at_start(self) -> Loose:
        return loose_beside(self.model, self.start)

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


class _Moving(NamedTuple):
    """The motion under given torques, and whether its constraints could be obeyed."""

    q: Array
    v: Array
    v_dot: Array
    multipliers: Array
    obeyed: Any
    bound: Bound


def _moving(model: AbstractMechanical, q: Array, v: Array, torque: Array) -> _Moving:
    if not model.constraints:
        q = model.normalised(q)
        return _Moving(q, v, driven(model, q, v, _force(model, q, torque)), jnp.zeros(0), True, Bound(model, q))
    loose = all_loose(model)
    q, obeyed = put_back(model, q, loose)
    bound = Bound(model, q)
    saddle = Saddle(mass_of(model, q), bound.G)
    # By the least kinetic energy of a change.
    v = v - saddle.least(bound.rate(v))
    force = _force(model, q, torque) + load_on(model, q, v) - bias_of(model, q, v)
    v_dot, multipliers = saddle.solve(force, bound.acceleration(v))
    return _Moving(q, v, v_dot, multipliers, obeyed, bound)


def _rates_of(model: AbstractMechanical, moving: _Moving) -> tuple[Array, Array]:
    return rates(model, moving.q, moving.v), moving.v_dot


def _outputs_of(
    model: AbstractMechanical, t: Any, z: Any, torque: Array, torque_rate: Any, moving: _Moving
) -> dict[str, Any]:
    q, v, v_dot, multipliers, obeyed, bound = moving
    motion = Motion(t, q, rates(model, q, v), accelerations(model, q, v, v_dot), v, v_dot, torque, multipliers)
    return constrained_outputs(model, standard_outputs(model, motion, torque_rate, bound), z.q, obeyed)


def _force(model: AbstractMechanical, q: Array, torque: Array) -> Array:
    return torque if model.acts_directly else actuation_map(model, q) @ torque
