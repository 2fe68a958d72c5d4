"""`ForwardDynamics`, `InverseDynamics`, `HybridDynamics`: one formulation, by what is prescribed and what is known."""

from collections.abc import Mapping
from enum import Enum
from typing import Any, ClassVar, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import one_of, real_array, refusal
from aleator._core.errors import ProblemError
from aleator.mechanics._constraints import jacobian_of
from aleator.mechanics._formulation import AbstractFormulation, a_model
from aleator.mechanics._mechanical import AbstractMechanical, value_of


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
    B = np.asarray(value_of(model, "actuation", q))
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


@final
class ForwardDynamics(AbstractFormulation):
    """A mechanical system driven by torques: `v̇ = M⁻¹ (B τ + Q - C v - N)`, `q̇ = H v` (table 5.2: known torques).

    - `model`: the mechanical system, of any actuation scheme;
    - `torque`: one trajectory (or any signal) for all actuators, or one for each by name; those not named are zero;
    - `start`: initial coordinates and velocities by name; those not named are zero (for a quaternion `(1, 0, 0, 0)`);
    - `guess`: for a system with constraints, coordinates near which those not named in `start` are found; names of
      `start` may be among them.

    Constraints are solved together with the accelerations (equation 6), and every output satisfies them. Torques are
    taken as they are given, whatever the model's `torque_bounds`. Values named
    in `start` are kept; the other coordinates are those that satisfy the constraints on the shortest way from `guess`,
    and the other velocities those nearest to rest that do, in each realisation separately. A start may also name all
    coordinates, or all velocities, as published: if these miss the constraints by less than a hundredth, they are
    brought onto them on the shortest way. `constraint_drift` is how far the integrated coordinates had left the
    constraints before they were projected back: a measure of the grid's error.

    Every realisation receives the same torques. They are part of the system: their control points are named
    `torque.free`. Raises `ProblemError` for torques and starts of actuators, coordinates or velocities that the model
    does not have.
    """

    signal_fields: ClassVar[tuple[str, ...]] = ("torque",)

    def __init__(
        self,
        model: AbstractMechanical,
        *,
        torque: Any = None,
        start: Mapping[str, Any] | None = None,
        guess: Mapping[str, Any] | None = None,
    ):
        a_model("ForwardDynamics", model)
        torque = {} if torque is None else torque
        super().__init__(model, torque=torque, start=start, guess=guess, known=model.actuators)


@final
class InverseDynamics(AbstractFormulation):
    """A mechanical system on a prescribed motion: `τ = B⁻¹ (M v̇ + C v + N - Q)` (table 5.2: known motion).

    - `model`: a fully actuated mechanical system, or an over-actuated one, for which the torques of least norm within
      its `torque_bounds` are found, in each realisation by itself;
    - `motion`: one trajectory of all coordinates, or one for each by name;
    - `torque_rates`: whether the rates of torques are among the outputs;
    - `guess`: for a system with constraints, coordinates near which those that are not prescribed start.

    With constraints, as many coordinates are prescribed, by name, as the constraints leave free: a driven crank. The
    others follow in each realisation separately, on the branch that starts near `guess`; torques and multipliers are
    solved together, and there must be as many torques as prescribed velocities. The coordinates that follow are then
    states: they are integrated to stay on the branch, and projected onto the constraints in every output. Where
    constraints bind velocities alone, more coordinates may be prescribed, by a motion that obeys them.

    Every realisation follows the same motion, with its own torques. The motion is part of the system: its control
    points are named `motion.free`. Where coordinates have fewer velocities, or velocities are constrained,
    `motion_error` is how far the prescribed rates are from `H v`, and all from their constraints; `torque_shortfall` is
    the largest part of the force that torques cannot make within bounds. Other outputs are not a number where one of
    them is more than rounding. Raises `ProblemError` for motions of unknown coordinates, and for models with fewer
    torques than velocities.
    """

    signal_fields: ClassVar[tuple[str, ...]] = ("motion",)

    def __init__(
        self,
        model: AbstractMechanical,
        *,
        motion: Any,
        guess: Mapping[str, Any] | None = None,
        torque_rates: bool = True,
    ):
        a_model("InverseDynamics", model)
        prescribed = _driving(model, motion) if model.constraints else model.coordinates
        super().__init__(model, motion=motion, guess=guess, torque_rates=torque_rates, prescribed=prescribed)
        if len(model.actuators) < len(model.speeds) - len(model.constraints):
            raise ProblemError(self.unrealisable())

    @override
    def unrealisable(self) -> str:
        model = self.model
        return (
            f"InverseDynamics: {type(model).__name__} is under-actuated: its torques "
            f"({', '.join(model.actuators) or 'none'}) cannot realise any motion of all its coordinates "
            f"({', '.join(model.coordinates)}). Use al.HybridDynamics, which prescribes as many coordinates as "
            "there are torques, or al.ForwardDynamics."
        )


def _driving(model: AbstractMechanical, motion: Any) -> tuple[str, ...]:
    """The coordinates that a motion of a constrained model prescribes: as many as may be chosen."""
    speeds, names = len(model.speeds), model.coordinates
    least, most = speeds - len(model.constraints), speeds - len(model.holonomic)
    if isinstance(motion, Mapping):
        names = tuple(name for name in names if name in motion)
    if not names or not least <= len(model.speeds_along(names)) <= most:
        raise ProblemError(
            f"InverseDynamics of {type(model).__name__}: expected trajectories by name for {least} of "
            f"{list(model.coordinates)}: as many as its {len(model.constraints)} constraints leave free"
            + (f", or for up to {most} that obey its velocity constraints" if most > least else "")
            + f"; received {motion!r}. Use al.HybridDynamics to prescribe fewer."
        )
    return names


@final
class HybridDynamics(AbstractFormulation):
    """A mechanical system with some coordinates prescribed; the others follow from the dynamics (table 5.2).

    - `model`: a mechanical system, under-actuated or not;
    - `motion`: trajectories by the names of the prescribed coordinates: as many as there are unknown torques, or fewer
      (then the torques of least norm within the model's `torque_bounds` are found);
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
        a_model("HybridDynamics", model)
        torque = {} if torque is None else torque
        for given, names, what in ((motion, model.coordinates, "motion"), (torque, model.actuators, "torque")):
            if not isinstance(given, Mapping) or not set(given) <= set(names):
                raise ProblemError(
                    f"HybridDynamics, {what}: expected trajectories by name, for some of {list(names)}; received "
                    f"{given!r}."
                )
        if not 0 < len(motion) < len(model.coordinates):
            raise ProblemError(
                f"HybridDynamics of {type(model).__name__}: expected some of {list(model.coordinates)} as prescribed "
                f"motion, but not all; received {list(motion)}. Use al.InverseDynamics for all, al.ForwardDynamics for "
                "none."
            )
        prescribed, known = (
            tuple(name for name in names if name in given)
            for names, given in ((model.coordinates, motion), (model.actuators, torque))
        )
        super().__init__(model, motion, torque, start, guess, torque_rates, prescribed=prescribed, known=known)
        if len(self.parts.unknown) < len(self.parts.driven) - self.parts.surplus:
            raise ProblemError(self.unrealisable())
