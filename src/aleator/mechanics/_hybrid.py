"""`HybridDynamics`: some coordinates are prescribed, others integrated, and torques follow (equations 70 and 71)."""

from collections.abc import Mapping
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library, jax_array
from aleator._core.errors import ProblemError
from aleator.dynamics import Grid
from aleator.mechanics._arguments import (
    Signals,
    checked_guess,
    checked_start,
    combined,
    combined_motion,
    coordinates_at,
    followed,
    motions_for,
    signals_for,
    start_unknown,
    vector,
)
from aleator.mechanics._constraints import Loose, consistent_start, loose_beside
from aleator.mechanics._formulation import AbstractFormulation, a_model, constrained_outputs, standard_outputs
from aleator.mechanics._instant import along_time, at, course
from aleator.mechanics._matrices import taken
from aleator.mechanics._mechanical import AbstractMechanical, Motion, accelerations, rate_map, rates
from aleator.mechanics._partial import Partition, Prescribed, Solved, effect_of_torques, prescribed_velocities, solved
from aleator.trajectories import AbstractSignal, AbstractTrajectory


@final
class HybridDynamics(AbstractFormulation):
    """A mechanical system with some coordinates prescribed; the others follow from the dynamics (table 5.2).

    - `model`: a mechanical system, under-actuated or not;
    - `motion`: trajectories by the names of the prescribed coordinates: as many as there are unknown torques, or fewer
      (then the torques of least norm are found);
    - `torque`: trajectories or signals of those actuators whose torque is known, by name; the others are found;
    - `start`: initial values of the other coordinates and velocities, by name; those not named are zero (for a
      quaternion `(1, 0, 0, 0)`);
    - `guess`: of a system with constraints, coordinates near which those that the start leaves out are found; see
      `al.ForwardDynamics`;
    - `torque_rates`: whether the rates of torques are among the outputs.

    This is partial feedback linearisation: with `a` the prescribed and `u` the other velocities, the torques are those
    for which `M v̇ + C v + N = B τ` holds with the given `v̇_a`. Coordinates that share velocities, such as those of a
    quaternion, must be prescribed together. Raises `ProblemError` for motions, torques and starts of names that the
    model does not have, and for fewer unknown torques than prescribed coordinates.
    """

    model: AbstractMechanical
    motion: Signals
    torque: Signals
    start: dict[str, Any]
    guess: dict[str, Any]
    prescribed: tuple[int, ...] = eqx.field(static=True)
    driven: tuple[int, ...] = eqx.field(static=True)
    known: tuple[int, ...] = eqx.field(static=True)
    torque_rates: bool = eqx.field(static=True)

    signal_fields: ClassVar[tuple[str, ...]] = ("motion", "torque")

    def __init__(
        self,
        model: AbstractMechanical,
        *,
        motion: Mapping[str, Any],
        torque: Mapping[str, Any] | None = None,
        start: Mapping[str, Any] | None = None,
        guess: Mapping[str, Any] | None = None,
        torque_rates: bool = True,
    ):
        self.model = a_model("HybridDynamics", model)
        self.torque_rates = torque_rates
        _check_names(model, motion, torque or {})
        self.prescribed = tuple(i for i, name in enumerate(model.coordinates) if name in motion)
        self.driven = model.speeds_along(motion)
        self.motion = motions_for(self._followed(), motion, "HybridDynamics, motion")
        self.known = tuple(i for i, name in enumerate(model.actuators) if name in (torque or {}))
        self.torque = signals_for(self._commanded(), torque or {}, "HybridDynamics, torque")
        self.start = checked_start(model, (*self._loose(), *self._loose_speeds()), start, "HybridDynamics")
        self.guess = checked_guess("HybridDynamics", model, self._loose(), self.start, guess, len(self.driven))
        if len(self._parts.unknown) < len(self.driven):
            raise ProblemError(self._unrealisable())

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """Coordinates and velocities that are not prescribed; no velocities where constraints determine all of them."""
        return ("q",) if 0 < len(self._parts.undriven) == len(self.model.constraints) else ("q", "v")

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        signals = followed(combined_motion(self._followed(), self.motion), self.torque_rates)
        signals |= course(self.model, self.torque_rates)
        if self.known:
            signals["known"] = known = combined(self._commanded(), self.torque)
            if isinstance(known, AbstractTrajectory):
                signals["known_rate"] = known.derivative()
        return signals

    @override
    def initial(self) -> Mapping[str, Any]:
        if self.model.constraints:
            raise ProblemError(start_unknown("HybridDynamics", self.model))
        return self.starting(np.zeros(()), {})

    @override
    def started(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        if not self.model.constraints:
            return self._stated(self._others_near(), vector(self._loose_speeds(), self.start))
        model = at(self.model, t, inputs.get("parameters"))
        given = Prescribed(inputs["position"], inputs["velocity"], inputs["acceleration"], self._known(None))
        q, v = consistent_start(model, *self._near(model, given), self.loose_at_start)
        return self._stated(taken(q, self._parts.others), taken(v, self._parts.undriven))

    @override
    def rhs(
        self,
        t: Any,
        z: Any,
        position: Array,
        velocity: Array,
        acceleration: Array,
        known: Any = None,
        parameters: Any = None,
    ) -> tuple[Array, ...]:
        given, model = Prescribed(position, velocity, acceleration, self._known(known)), at(self.model, t, parameters)
        return self._rates_of(model, solved(model, self._parts, given, z.q, self._velocities(z)))

    def _rates_of(self, model: AbstractMechanical, motion: Solved) -> tuple[Array, ...]:
        q_dot = taken(rates(model, motion.q, motion.v), self._parts.others)
        return tuple(self._stated(q_dot, taken(motion.v_dot, self._parts.undriven)).values())

    @override
    def outputs(
        self,
        t: Any,
        z: Any,
        position: Array,
        velocity: Array,
        acceleration: Array,
        jerk: Array | None = None,
        known: Any = None,
        known_rate: Any = None,
        parameters: Any = None,
    ) -> dict[str, Any]:
        return self.rates_and_outputs(
            t, z, position, velocity, acceleration, jerk, known, known_rate, parameters=parameters
        )[1]

    @override
    def rates_and_outputs(
        self,
        t: Any,
        z: Any,
        position: Array,
        velocity: Array,
        acceleration: Array,
        jerk: Array | None = None,
        known: Any = None,
        known_rate: Any = None,
        parameters: Any = None,
    ) -> tuple[tuple[Array, ...], dict[str, Any]]:
        given, model = Prescribed(position, velocity, acceleration, self._known(known)), at(self.model, t, parameters)
        parts, v_u = self._parts, self._velocities(z)
        whole = solved(model, parts, given, z.q, v_u)
        q_dot = rates(model, whole.q, whole.v)
        torque_rate = None
        if jerk is not None and (known is None or known_rate is not None):
            change = Prescribed(velocity, acceleration, jerk, self._known(known_rate))
            along = (change, taken(q_dot, parts.others), taken(whole.v_dot, parts.undriven))
            torque_rate = along_time(
                lambda now, *where: solved(now, parts, *where).torque, model, (given, z.q, v_u), along
            )[1]
        q_ddot = accelerations(model, whole.q, whole.v, whole.v_dot)
        motion = Motion(t, whole.q, q_dot, q_ddot, whole.v, whole.v_dot, whole.torque, whole.multipliers)
        outputs = standard_outputs(model, motion, torque_rate, whole.bound)
        outputs = constrained_outputs(model, outputs, parts.merged(position, z.q), whole.obeyed)
        return self._rates_of(model, whole), outputs

    @override
    def beginning(self, model: AbstractMechanical, grid: Grid) -> tuple[Any, Any]:
        """Besides, the velocity map in a generic posture, in which no angle happens to be zero."""
        q = self._near(model, self._prescribed_at(grid))[0]
        return q, None if model.moves_directly else rate_map(model, q + np.linspace(0.2, 0.3, len(q)))

    @property
    @override
    def loose(self) -> Loose:
        return self._parts.loose

    @property
    @override
    def loose_at_start(self) -> Loose:
        return loose_beside(self.model, self.start, self.prescribed, self.driven)

    @override
    def prescribed_path(self, grid: Grid) -> Array:
        motion = combined_motion(self._followed(), self.motion).sampled(grid.fractions, grid.t_start, grid.t_final)
        others = self._others_near()
        return jax.vmap(lambda position: self._parts.merged(position, others))(motion)

    @override
    def effects(self, model: AbstractMechanical, q: Array) -> Array:
        return effect_of_torques(model, self._parts, q)

    @override
    def diagnose_start(self, effects: Any, own: Any) -> str:
        """Torques that cannot act on the prescribed motion, and velocities of others that enter its rates."""
        if not effects.size or np.linalg.matrix_rank(effects) < len(self.driven):
            return self._unrealisable()
        if own is None or not np.any(own[np.ix_(self.prescribed, self._parts.undriven)]):
            return ""
        names = ", ".join(self.model.coordinates[i] for i in self.prescribed)
        return (
            f"HybridDynamics of {type(self.model).__name__}: velocities of coordinates that are not prescribed enter "
            f"the rates of the prescribed ones ({names}). Prescribe all coordinates that share velocities, such as all "
            "three angles of a body."
        )

    def _unrealisable(self) -> str:
        names = ", ".join(self._followed())
        unknown = ", ".join(self.model.actuators[i] for i in self._parts.unknown) or "none"
        return (
            f"HybridDynamics of {type(self.model).__name__}: the unknown torques ({unknown}) cannot realise a "
            f"prescribed motion of {names}: expected at least {len(self.driven)} that act on it. Prescribe no more "
            "velocities than there are unknown torques."
        )

    @property
    def _parts(self) -> Partition:
        return Partition.of(self.model, self.prescribed, self.driven, self.known)

    def _stated(self, q: Array, v: Array) -> dict[str, Array]:
        """The states by name, or their rates."""
        return dict(zip(self.states, (q, v), strict=False))

    def _velocities(self, z: Any) -> Array:
        """The integrated velocities; zero where constraints determine them."""
        return z.v if "v" in self.states else jnp.zeros(len(self._parts.undriven))

    def _others_near(self) -> Array:
        """The coordinates that are not prescribed at the start, as they are given."""
        _, q = in_library(coordinates_at(self.model, {**self.guess, **self.start}))
        return jax_array(taken(q, self._parts.others))

    def _near(self, model: AbstractMechanical, given: Prescribed) -> tuple[Array, Array]:
        """Coordinates and velocities at the start, those that are not prescribed as they are given."""
        v_u = vector(self._loose_speeds(), self.start)
        q, v_a, _ = prescribed_velocities(model, self._parts, given, self._others_near(), v_u)
        return q, self._parts.joined(v_a, v_u)

    def _prescribed_at(self, grid: Grid) -> Prescribed:
        """The prescribed motion where the grid begins."""
        motion = combined_motion(self._followed(), self.motion)
        curve = [motion.derivative(k).sampled(np.zeros(1), grid.t_start, grid.t_final)[0] for k in range(3)]
        return Prescribed(curve[0], curve[1], curve[2], self._known(None))

    def _followed(self) -> tuple[str, ...]:
        return tuple(self.model.coordinates[i] for i in self.prescribed)

    def _commanded(self) -> tuple[str, ...]:
        return tuple(self.model.actuators[i] for i in self.known)

    def _loose(self) -> tuple[str, ...]:
        return tuple(self.model.coordinates[i] for i in self._parts.others)

    def _loose_speeds(self) -> tuple[str, ...]:
        return tuple(self.model.speeds[i] for i in self._parts.undriven)

    def _known(self, given: Any) -> Float[Array, " known"]:
        return jnp.zeros(len(self.known)) if given is None else given


def _check_names(model: AbstractMechanical, motion: Any, torque: Any) -> None:
    """Refuse motions and torques of unknown coordinates and actuators."""
    for given, names, what in ((motion, model.coordinates, "motion"), (torque, model.actuators, "torque")):
        if not isinstance(given, Mapping) or not set(given) <= set(names):
            raise ProblemError(
                f"HybridDynamics, {what}: expected trajectories by name, for some of {list(names)}; received {given!r}."
            )
    if not 0 < len(motion) < len(model.coordinates):
        raise ProblemError(
            f"HybridDynamics of {type(model).__name__}: expected some of {list(model.coordinates)} as prescribed "
            f"motion, but not all; received {list(motion)}. Use al.InverseDynamics for all, al.ForwardDynamics for "
            "none."
        )
