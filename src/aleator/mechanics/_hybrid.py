"""`HybridDynamics`: some coordinates are prescribed, the others integrated, torques follow (equations 70 and 71)."""

from collections.abc import Collection, Mapping
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.compilation import Compiled
from aleator._core.errors import ProblemError
from aleator.dynamics import Grid, System
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
from aleator.mechanics._kinematics import accelerations, on_manifold, rates
from aleator.mechanics._matrices import solve_any, solve_positive
from aleator.mechanics._mechanical import AbstractMechanical, actuation_map, bias_of, mass_of, rate_map
from aleator.mechanics._motion import Motion
from aleator.mechanics._outputs import standard_outputs
from aleator.mechanics._trouble import quaternion_trouble, trouble_along, trouble_at
from aleator.trajectories import AbstractSignal, AbstractTrajectory


@final
class HybridDynamics(System):
    """A mechanical system some of whose coordinates are prescribed, the others moving as they must (Table 5.2).

    - `model`: a mechanical system, under-actuated or not;
    - `motion`: trajectories by the names of the prescribed coordinates: as many as there are torques to find, or fewer
      (then the torques of least norm are found);
    - `torque`: trajectories or signals of those actuators whose torque is known, by name; the others are found;
    - `start`: initial values of the other coordinates and velocities, by name; those left out are zero (of a
      quaternion `(1, 0, 0, 0)`);
    - `torque_rates`: whether the rates of torques are among the outputs.

    Partial feedback linearisation: with `a` the prescribed and `u` the other velocities, the torques are those under
    which `M v̇ + C v + N = B τ` holds with the given `v̇_a`. Coordinates that share their velocities, such as those of a
    quaternion, are prescribed together. Raises `ProblemError` for motions, torques and starts of
    what the model does not have, and for fewer torques to find than prescribed coordinates.
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

    def __init__(
        self,
        model: AbstractMechanical,
        *,
        motion: Mapping[str, Any],
        torque: Mapping[str, Any] | None = None,
        start: Mapping[str, Any] | None = None,
        torque_rates: bool = True,
    ):
        self.model = model
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
        """The units that the model declares, and those that its kind tells."""
        return {**self.model.standard_units, **self.model.units}

    def signals(self) -> Mapping[str, AbstractSignal]:
        """See `System.signals`."""
        found = followed(combined_motion(self._followed(), self.motion), self.torque_rates)
        if self.known:
            found["known"] = known = combined(self._commanded(), self.torque)
            if isinstance(known, AbstractTrajectory):
                found["known_rate"] = known.derivative()
        return found

    def focused(self, only: Collection[str]) -> "HybridDynamics":
        """See `System.focused`: torque rates take a further derivative of everything."""
        asked = asks_torque_rates(self.model, only)
        given = {"motion": self.motion, "torque": self.torque, "start": self.start}
        return HybridDynamics(self.model, **given, torque_rates=asked)  # type: ignore[arg-type]

    def initial(self) -> Mapping[str, Any]:
        """See `System.initial`."""
        q = self.model.normalised(coordinates_at(self.model, self.start))
        return {"q": q[self._others()], "v": vector(self._loose_speeds(), self.start)}

    def rhs(
        self, t: Any, z: Any, position: Array, velocity: Array, acceleration: Array, known: Any = None
    ) -> tuple[Array, Array]:
        """See `System.rhs`."""
        del t
        solved = self._solve(_Given(position, velocity, acceleration, self._known(known)), z.q, z.v)
        return rates(self.model, solved.q, solved.v)[self._others()], solved.v_dot[self._undriven()]

    def outputs(
        self,
        t: Any,
        z: Any,
        position: Array,
        velocity: Array,
        acceleration: Array,
        jolt: Array | None = None,
        known: Any = None,
        known_rate: Any = None,
    ) -> dict[str, Any]:
        """See `System.outputs`."""
        given = _Given(position, velocity, acceleration, self._known(known))
        solved = self._solve(given, z.q, z.v)
        model = self.model
        q_dot = rates(model, solved.q, solved.v)
        torque_rate = None
        if jolt is not None and (known is None or known_rate is not None):
            change = _Given(velocity, acceleration, jolt, self._known(known_rate))
            along = (change, q_dot[self._others()], solved.v_dot[self._undriven()])
            torque_rate = jax.jvp(lambda *at: self._solve(*at).torque, (given, z.q, z.v), along)[1]
        q_ddot = accelerations(model, solved.q, solved.v, solved.v_dot)
        motion = Motion(t, solved.q, q_dot, q_ddot, solved.v, solved.v_dot, solved.torque)
        return standard_outputs(model, motion, torque_rate)

    def trouble(self, grid: Grid) -> str:
        """See `System.trouble`."""
        motion = combined_motion(self._followed(), self.motion).sampled(grid.fractions, grid.t_start, grid.t_final)
        others = self.initial()["q"]
        given = jax.vmap(lambda position: self._merged(position, others))(motion)
        q = self.model.normalised(given[0])
        if found := trouble_at(self.model, q, "at the start"):
            return found
        effect = np.asarray(self.effect(q))
        if not effect.size or np.linalg.matrix_rank(effect) < len(self.driven):
            return self._unrealisable()
        found = self._entangled(q) or quaternion_trouble(self.model, np.asarray(grid.times), given)
        return found or trouble_along(self, grid, _EFFECTS)

    def effect(self, q: Float[Array, " coordinates"]) -> Float[Array, "driven unknown"]:
        """How the torques to find act along the prescribed velocities, the others moving as they must."""
        M, B = mass_of(self.model, q), actuation_map(self.model, q)
        a, u, free = self.driven, self._undriven(), self._unknown()
        return _block(B, a, free) - _block(M, a, u) @ solve_positive(_block(M, u, u), _block(B, u, free))

    def _entangled(self, q: Array) -> str:
        """Why the prescribed rates do not determine velocities of their own; empty if they do."""
        if self.model.moves_directly:
            return ""
        # A posture apart, in which no angle happens to be zero.
        H = np.asarray(rate_map(self.model, q + jnp.linspace(0.2, 0.3, len(q))))
        if not np.any(_block(H, self.prescribed, self._undriven())):
            return ""
        names = ", ".join(self.model.coordinates[i] for i in self.prescribed)
        return (
            f"HybridDynamics of {type(self.model).__name__}: velocities of coordinates that are not prescribed enter "
            f"the rates of the prescribed ones ({names}). Prescribe all coordinates that share their velocities, such "
            "as all three angles of a body."
        )

    def _unrealisable(self) -> str:
        names = ", ".join(self._followed())
        found = ", ".join(self.model.actuators[i] for i in self._unknown()) or "none"
        return (
            f"HybridDynamics of {type(self.model).__name__}: the torques to find ({found}) cannot realise a prescribed "
            f"motion of {names}: expected at least {len(self.driven)} that act on it. Prescribe as many "
            "velocities as there are unknown torques."
        )

    def _solve(self, given: "_Given", q_u: Array, v_u: Array) -> "_Solved":
        """Coordinates, velocities, accelerations and torques, from what is given and what is integrated."""
        model, a, u = self.model, np.array(self.driven), self._undriven()
        q, v_a, v_dot_a = self._prescribed_velocities(given, q_u, v_u)
        v = self._joined(v_a, v_u)
        M, bias, B = mass_of(model, q), bias_of(model, q, v), actuation_map(model, q)
        rest = bias - B[:, list(self.known)] @ given.known
        B_free = B[:, self._unknown()]
        M_ua = _block(M, u, a)
        eliminated = solve_positive(_block(M, u, u), jnp.concatenate([M_ua, rest[u][:, None], B_free[u]], axis=1))
        inner, force, effect = eliminated[:, : len(a)], eliminated[:, len(a)], eliminated[:, len(a) + 1 :]
        # The equations of the prescribed coordinates, without the other accelerations.
        needed = (_block(M, a, a) - M_ua.T @ inner) @ v_dot_a + rest[a] - M_ua.T @ force
        found = solve_any(B_free[a] - M_ua.T @ effect, needed)
        v_dot_u = effect @ found - inner @ v_dot_a - force
        torque = jnp.concatenate([found, given.known])[_order((*self._unknown(), *self.known))]
        return _Solved(q, v, self._joined(v_dot_a, v_dot_u), torque)

    def _prescribed_velocities(self, given: "_Given", q_u: Array, v_u: Array) -> tuple[Array, Array, Array]:
        """Equations (66) and (67) for the prescribed coordinates alone, whose rates no other velocity enters."""
        if self.model.moves_directly:
            return self._merged(given.position, q_u), given.velocity, given.acceleration

        def own(at: Array) -> Array:
            return _block(rate_map(self.model, at), self.prescribed, self.driven)

        still, a = jnp.zeros_like(q_u), np.array(self.prescribed)
        curve = (self._merged(given.position, q_u), *(self._merged(one, still) for one in given[1:3]))
        q, rate, acceleration = on_manifold(self.model, *curve)
        v_a = solve_any(own(q), rate[a])
        q_dot = rates(self.model, q, self._joined(v_a, v_u))
        change = jax.jvp(lambda at: own(at) @ v_a, (q,), (q_dot,))[1]
        return q, v_a, solve_any(own(q), acceleration[a] - change)

    def _merged(self, prescribed: Array, others: Array) -> Array:
        """Coordinates in their order."""
        return jnp.concatenate([prescribed, others])[_order((*self.prescribed, *self._others()))]

    def _joined(self, driven: Array, others: Array) -> Array:
        """Velocities in their order."""
        return jnp.concatenate([driven, others])[_order((*self.driven, *self._undriven()))]

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


def _effects(system: HybridDynamics, path: Array) -> Array:
    return jax.vmap(system.effect)(path)


_EFFECTS = Compiled(_effects)


class _Given(NamedTuple):
    """The prescribed motion and the known torques at one instant (or their rates)."""

    position: Array
    velocity: Array
    acceleration: Array
    known: Array


class _Solved(NamedTuple):
    q: Array
    v: Array
    v_dot: Array
    torque: Array


def _block(M: Any, rows: Any, columns: Any) -> Any:
    """The entries of a matrix in some rows and columns."""
    return M[np.asarray(rows, dtype=int)][:, np.asarray(columns, dtype=int)]


def _order(places: tuple[int, ...]) -> np.ndarray:
    """Which entry of what is listed by places comes first, second, and so on."""
    return np.argsort(np.array(places, dtype=int))


def _check_names(model: AbstractMechanical, motion: Any, torque: Any) -> None:
    """Refuse motions and torques of what is no coordinate or actuator."""
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
