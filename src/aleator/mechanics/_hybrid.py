"""`HybridDynamics`: some coordinates are prescribed, others integrated, and torques follow (equations 70 and 71)."""

import functools
from collections.abc import Collection, Mapping
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.code import told_apart
from aleator._core.compilation import Compiled, Use
from aleator._core.errors import ProblemError
from aleator.dynamics import Grid
from aleator.mechanics._diagnosis import diagnosis_along, diagnosis_at, quaternion_diagnosis
from aleator.mechanics._formulation import AbstractFormulation, model_given
from aleator.mechanics._given import (
    Given,
    asks_torque_rates,
    checked_start,
    combined,
    combined_motion,
    coordinates_at,
    followed,
    motions_for,
    signals_for,
    vector,
)
from aleator.mechanics._instant import Instants, along_time, at, course, instants_of
from aleator.mechanics._kinematics import accelerations, on_manifold, rates
from aleator.mechanics._matrices import solve_any, solve_positive
from aleator.mechanics._mechanical import AbstractMechanical, actuation_map, bias_of, load_on, mass_of, rate_map
from aleator.mechanics._motion import Motion
from aleator.mechanics._outputs import standard_outputs
from aleator.mechanics._partition import Prescribed, Solved, block, order
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
    - `torque_rates`: whether the rates of torques are among the outputs.

    This is partial feedback linearisation: with `a` the prescribed and `u` the other velocities, the torques are those
    for which `M v̇ + C v + N = B τ` holds with the given `v̇_a`. Coordinates that share velocities, such as those of a
    quaternion, must be prescribed together. Raises `ProblemError` for motions, torques and starts of names that the
    model does not have, and for fewer unknown torques than prescribed coordinates.
    """

    model: AbstractMechanical
    motion: Given
    torque: Given
    start: dict[str, Any]
    prescribed: tuple[int, ...] = eqx.field(static=True)
    driven: tuple[int, ...] = eqx.field(static=True)
    known: tuple[int, ...] = eqx.field(static=True)
    torque_rates: bool = eqx.field(static=True)

    states: ClassVar[tuple[str, ...]] = ("q", "v")
    signal_fields: ClassVar[tuple[str, ...]] = ("motion", "torque")

    def __init__(
        self,
        model: AbstractMechanical,
        *,
        motion: Mapping[str, Any],
        torque: Mapping[str, Any] | None = None,
        start: Mapping[str, Any] | None = None,
        torque_rates: bool = True,
    ):
        self.model = model_given("HybridDynamics", model)
        self.torque_rates = torque_rates
        _check_names(model, motion, torque or {})
        self.prescribed = tuple(i for i, name in enumerate(model.coordinates) if name in motion)
        self.driven = model.speeds_along(motion)
        self.motion = motions_for(self._followed(), motion, "HybridDynamics, motion")
        self.known = tuple(i for i, name in enumerate(model.actuators) if name in (torque or {}))
        self.torque = signals_for(self._commanded(), torque or {}, "HybridDynamics, torque")
        self.start = checked_start(model, (*self._loose(), *self._loose_speeds()), start, "HybridDynamics")
        if len(self._unknown()) < len(self.driven):
            raise ProblemError(self._unrealisable())

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """The units that the model declares, and the standard units of its kind."""
        return {**self.model.standard_units, **self.model.units}

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        found = followed(combined_motion(self._followed(), self.motion), self.torque_rates)
        found |= course(self.model, 2 + self.torque_rates)
        if self.known:
            found["known"] = known = combined(self._commanded(), self.torque)
            if isinstance(known, AbstractTrajectory):
                found["known_rate"] = known.derivative()
        return found

    @override
    def focused(self, only: Collection[str]) -> "HybridDynamics":
        """Without torque rates where they are not asked for: they need one more derivative of everything."""
        asked = asks_torque_rates(self.model, only)
        given = {"motion": self.motion, "torque": self.torque, "start": self.start}
        return HybridDynamics(self.model, **given, torque_rates=asked)  # type: ignore[arg-type]

    @override
    def initial(self) -> Mapping[str, Any]:
        q = self.model.normalised(coordinates_at(self.model, self.start))
        return {"q": q[self._others()], "v": vector(self._loose_speeds(), self.start)}

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
    ) -> tuple[Array, Array]:
        model = at(self.model, t, parameters)
        solved = self._solve(model, Prescribed(position, velocity, acceleration, self._known(known)), z.q, z.v)
        return rates(model, solved.q, solved.v)[self._others()], solved.v_dot[self._undriven()]

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
        given, model = Prescribed(position, velocity, acceleration, self._known(known)), at(self.model, t, parameters)
        solved = self._solve(model, given, z.q, z.v)
        q_dot = rates(model, solved.q, solved.v)
        torque_rate = None
        if jerk is not None and (known is None or known_rate is not None):
            change = Prescribed(velocity, acceleration, jerk, self._known(known_rate))
            along = (change, q_dot[self._others()], solved.v_dot[self._undriven()])
            torque_rate = along_time(lambda *now: self._solve(*now).torque, model, (given, z.q, z.v), along)[1]
        q_ddot = accelerations(model, solved.q, solved.v, solved.v_dot)
        motion = Motion(t, solved.q, q_dot, q_ddot, solved.v, solved.v_dot, solved.torque)
        return standard_outputs(model, motion, torque_rate)

    @override
    def diagnose(self, grid: Grid) -> str:
        motion = combined_motion(self._followed(), self.motion).sampled(grid.fractions, grid.t_start, grid.t_final)
        others = self.initial()["q"]
        given = jax.vmap(lambda position: self._merged(position, others))(motion)
        q = self.model.normalised(given[0])
        first = instants_of(self.model, grid).at(0)
        if found := diagnosis_at(first, q, "at the start"):
            return found
        effect = np.asarray(self._effect(first, q))
        if not effect.size or np.linalg.matrix_rank(effect) < len(self.driven):
            return self._unrealisable()
        found = self._entangled(first, q) or quaternion_diagnosis(self.model, np.asarray(grid.times), given)
        return found or diagnosis_along(self, grid, _EFFECTS)

    def _effect(self, model: AbstractMechanical, q: Float[Array, " coordinates"]) -> Float[Array, "driven unknown"]:
        """The effect of the unknown torques on the prescribed accelerations, with the others following the dynamics."""
        M, B = mass_of(model, q), actuation_map(model, q)
        a, u, free = self.driven, self._undriven(), self._unknown()
        return block(B, a, free) - block(M, a, u) @ solve_positive(block(M, u, u), block(B, u, free))

    def _entangled(self, model: AbstractMechanical, q: Array) -> str:
        """Why the prescribed rates do not determine velocities of their own; empty if they do."""
        if model.moves_directly:
            return ""
        # A generic posture, in which no angle happens to be zero.
        H = np.asarray(rate_map(model, q + jnp.linspace(0.2, 0.3, len(q))))
        if not np.any(block(H, self.prescribed, self._undriven())):
            return ""
        names = ", ".join(self.model.coordinates[i] for i in self.prescribed)
        return (
            f"HybridDynamics of {type(self.model).__name__}: velocities of coordinates that are not prescribed enter "
            f"the rates of the prescribed ones ({names}). Prescribe all coordinates that share velocities, such as all "
            "three angles of a body."
        )

    def _unrealisable(self) -> str:
        names = ", ".join(self._followed())
        found = ", ".join(self.model.actuators[i] for i in self._unknown()) or "none"
        return (
            f"HybridDynamics of {type(self.model).__name__}: the unknown torques ({found}) cannot realise a prescribed "
            f"motion of {names}: expected at least {len(self.driven)} that act on it. Prescribe no more velocities "
            "than there are unknown torques."
        )

    def _solve(self, model: AbstractMechanical, given: Prescribed, q_u: Array, v_u: Array) -> Solved:
        """Coordinates, velocities, accelerations and torques, from the prescribed and the integrated quantities."""
        a, u = np.array(self.driven), self._undriven()
        q, v_a, v_dot_a = self._prescribed_velocities(model, given, q_u, v_u)
        v = self._joined(v_a, v_u)
        M, B = mass_of(model, q), actuation_map(model, q)
        bias = bias_of(model, q, v) - load_on(model, q, v)
        rest = bias - B[:, list(self.known)] @ given.known
        B_free = B[:, self._unknown()]
        M_ua = block(M, u, a)
        eliminated = solve_positive(block(M, u, u), jnp.concatenate([M_ua, rest[u][:, None], B_free[u]], axis=1))
        inner, force, effect = eliminated[:, : len(a)], eliminated[:, len(a)], eliminated[:, len(a) + 1 :]
        # The equations of the prescribed coordinates, with the other accelerations eliminated.
        needed = (block(M, a, a) - M_ua.T @ inner) @ v_dot_a + rest[a] - M_ua.T @ force
        found = solve_any(B_free[a] - M_ua.T @ effect, needed)
        v_dot_u = effect @ found - inner @ v_dot_a - force
        torque = jnp.concatenate([found, given.known])[order((*self._unknown(), *self.known))]
        return Solved(q, v, self._joined(v_dot_a, v_dot_u), torque)

    def _prescribed_velocities(
        self, model: AbstractMechanical, given: Prescribed, q_u: Array, v_u: Array
    ) -> tuple[Array, Array, Array]:
        """Equations (66) and (67) for the prescribed coordinates alone, whose rates depend on no other velocity."""
        if model.moves_directly:
            return self._merged(given.position, q_u), given.velocity, given.acceleration

        def own(now: AbstractMechanical, where: Array) -> Array:
            return block(rate_map(now, where), self.prescribed, self.driven)

        still, a = jnp.zeros_like(q_u), np.array(self.prescribed)
        curve = (self._merged(given.position, q_u), *(self._merged(one, still) for one in given[1:3]))
        q, rate, acceleration = on_manifold(model, *curve)
        v_a = solve_any(own(model, q), rate[a])
        q_dot = rates(model, q, self._joined(v_a, v_u))
        change = along_time(lambda *now: own(*now) @ v_a, model, (q,), (q_dot,))[1]
        return q, v_a, solve_any(own(model, q), acceleration[a] - change)

    def _merged(self, prescribed: Array, others: Array) -> Array:
        """All coordinates in the model's order."""
        return jnp.concatenate([prescribed, others])[order((*self.prescribed, *self._others()))]

    def _joined(self, driven: Array, others: Array) -> Array:
        """All velocities in the model's order."""
        return jnp.concatenate([driven, others])[order((*self.driven, *self._undriven()))]

    def _followed(self) -> tuple[str, ...]:
        return tuple(self.model.coordinates[i] for i in self.prescribed)

    def _commanded(self) -> tuple[str, ...]:
        return tuple(self.model.actuators[i] for i in self.known)

    def _others(self) -> np.ndarray:
        return np.array([i for i in range(len(self.model.coordinates)) if i not in self.prescribed], dtype=int)

    def _undriven(self) -> np.ndarray:
        return np.array([i for i in range(len(self.model.speeds)) if i not in self.driven], dtype=int)

    def _unknown(self) -> list[int]:
        return [i for i in range(len(self.model.actuators)) if i not in self.known]

    def _loose(self) -> tuple[str, ...]:
        return tuple(self.model.coordinates[i] for i in self._others())

    def _loose_speeds(self) -> tuple[str, ...]:
        return tuple(self.model.speeds[i] for i in self._undriven())

    def _known(self, given: Any) -> Float[Array, " known"]:
        return jnp.zeros(len(self.known)) if given is None else given


def _effects(system: HybridDynamics, now: Instants, path: Array) -> Array:
    return now.each(system._effect, path)


_EFFECTS = Compiled(_effects, use=Use.ONCE, code=functools.partial(told_apart, _effects))


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
