"""`HybridDynamics`: some coordinates are prescribed, the others integrated, torques follow (equations 70 and 71)."""

from collections.abc import Collection, Mapping
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator.dynamics import Grid, System
from aleator.mechanics._given import (
    Given,
    asks_torque_rates,
    checked_start,
    combined,
    combined_motion,
    followed,
    motions_for,
    signals_for,
    vector,
)
from aleator.mechanics._kinematics import accelerations, rates
from aleator.mechanics._matrices import solve_any, solve_positive
from aleator.mechanics._mechanical import AbstractMechanical
from aleator.mechanics._motion import Motion
from aleator.mechanics._outputs import standard_outputs
from aleator.mechanics._trouble import trouble_along, trouble_at
from aleator.trajectories import AbstractSignal, AbstractTrajectory


@final
class HybridDynamics(System):
    """A mechanical system some of whose coordinates are prescribed, the others moving as they must (Table 5.2).

    - `model`: a mechanical system, under-actuated or not;
    - `motion`: trajectories by the names of the prescribed coordinates: as many as there are torques to find, or fewer
      (then the torques of least norm are found);
    - `torque`: trajectories or signals of those actuators whose torque is known, by name; the others are found;
    - `start`: initial values of the other coordinates and velocities, by name; those left out are zero;
    - `torque_rates`: whether the rates of torques are among the outputs.

    Partial feedback linearisation: with `a` the prescribed and `u` the other coordinates, the torques are those under
    which `M v̇ + C v + N = B τ` holds with the given `v̇_a`. Raises `ProblemError` for motions, torques and starts of
    what the model does not have, and for fewer torques to find than prescribed coordinates.
    """

    model: AbstractMechanical
    motion: Given
    torque: Given
    start: dict[str, Any]
    prescribed: tuple[int, ...] = eqx.field(static=True)
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
        self.motion = motions_for(self._followed(), motion, "HybridDynamics, motion")
        self.known = tuple(i for i, name in enumerate(model.actuators) if name in (torque or {}))
        self.torque = signals_for(self._commanded(), torque or {}, "HybridDynamics, torque")
        names = self._free(model.coordinates) + self._free(model.speeds)
        self.start = checked_start(model, names, start, "HybridDynamics")
        if len(self._unknown()) < len(self.prescribed):
            raise ProblemError(self._unrealisable())

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """The units that the model declares."""
        return self.model.units

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
        return {
            "q": vector(self._free(self.model.coordinates), self.start),
            "v": vector(self._free(self.model.speeds), self.start),
        }

    def rhs(
        self, t: Any, z: Any, position: Array, velocity: Array, acceleration: Array, known: Any = None
    ) -> tuple[Array, Array]:
        """See `System.rhs`."""
        del t
        solved = self._solve(_Given(position, velocity, acceleration, self._known(known)), z.q, z.v)
        u = self._others()
        return rates(self.model, solved.q, solved.v)[u], solved.v_dot[u]

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
        model, u = self.model, self._others()
        q_dot = rates(model, solved.q, solved.v)
        torque_rate = None
        if jolt is not None and (known is None or known_rate is not None):
            change = _Given(velocity, acceleration, jolt, self._known(known_rate))
            along = (change, q_dot[u], solved.v_dot[u])
            torque_rate = jax.jvp(lambda *at: self._solve(*at).torque, (given, z.q, z.v), along)[1]
        q_ddot = accelerations(model, solved.q, solved.v, solved.v_dot)
        motion = Motion(t, solved.q, q_dot, q_ddot, solved.v, solved.v_dot, solved.torque)
        return standard_outputs(model, motion, torque_rate)

    def trouble(self, grid: Grid) -> str:
        """See `System.trouble`."""
        motion = combined_motion(self._followed(), self.motion)
        at = [motion.derivative(k).sampled(np.zeros(1), grid.t_start, grid.t_final)[0] for k in range(3)]
        start = self.initial()
        q = self._merged(at[0], start["q"])
        if found := trouble_at(self.model, q, "at the start"):
            return found
        M, B = np.asarray(self.model.mass_matrix(q)), np.asarray(self.model.actuation(q))
        return self._mismatch(M, B) or self._entangled(q) or trouble_along(self, grid)

    def _mismatch(self, M: np.ndarray, B: np.ndarray) -> str:
        """Why the unknown torques cannot realise the prescribed motion; empty if they can."""
        a, u, free = list(self.prescribed), self._others(), self._unknown()
        effect = _block(B, a, free) - _block(M, a, u) @ np.linalg.solve(_block(M, u, u), _block(B, u, free))
        if effect.size and np.linalg.matrix_rank(effect) == len(a):
            return ""
        return self._unrealisable()

    def _entangled(self, q: Array) -> str:
        """Why the prescribed rates do not determine velocities of their own; empty if they do."""
        if self.model.moves_directly:
            return ""
        # A posture apart, in which no angle happens to be zero.
        H = np.asarray(self.model.velocity_map(q + jnp.linspace(0.2, 0.3, len(q))))
        if not np.any(H[list(self.prescribed)][:, self._others()]):
            return ""
        names = ", ".join(self.model.coordinates[i] for i in self.prescribed)
        return (
            f"HybridDynamics of {type(self.model).__name__}: velocities of coordinates that are not prescribed enter "
            f"the rates of the prescribed ones ({names}). Prescribe all coordinates that share their velocities, such "
            "as all three angles of a body."
        )

    def _unrealisable(self) -> str:
        names = ", ".join(self.model.coordinates[i] for i in self.prescribed)
        found = ", ".join(self.model.actuators[i] for i in self._unknown()) or "none"
        return (
            f"HybridDynamics of {type(self.model).__name__}: the torques to find ({found}) cannot realise a prescribed "
            f"motion of {names}: expected at least {len(self.prescribed)} that act on it. Prescribe as many "
            "coordinates as there are unknown torques."
        )

    def _solve(self, given: "_Given", q_u: Array, v_u: Array) -> "_Solved":
        """Coordinates, velocities, accelerations and torques, from what is given and what is integrated."""
        model, a, u = self.model, np.array(self.prescribed), self._others()
        q = model.normalised(self._merged(given.position, q_u))
        v_a, v_dot_a = self._prescribed_velocities(given, q, v_u)
        v = self._merged(v_a, v_u)
        M, bias, B = model.mass_matrix(q), model.bias(q, v), jnp.asarray(model.actuation(q))
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
        return _Solved(q, v, self._merged(v_dot_a, v_dot_u), torque)

    def _prescribed_velocities(self, given: "_Given", q: Array, v_u: Array) -> tuple[Array, Array]:
        """Equations (66) and (67) for the prescribed coordinates alone, whose rates no other velocity enters."""
        if self.model.moves_directly:
            return given.velocity, given.acceleration

        def own(at: Array) -> Array:
            return _block(self.model.velocity_map(at), self.prescribed, self.prescribed)

        v_a = solve_any(own(q), given.velocity)
        q_dot = rates(self.model, q, self._merged(v_a, v_u))
        change = jax.jvp(lambda at: own(at) @ v_a, (q,), (q_dot,))[1]
        return v_a, solve_any(own(q), given.acceleration - change)

    def _merged(self, prescribed: Array, others: Array) -> Array:
        return jnp.concatenate([prescribed, others])[_order((*self.prescribed, *self._others()))]

    def _followed(self) -> tuple[str, ...]:
        return tuple(self.model.coordinates[i] for i in self.prescribed)

    def _commanded(self) -> tuple[str, ...]:
        return tuple(self.model.actuators[i] for i in self.known)

    def _others(self) -> np.ndarray:
        return np.array([i for i in range(len(self.model.coordinates)) if i not in self.prescribed], dtype=int)

    def _unknown(self) -> list[int]:
        return [i for i in range(len(self.model.actuators)) if i not in self.known]

    def _free(self, names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(name for i, name in enumerate(names) if i not in self.prescribed)

    def _known(self, given: Any) -> Float[Array, " known"]:
        return jnp.zeros(len(self.known)) if given is None else given


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
    """Refuse motions and torques of what is no coordinate or actuator, and coordinates without velocities of their
    own.
    """
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
    if len(model.coordinates) != len(model.speeds):
        raise ProblemError(
            f"HybridDynamics of {type(model).__name__}: expected one velocity for each coordinate, as Euler "
            f"angles have; received {len(model.coordinates)} coordinates and {len(model.speeds)} velocities."
        )
