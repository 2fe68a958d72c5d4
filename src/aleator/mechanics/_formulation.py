"""Systems made from a mechanical model: some coordinates prescribed, the others integrated, some torques known.

Forward dynamics are those with nothing prescribed, inverse dynamics those with everything.
"""

import contextlib
from collections.abc import Collection, Mapping
from types import SimpleNamespace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from typing_extensions import override

from aleator._core.arrays import in_library, jax_array, numbers_to_arrays
from aleator._core.border import one_of
from aleator._core.compilation import Compiled, Use, evaluate
from aleator._core.errors import ProblemError
from aleator._core.identity import identity_of
from aleator._core.leaves import is_traced, transparent
from aleator.dynamics import Grid, RungeKutta4, System, simulate
from aleator.mechanics._arguments import (
    Signals,
    checked_guess,
    checked_start,
    combined,
    coordinates_at,
    motions_for,
    signals_for,
    vector,
)
from aleator.mechanics._constraints import Stated, consistent_start, jacobian_of, velocity_rule
from aleator.mechanics._diagnosis import Examination, Posture, diagnosis
from aleator.mechanics._instant import at, course, instants_of, is_timed, linearised
from aleator.mechanics._matrices import taken
from aleator.mechanics._mechanical import AbstractMechanical, value_of
from aleator.mechanics._partial import (
    Partition,
    Prescribed,
    Solved,
    columns,
    effect_of_torques,
    follow,
    outputs_of,
    solved,
)
from aleator.trajectories import AbstractSignal, AbstractTrajectory


@transparent("model")
class AbstractFormulation(System):
    """A system that solves the equations of motion of a mechanical model for the unknown motions and torques.

    The model's numbers keep their own names, without the prefix `model`. `parts` says what is prescribed and known.
    """

    model: AbstractMechanical
    motion: Signals
    torque: Signals
    start: dict[str, Any]
    guess: dict[str, Any]
    parts: Partition = eqx.field(static=True)
    torque_rates: bool = eqx.field(static=True)

    further_inputs: ClassVar[tuple[str, ...] | None] = ()

    def __init__(
        self,
        model: AbstractMechanical,
        motion: Any = None,
        torque: Any = None,
        start: Mapping[str, Any] | None = None,
        guess: Mapping[str, Any] | None = None,
        torque_rates: bool = True,
        *,
        prescribed: tuple[str, ...] = (),
        known: tuple[str, ...] = (),
    ):
        """`prescribed` are the coordinates that follow `motion`, `known` the actuators whose `torque` is given."""
        kind = type(self).__name__
        self.model, self.torque_rates = model, torque_rates
        self.parts = parts = Partition(
            tuple(i for i, name in enumerate(model.coordinates) if name in prescribed),
            model.speeds_along(prescribed) if prescribed else (),
            tuple(i for i, name in enumerate(model.actuators) if name in known),
            *map(len, (model.coordinates, model.speeds, model.actuators, model.constraints)),
        )
        self.motion = motions_for(prescribed, motion, f"{kind}, motion") if prescribed else {}
        self.torque = signals_for(known, torque, f"{kind}, torque") if known or torque else {}
        loose = taken_names(model.coordinates, parts.others), taken_names(model.speeds, parts.undriven)
        self.start = checked_start(model, (*loose[0], *loose[1]), start, kind)
        self.guess = checked_guess(kind, model, loose, self.start, guess)

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """Coordinates and velocities that are not prescribed; no velocities where constraints determine all of them."""
        if not self.parts.others:
            return ()
        return ("q",) if len(self.parts.undriven) <= self.parts.constraints else ("q", "v")

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """The units that the model declares, and the standard units of its kind."""
        return {**self.model.standard_units, **self.model.units}

    @property
    def rates_of(self) -> Mapping[str, str]:  # type: ignore[override]
        """Outputs that are rates of others, by name."""
        model, rates = self.model, dict[str, str]()
        for name in model.coordinates:
            rates |= {f"{name}_rate": name, f"{name}_acceleration": f"{name}_rate"}
        return rates | {f"{name}_rate": name for name in (*model.speeds, *model.actuators)}

    @property
    @override
    def formulated(self) -> AbstractMechanical:
        return self.model

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        signals = dict[str, AbstractSignal]()
        if self.parts.prescribed:
            signals["position"] = motion = self._motion()
            names = ("velocity", "acceleration", "jerk")[: 3 if self.torque_rates else 2]
            signals |= {name: motion.derivative(order) for order, name in enumerate(names, 1)}
        if self.parts.known:
            signals["torque"] = torque = combined(self._known_names(), self.torque)
            if isinstance(torque, AbstractTrajectory) and torque.derivatives > 0:
                signals["torque_rate"] = torque.derivative()
        return signals | course(self.model, self.torque_rates and bool(self.parts.prescribed))

    @override
    def initial(self) -> Mapping[str, Any]:
        model = self.model
        if self.states and model.constraints and (self.parts.prescribed or is_timed(model)):
            raise ProblemError(
                f"{type(self).__name__} of {type(model).__name__}: the start follows from its constraints and what is "
                "prescribed at the first instant, which is known only where it is integrated. Simulate it."
            )
        return self.starting(np.zeros(()), {})

    @property
    @override
    def solves_start(self) -> bool:
        return bool(self.states and self.model.constraints)

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        """As `started`. Constraints are solved by one program: operation by operation takes several times as long."""
        if self.model.constraints and not is_traced((self, t, inputs)):
            # No program can be traced of some code, such as of what branches on a number.
            with contextlib.suppress(Exception):
                return evaluate(type(self).started, self, t, dict(inputs), use=Use.BRIEF)
        return self.started(t, inputs)

    def started(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        """The states at the start, with the inputs there, as constraints allow."""
        if not self.states:
            return {}
        q, v = self._others_near(), self._speeds_near()
        if self.model.constraints:
            model = at(self.model, t, inputs.get("parameters")).prepared()
            q, v = consistent_start(model, *self._near(model, self._prescribed(inputs)), self._stated())
            q, v = taken(q, self.parts.others), taken(v, self.parts.undriven)
        return dict(zip(self.states, (q, v), strict=False))

    @override
    def allowed_after(self, t: Any, states: dict[str, Any], jump: Collection[str], inputs: Any) -> dict[str, Any]:
        """Constraints change velocities by an impulse of theirs, of the least kinetic energy; coordinates that jumped,
        on the shortest way, if there is one.
        """
        if not (jump and self.model.constraints):
            return states
        model, where = self._instant(t, SimpleNamespace(**states), inputs)
        motion = solved(model, self.parts, *where)
        q, v = taken(motion.q, self.parts.others), taken(motion.v, self.parts.undriven)
        # Other coordinates stay: put back by what integration lost of them, an event would be off its zero.
        jumps = "q" in jump and self.model.holonomic
        q = jnp.where(motion.valid, q, states["q"]) if jumps else states["q"]
        return dict(zip(self.states, (q, v), strict=False))

    @override
    def rhs(self, t: Any, z: Any, **inputs: Any) -> tuple[Array, ...]:
        # Not those of `rates_and_outputs`: diagnosis traces the rates at each stage.
        model, where = self._instant(t, z, inputs)
        return self._rates_of(solved(model, self.parts, *where))

    @override
    def outputs(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        return self.rates_and_outputs(*args, **kwargs)[1]

    @override
    def rates_and_outputs(self, t: Any, z: Any, *args: Any, **inputs: Any) -> tuple[tuple[Array, ...], dict[str, Any]]:
        (model, where), parts = self._instant(t, z, inputs), self.parts
        jerk, torque_rate = inputs.get("jerk"), inputs.get("torque_rate")
        if jerk is None or not parts.unknown or ("torque" in inputs and torque_rate is None):
            whole = solved(model, parts, *where)
            torque_rates = None if parts.unknown else torque_rate
        else:

            def torques(now: AbstractMechanical, *where: Any) -> tuple[Array, Solved]:
                whole = solved(now, parts, *where)
                return whole.torque, whole

            # The integrated motion changes as it is found to.
            whole, change = linearised(torques, model, where)
            moved = Prescribed(inputs["velocity"], inputs["acceleration"], jerk, self._known(torque_rate))
            torque_rates = change(moved, taken(whole.q_dot, parts.others), taken(whole.v_dot, parts.undriven))
        return self._rates_of(whole), outputs_of(model, t, whole, torque_rates)

    def _rates_of(self, motion: Solved) -> tuple[Array, ...]:
        q_dot, v_dot = taken(motion.q_dot, self.parts.others), taken(motion.v_dot, self.parts.undriven)
        return (q_dot, v_dot)[: len(self.states)]

    def _instant(
        self, t: Any, z: Any, inputs: Mapping[str, Any]
    ) -> tuple[AbstractMechanical, tuple[Prescribed, Array, Array]]:
        """The model, what is prescribed, and what is integrated: no velocities where constraints determine them."""
        model = at(self.model, t, inputs.get("parameters")).prepared()
        v = z.v if "v" in self.states else jnp.zeros(len(self.parts.undriven))
        return model, (self._prescribed(inputs), z.q if self.states else jnp.zeros(0), v)

    def _prescribed(self, inputs: Mapping[str, Any]) -> Prescribed:
        known, names = self._known(inputs.get("torque")), ("position", "velocity", "acceleration")
        if not self.parts.prescribed:
            inputs = dict.fromkeys(names, jnp.zeros(0))
        position, velocity, acceleration = (inputs[name] for name in names)
        return Prescribed(position, velocity, acceleration, known)

    def _known(self, torque: Any) -> Array:
        n, model = len(self.parts.known), self.model
        if torque is None:
            return jnp.zeros(n)
        if jnp.shape(torque) not in ((n,), () if n == 1 else (n,)):
            raise ProblemError(
                f"{type(self).__name__} of {type(model).__name__}: expected a torque signal of shape ({n},), one value "
                f"for each of {list(self._known_names())}; received shape {jnp.shape(torque)}. Give scalar signals in "
                "a dict by these names."
            )
        return jnp.reshape(torque, (n,))

    def _others_near(self) -> Array:
        """The coordinates that are not prescribed at the start, as they are given."""
        _, q = in_library(coordinates_at(self.model, {**self.guess, **self.start}))
        return jax_array(taken(q, self.parts.others))

    def _speeds_near(self) -> Array:
        return vector(taken_names(self.model.speeds, self.parts.undriven), self.start)

    def _near(self, model: AbstractMechanical, given: Prescribed) -> tuple[Array, Array]:
        """Coordinates and velocities at the start, those that are not prescribed as they are given."""
        v_u = self._speeds_near()
        start = follow(model, self.parts, given, self._others_near(), v_u)
        return start.q, self.parts.joined(start.v, v_u)

    def _stated(self) -> Stated:
        return Stated.by(self.model, self.start, self.parts.loose)

    def _motion(self) -> AbstractTrajectory:
        motion = combined(taken_names(self.model.coordinates, self.parts.prescribed), self.motion)
        assert isinstance(motion, AbstractTrajectory)
        return motion

    def _known_names(self) -> tuple[str, ...]:
        return taken_names(self.model.actuators, self.parts.known)

    def posture(self, model: AbstractMechanical, q: Array) -> Posture:
        """What diagnosis asks of the model at one instant. Traceable."""
        q, parts = model.normalised(q), self.parts
        model = model.seen_at(q)
        # Of full row rank: by columns where more constraints than velocities follow what is prescribed.
        G = columns(jacobian_of(model, q), parts.undriven) if model.constraints and parts.undriven else None
        return Posture(
            q,
            value_of(model, "mass_matrix", q),
            None if model.moves_directly else value_of(model, "velocity_map", q),
            G if G is None or not parts.surplus else G.T,
            effect_of_torques(model, self.parts, q),
            model.stated_twice(q) | velocity_rule(model, q),
        )

    def path(self, grid: Grid, order: int = 0) -> Array:
        """The coordinates at each instant, those that are not prescribed as at the start; or their derivatives."""
        library, others = in_library(self._others_near() if order == 0 else np.zeros(len(self.parts.others)))
        if not self.parts.prescribed:
            return library.broadcast_to(others, (len(grid.fractions), len(others)))
        motion = self._motion().derivative(order).sampled(grid.fractions, grid.t_start, grid.t_final)
        return motion if not len(others) else jax.vmap(lambda one: self.parts.merged(one, others))(motion)

    def unrealisable(self) -> str:
        """That the unknown torques cannot realise what is prescribed."""
        model, parts = self.model, self.parts
        unknown = ", ".join(taken_names(model.actuators, parts.unknown)) or "none"
        return (
            f"{type(self).__name__} of {type(model).__name__}: the unknown torques ({unknown}) cannot realise a "
            f"prescribed motion of {', '.join(taken_names(model.coordinates, parts.prescribed))}: expected at least "
            f"{len(parts.driven) - parts.surplus} that act on it. Prescribe no more velocities than there are unknown "
            "torques."
        )

    @override
    def diagnose(self, grid: Grid) -> str:
        system, grid = known_arrays((self, grid))
        if system.model.computes_by_numpy and not system.changes:
            model = system.model.prepared()
            object.__setattr__(system, "model", model)
            seen = known_arrays(_examined(system, grid))
        else:
            # Tracing it takes longer than reading code, which tells whether it has been: each of a family is checked.
            numbers = numbers_to_arrays((system, grid))
            code = identity_of(eqx.filter(numbers, eqx.is_array, inverse=True))
            seen = known_arrays(_EXAMINED(*numbers, code) if code else evaluate(_examined, *numbers, use=Use.BRIEF))
            model = known_arrays(at(system.model, *seen.row))
        times = np.asarray(grid.times)

        def speeds() -> Array:
            """The velocities at the start as they are given."""
            curve = (np.asarray(system.path(grid, order))[0] for order in range(3))
            position, velocity, acceleration = (taken(one, self.parts.prescribed) for one in curve)
            given = Prescribed(position, velocity, acceleration, jnp.zeros(0))
            return system._near(model.prepared(), given)[1]

        return diagnosis(model, self.parts, system._stated(), times, seen, speeds, system.unrealisable())

    @property
    def changes(self) -> bool:
        """Whether what is checked may change along the motion."""
        model = self.model
        simple = model.moves_directly and model.acts_directly and not (model.constraints or model.is_bounded)
        return bool(self.states) or is_timed(model) or not simple


def taken_names(names: tuple[str, ...], places: tuple[int, ...]) -> tuple[str, ...]:
    """The names at some places."""
    return tuple(names[i] for i in places)


def known_arrays(tree: Any) -> Any:
    """A tree with NumPy's arrays in the place of JAX's."""
    return jax.tree.map(lambda leaf: np.asarray(leaf) if eqx.is_array(leaf) else leaf, tree)


def a_model(who: str, model: Any) -> AbstractMechanical:
    """The model, unchanged. Raises `ProblemError` for anything but a mechanical system."""
    return one_of(f"{who}: model", model, AbstractMechanical, "al.Lagrangian or al.Multibody")


def _examined(system: AbstractFormulation, grid: Grid, code: str = "") -> Examination:
    del code  # tells programs apart
    model, parts, now = system.model, system.parts, instants_of(system.model, grid)
    row, (_, path) = now.row(0), in_library(system.path(grid))
    near = path[0]
    if not system.changes:
        _, posture = in_library(system.posture(model, near))
        return Examination(row, near, None, *jax.tree.map(lambda one: one[None], (near, posture)))
    q = held = path
    history = dict[str, Any]()
    if system.states:
        only = [*model.coordinates, *model.speeds]
        only += ["constraint_drift"] if model.holonomic else []
        only += ["motion_error"] if parts.may_miss(model) else []
        only += ["torque_shortfall"] if model.is_bounded and parts.driven else []
        history = dict(simulate(system, grid, {}, RungeKutta4(), only=only))
        q = jnp.stack([history[name] for name in model.coordinates], axis=1)
        finite = jnp.isfinite(q)
        last = jax.lax.cummax(jnp.where(finite.all(axis=1), jnp.arange(len(q)), 0))
        held = jnp.where(finite, q, q[last])
    elif parts.may_miss(model) or model.is_bounded:

        def moved(model: AbstractMechanical, position: Array, velocity: Array, acceleration: Array) -> Solved:
            none = jnp.zeros(0)
            return solved(model, parts, Prescribed(position, velocity, acceleration, none), none, none)

        motion = now.each(moved, *(system.path(grid, order) for order in range(3)))
        history = {"motion_error": motion.motion_error, "torque_shortfall": motion.shortfall}
        q = jnp.where(motion.valid[:, None], q, jnp.nan)
    postures = now.each(system.posture, held)
    return Examination(row, near, history, q, postures, path)


_EXAMINED = Compiled(_examined, use=Use.BRIEF)
