"""`InverseDynamics`: the motion is given, torques follow algebraically (equation 69); the actuation that this needs."""

from collections.abc import Mapping
from enum import Enum
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import one_of, real_array, refusal
from aleator._core.errors import ProblemError
from aleator.dynamics import Grid
from aleator.mechanics._arguments import Signals, checked_guess, combined_motion, followed, motions_for
from aleator.mechanics._formulation import AbstractFormulation, a_model, standard_outputs
from aleator.mechanics._hybrid import HybridDynamics
from aleator.mechanics._instant import along_time, at, course, instants_of
from aleator.mechanics._matrices import solve_any
from aleator.mechanics._mechanical import (
    AbstractMechanical,
    Followed,
    Motion,
    actuation_map,
    follow,
    jacobian_of,
    rates,
    required_force,
)
from aleator.mechanics._spatial import Numbers
from aleator.trajectories import AbstractSignal, AbstractTrajectory

# Parts of the largest rate and of the largest coordinate (per second) that are rounding of a motion, not slip.
_SLIPS, _ROUNDING = 1e-6, 1e-9


class Actuation(Enum):
    """The actuation schemes of figure 2.2."""

    PASSIVE = "passive"
    FULL = "fully actuated"
    UNDER = "under-actuated"
    OVER = "over-actuated"
    UNDER_OVER = "under-over-actuated"


def actuation_of(model: AbstractMechanical, q: Float[Array, " coordinates"]) -> Actuation:
    """The actuation scheme of a realised system in a posture, from the rank of `B(q)` and the number of torques.

    For a system with constraints, `B` is taken on the motions that these leave free, in a posture that satisfies them.
    """
    one_of("actuation_of", model, AbstractMechanical, "an al.Multibody")
    posture = real_array("actuation_of: q", q)
    if posture.shape != (len(model.coordinates),) or not np.isfinite(posture).all():
        raise refusal("actuation_of: q", f"finite numbers for {list(model.coordinates)}", q)
    q = jnp.asarray(posture)
    B = np.asarray(actuation_map(model, q))
    if model.constraints:
        G = np.asarray(jacobian_of(model, q))
        B = np.linalg.svd(G)[2][len(G) :] @ B
    return scheme(B)


def scheme(B: Float[np.ndarray, "speeds actuators"]) -> Actuation:
    """The scheme of an actuation map."""
    rank = int(np.linalg.matrix_rank(B)) if B.size else 0
    speeds, actuators = B.shape
    if rank == 0:
        return Actuation.PASSIVE
    if rank == speeds:
        return Actuation.FULL if actuators == speeds else Actuation.OVER
    return Actuation.UNDER if actuators == rank else Actuation.UNDER_OVER


def torques(
    model: AbstractMechanical, q: Float[Numbers, " coordinates"], force: Float[Array, " speeds"]
) -> Float[Array, " actuators"]:
    """The torques that produce a generalised force; those of least norm where there are many."""
    if model.acts_directly:
        return force
    return solve_any(actuation_map(model, q), force)


@final
class InverseDynamics(AbstractFormulation):
    """A mechanical system on a prescribed motion: `τ = B⁻¹ (M v̇ + C v + N - Q)` (table 5.2: known motion).

    - `model`: a fully actuated mechanical system, or an over-actuated one, for which the torques of least norm are
      found;
    - `motion`: one trajectory of all coordinates, or one for each by name;
    - `torque_rates`: whether the rates of torques are among the outputs;
    - `guess`: for a system with constraints, coordinates near which those that are not prescribed start.

    With constraints, as many coordinates are prescribed, by name, as the constraints leave free: a driven crank. The
    others follow in each realisation separately, on the branch that starts near `guess`; torques and multipliers are
    solved together, and there must be as many torques as prescribed velocities. The coordinates that follow are then
    states: they are integrated to stay on the branch, and projected onto the constraints in every output.

    Every realisation follows the same motion, with its own torques. The motion is part of the system: its control
    points are named `motion.free`. Raises `ProblemError` for motions of unknown coordinates, and for models with fewer
    torques than velocities.
    """

    model: AbstractMechanical
    motion: Signals
    guess: dict[str, Any]
    torque_rates: bool = eqx.field(static=True)

    signal_fields: ClassVar[tuple[str, ...]] = ("motion",)

    def __init__(
        self,
        model: AbstractMechanical,
        *,
        motion: Any,
        guess: Mapping[str, Any] | None = None,
        torque_rates: bool = True,
    ):
        self.model = a_model("InverseDynamics", model)
        self.torque_rates = torque_rates
        prescribed = _driving(model, motion) if model.constraints else model.coordinates
        self.motion = motions_for(prescribed, motion, "InverseDynamics, motion")
        followed = tuple(name for name in model.coordinates if name not in prescribed)
        self.guess = checked_guess("InverseDynamics", model, followed, (), guess, len(model.speeds_along(prescribed)))
        if len(model.actuators) < len(model.speeds) - len(model.constraints):
            raise ProblemError(self._unrealisable("under-actuated"))

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """The coordinates that follow by constraints; none without."""
        return self._driven().states if self.model.constraints else ()

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        if self.model.constraints:
            return self._driven().signals()
        return {**followed(self._motion(), self.torque_rates), **course(self.model, self.torque_rates)}

    @override
    def initial(self) -> Mapping[str, Any]:
        return self._driven().initial() if self.model.constraints else {}

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        return self._driven().starting(t, inputs) if self.model.constraints else super().starting(t, inputs)

    @override
    def rhs(
        self, t: Any, z: Any, position: Array, velocity: Array, acceleration: Array, parameters: Array | None = None
    ) -> tuple[Array, ...]:
        """The rates of the coordinates that follow; nothing is integrated without constraints."""
        if not self.model.constraints:
            return ()
        return self._driven().rhs(t, z, position, velocity, acceleration, parameters=parameters)

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
        if self.model.constraints:
            return self.rates_and_outputs(t, z, position, velocity, acceleration, jerk, parameters=parameters)[1]
        model, curve = at(self.model, t, parameters), (position, velocity, acceleration)
        if jerk is None:
            torque, path = _torques(model, *curve)
            return _if_possible(model, path, standard_outputs(model, _motion_at(t, path, torque)))
        along = velocity, acceleration, jerk
        torque, torque_rate, path = along_time(_torques, model, curve, along, has_aux=True)
        return _if_possible(model, path, standard_outputs(model, _motion_at(t, path, torque), torque_rate))

    @override
    def rates_and_outputs(self, t: Any, z: Any, *args: Any, **kwargs: Any) -> tuple[tuple[Array, ...], dict[str, Any]]:
        if not self.model.constraints:
            return (), self.outputs(t, z, *args, **kwargs)
        return self._driven().rates_and_outputs(t, z, *args, **kwargs)

    @override
    def diagnose(self, grid: Grid) -> str:
        if self.model.constraints:
            return self._driven().diagnose(grid)
        return super().diagnose(grid) or self._impossible(grid)

    def _impossible(self, grid: Grid) -> str:
        """Where the motion is none that velocities can give, as of a wheel that is pushed sideways."""
        model, motion = self.model, self._motion()
        if model.moves_directly:
            return ""
        path = [signal.sampled(grid.fractions, grid.t_start, grid.t_final) for signal in (motion, motion.derivative(1))]

        def missed(now: AbstractMechanical, at: Array, along: Array) -> tuple[Array, Array]:
            return _slip(now, follow(now, at, along, jnp.zeros_like(along)))

        left, allowed = map(np.asarray, jax.jit(lambda: instants_of(model, grid).each(missed, *path))())
        excess = np.abs(left) / allowed[:, None]
        instant, place = map(int, np.unravel_index(np.argmax(excess), excess.shape))
        if not excess[instant, place] > 1:
            return ""
        return (
            f"InverseDynamics of {type(model).__name__}: a motion that q' = H(q) v does not allow: at t = "
            f"{float(grid.times[instant]):.4g} s '{model.coordinates[place]}' would have to change by "
            f"{left[instant, place]:.4g} per second beyond what any velocities give. Prescribe a motion that rolls, or "
            "fewer coordinates by al.HybridDynamics."
        )

    @override
    def beginning(self, model: AbstractMechanical, grid: Grid) -> tuple[Any, Any]:
        (curve,) = model.as_computed([self._motion().sampled(np.zeros(1), grid.t_start, grid.t_final)])
        return curve[0], None

    @override
    def prescribed_path(self, grid: Grid) -> Array:
        return self._motion().sampled(grid.fractions, grid.t_start, grid.t_final)

    @override
    def effects(self, model: AbstractMechanical, q: Array) -> Any:
        return None if model.acts_directly else actuation_map(model, q)

    @override
    def diagnose_start(self, effects: Any, own: Any) -> str:
        del own
        kind = Actuation.FULL if effects is None else scheme(effects)
        return "" if kind in (Actuation.FULL, Actuation.OVER) else self._unrealisable(kind.value)

    def _unrealisable(self, scheme: str) -> str:
        return (
            f"InverseDynamics: {type(self.model).__name__} is {scheme}: its torques "
            f"({', '.join(self.model.actuators) or 'none'}) cannot realise any motion of all its coordinates "
            f"({', '.join(self.model.coordinates)}). Use al.HybridDynamics, which prescribes as many coordinates as "
            "there are torques, or al.ForwardDynamics."
        )

    def _driven(self) -> HybridDynamics:
        """The same with constraints: what is prescribed determines all other coordinates."""
        motion = self.motion if isinstance(self.motion, dict) else {}
        return HybridDynamics(self.model, motion=motion, guess=self.guess, torque_rates=self.torque_rates)

    def _motion(self) -> AbstractTrajectory:
        return combined_motion(self.model.coordinates, self.motion)


def _driving(model: AbstractMechanical, motion: Any) -> tuple[str, ...]:
    """The coordinates that a motion of a constrained model prescribes: as many as may be chosen."""
    freedoms = len(model.speeds) - len(model.constraints)
    names = tuple(name for name in model.coordinates if isinstance(motion, Mapping) and name in motion)
    if not names or len(model.speeds_along(names)) != freedoms:
        raise ProblemError(
            f"InverseDynamics of {type(model).__name__}: expected trajectories by name for {freedoms} of "
            f"{list(model.coordinates)}: as many as its {len(model.constraints)} constraints leave free; received "
            f"{motion!r}. Use al.HybridDynamics to prescribe fewer."
        )
    return names


def _torques(
    model: AbstractMechanical, position: Array, velocity: Array, acceleration: Array
) -> tuple[Array, Followed]:
    """The torques that a motion requires, and the motion."""
    path = follow(model, position, velocity, acceleration)
    return torques(model, path.q, required_force(model, path.q, path.v, path.v_dot)), path


def _slip(model: AbstractMechanical, path: Followed) -> tuple[Array, Array]:
    """The rates that no velocities give, and how large rounding may make them."""
    allowed = _SLIPS * jnp.abs(path.q_dot).max() + _ROUNDING * (1 + jnp.abs(path.q).max())
    return path.q_dot - rates(model, path.q, path.v), allowed


def _if_possible(model: AbstractMechanical, path: Followed, outputs: dict[str, Any]) -> dict[str, Any]:
    """The outputs; not a number where no velocities give the motion."""
    if model.moves_directly:
        return outputs
    slip, allowed = _slip(model, path)
    return {name: jnp.where(jnp.abs(slip).max() <= allowed, value, jnp.nan) for name, value in outputs.items()}


def _motion_at(t: Any, path: Followed, torque: Array) -> Motion:
    q, q_dot, q_ddot, v, v_dot = path
    return Motion(t, q, q_dot, q_ddot, v, v_dot, torque)
