"""`AbstractMechanical`: the interface of mechanical systems to their dynamics; their kinematics, and their `Motion`."""

import abc
from collections.abc import Collection, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.border import traceable
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, Printed
from aleator.dynamics import called
from aleator.mechanics._instant import (
    CONSTRAINTS,
    METHODS,
    along_time,
    at,
    call_of,
    course,
    is_timed,
    refuse_lost,
    timed_methods,
)
from aleator.mechanics._matrices import solve_positive
from aleator.mechanics._spatial import Numbers


class Motion(NamedTuple):
    """A mechanical system at one instant, from forward, inverse or hybrid dynamics.

    - `t`: s; `q`, `q_dot`, `q_ddot`: coordinates and their time derivatives, shape (coordinates,);
    - `v`, `v_dot`: generalised velocities and their time derivatives, shape (speeds,); `q_dot = H(q) v`;
    - `torque`: the actuators' torques, shape (actuators,);
    - `multipliers`: Lagrange multipliers `λ` of the constraints, shape (constraints,).
    """

    t: Any
    q: Float[Array, " coordinates"]
    q_dot: Float[Array, " coordinates"]
    q_ddot: Float[Array, " coordinates"]
    v: Float[Array, " speeds"]
    v_dot: Float[Array, " speeds"]
    torque: Float[Array, " actuators"]
    multipliers: Float[Array, " constraints"] = np.zeros(0)  # type: ignore[assignment]


class AbstractMechanical(Module, Printed):
    """A mechanical system `M(q) v̇ + C(q, v) v + N(q, v) = B(q) τ + Q(q, v)`, `q̇ = H(q) v`, equations (3) and (4).

    Its parameters are fields, and any number in a field may be a distribution, a decision or a signal: a parameter
    `θ(t)` that varies with time, such as `al.processes.signal`, `al.processes.RandomProcess` or a trajectory. Methods
    see its value at the instant, a number. A method may also take the time, after its other arguments:
    `mass_matrix(self, q, t)`. Equation (3) holds at each instant: see `al.Mechanical` and `al.Lagrangian` for variable
    masses.

    `Q` is the external `load(q, v)`, included in all three dynamics. `al.ForwardDynamics`, `al.InverseDynamics` or
    `al.HybridDynamics` states which motions and torques are known, and makes a system of the model. Its outputs are, by
    the names of `coordinates`, `speeds` and `actuators`,

    - `<coordinate>`, `<coordinate>_rate`, `<coordinate>_acceleration`; `<speed>`, where it is not a rate, and
      `<speed>_rate`;
    - `<actuator>`, `<actuator>_rate` (`elbow_torque`, `elbow_torque_rate`);
    - of a system with constraints `<constraint>_multiplier`, `<coordinate>_reaction` (their force along each velocity),
      and `constraint_error`, `constraint_rate_error`: the largest `|g|`, and the largest `|ġ|` or velocity constraint;
    - and those of its own `outputs(motion)`.

    Write it as a subclass of `al.Mechanical` (from its matrices), `al.Lagrangian` (from its energies),
    `al.Accelerations` (from any right-hand side) or `al.Multibody` (from bodies and joints).
    """

    units: ClassVar[Mapping[str, str]] = {}
    constraint_names: ClassVar[Sequence[str]] = ()
    velocity_constraint_names: ClassVar[Sequence[str]] = ()
    _declared: ClassVar[tuple[str, ...]] = tuple(CONSTRAINTS)
    _when: Any = eqx.field(default=None, init=False, repr=False)

    def __init_subclass__(cls, **options: Any):
        """Refuse names that say nothing here: of equations that would not be held, of velocities that are others'."""
        super().__init_subclass__(**options)
        for name, value in vars(cls).items():
            is_list = isinstance(value, tuple | list) and all(isinstance(entry, str) for entry in value)
            misnamed = name.endswith("names") or name in ("constraints", "velocities", "torques")
            if is_list and misnamed and not name.startswith("_") and name not in cls._declared:
                raise ProblemError(
                    f"{cls.__name__}.{name} = {value!r}: such names are not known here; expected some of "
                    f"{', '.join(cls._declared)}."
                )
        refuse_lost(cls)

    def __check_init__(self):
        timed_methods(type(self))
        for field, method in CONSTRAINTS.items():
            is_written = getattr(type(self), method) is not getattr(AbstractMechanical, method)
            if not isinstance(getattr(type(self), field), property) and bool(getattr(self, field)) != is_written:
                call = call_of(method)
                raise ProblemError(
                    f"{type(self).__name__}: expected {field} and {call} together, one name for each equation; "
                    f"received no {field if is_written else call}."
                )

    def at(self, t: Any) -> Self:
        """The realised model at the time `t`, s: signals are replaced by values. Trajectories last one second."""
        now = jnp.asarray(t, dtype=float)
        rows = [signal(now) for signal in course(self).values()]
        return at(self, now, rows[0] if rows else None)

    @property
    @abc.abstractmethod
    def coordinates(self) -> tuple[str, ...]:
        """The names of the coordinates `q`."""

    @property
    def speeds(self) -> tuple[str, ...]:
        """The names of the generalised velocities `v`: by default the rates of the coordinates."""
        return tuple(f"{name}_rate" for name in self.coordinates)

    @property
    def actuators(self) -> tuple[str, ...]:
        """The names of the torques `τ`: by default one acts along each velocity."""
        return tuple(f"{name.removesuffix('_rate')}_torque" for name in self.speeds)

    @property
    def standard_units(self) -> Mapping[str, str]:
        """The units of coordinates, velocities and torques, as far as known; `units` overrides them."""
        return {}

    @property
    def constraints(self) -> tuple[str, ...]:
        """The names of all constraints: of those that bind coordinates, then `velocity_constraint_names`."""
        return (*self.holonomic, *self.velocity_constraint_names)

    @property
    def holonomic(self) -> tuple[str, ...]:
        """The names of the equations `g(q, t) = 0` that bind coordinates: of closed loops, then `constraint_names`."""
        return (*self.closing_names, *self.constraint_names)

    @property
    def closing_names(self) -> tuple[str, ...]:
        """The names of the equations of closed loops; none by default."""
        return ()

    def closing(self, q: Float[Array, " coordinates"]) -> Float[Array, " closing"]:
        """What is left of the equations of closed loops."""
        del q
        return jnp.zeros(0)

    def closing_jacobian(self, q: Float[Array, " coordinates"]) -> Float[Array, "closing speeds"]:
        """How the equations of closed loops change with the speeds."""
        del q
        return jnp.zeros((0, len(self.speeds)))

    def constraint(self, q: Float[Array, " coordinates"]) -> Any:
        """`g(q)`: what is zero in every posture that the system can take, one number for each of `constraint_names`.

        Its multipliers `λ` are those of `M v̇ + C v + N + Gᵀ λ = B τ + Q`, with `G v = ġ` (equation 6): positive where
        the constraint pushes towards smaller `g`.
        """
        del q
        return jnp.zeros(0)

    def constraint_jacobian(self, q: Float[Array, " coordinates"]) -> Float[Array, "constraints speeds"]:
        """`G(q)`, of `ġ = G v + ∂g/∂t`: by derivatives of `constraint(q)`."""
        slope = jax.jacfwd(lambda at: value_of(self, "constraint", at))(q)
        return slope if self.moves_directly else slope @ value_of(self, "velocity_map", q)

    def velocity_constraint(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Any:
        """`A(q) v + b(q)`: what is zero in every motion, one number for each of `velocity_constraint_names`.

        For rolling and edges, which bind velocities but no coordinates. The multiplier is the force along what the
        constraint holds at zero, `Aᵀ λ` on the side of `Gᵀ λ`: see `constraint`.
        """
        del q, v
        return jnp.zeros(0)

    def torque_bounds(
        self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]
    ) -> Mapping[str, tuple[Any, Any]]:
        """The least and the largest torque of some actuators, by name; `None` for an end without a bound.

        They bound the torques that inverse and hybrid dynamics find: `{"flexor": (0.0, None)}` for what only pulls.
        """
        del q, v
        return {}

    @property
    def is_bounded(self) -> bool:
        """Whether torques may have bounds."""
        return type(self).torque_bounds is not AbstractMechanical.torque_bounds

    @property
    def moves_directly(self) -> bool:
        """Whether the velocities are known to be the rates of the coordinates in every posture."""
        return type(self).velocity_map is AbstractMechanical.velocity_map

    @property
    def acts_directly(self) -> bool:
        """Whether each torque is known to act along its own velocity."""
        own = type(self).actuation is AbstractMechanical.actuation
        return own and np.array_equal(self._named_map(), np.eye(len(self.speeds)))

    @property
    def is_loaded(self) -> bool:
        """Whether there may be an external load."""
        return type(self).load is not AbstractMechanical.load

    @abc.abstractmethod
    def mass_matrix(self, q: Float[Array, " coordinates"]) -> Float[Array, "speeds speeds"]:
        """`M(q)`, symmetric and positive definite."""

    @abc.abstractmethod
    def bias(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        """`C(q, v) v + N(q, v)`: the generalised force at zero acceleration."""

    def actuation(self, q: Float[Array, " coordinates"]) -> Float[Array, "speeds actuators"]:
        """`B(q)`, from torques to generalised forces: by default each torque acts along the velocity that it is named
        after.

        Raises `ProblemError` where a name does not match: `elbow_torque` without `elbow_rate`.
        """
        del q
        return jnp.asarray(self._named_map())

    def velocity_map(self, q: Float[Array, " coordinates"]) -> Float[Array, "coordinates speeds"]:
        """`H(q)`, from velocities to the rates of the coordinates (equation 4): the identity by default."""
        del q
        return jnp.eye(len(self.coordinates))

    def load(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        """`Q(q, v)`: the external generalised force, such as wind or contact, along each velocity; zero by default.

        It has the sign of the torques: positive where it accelerates in the direction of the velocity.
        """
        del q
        return jnp.zeros_like(v)

    def external(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        """The sum of all external loads, as a generalised force."""
        return value_of(self, "load", q, v)

    def normalised(self, q: Float[Numbers, " coordinates"]) -> Float[Numbers, " coordinates"]:
        """The coordinates projected to valid ones, such as unit quaternions; unchanged by default."""
        return q

    def speeds_along(self, coordinates: Collection[str]) -> tuple[int, ...]:
        """The positions of the velocities that some coordinates determine: by default the coordinates' own positions.

        Raises `ProblemError` where they do not determine any by themselves.
        """
        if set(coordinates) == set(self.coordinates):
            return tuple(range(len(self.speeds)))
        if len(self.coordinates) != len(self.speeds):
            raise ProblemError(
                f"{type(self).__name__}: expected one velocity for each coordinate that is given, as Euler angles "
                f"have; received {len(self.coordinates)} coordinates and {len(self.speeds)} velocities."
            )
        return tuple(i for i, name in enumerate(self.coordinates) if name in coordinates)

    def inverse_dynamics(
        self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"], v_dot: Float[Array, " speeds"]
    ) -> Float[Array, " speeds"]:
        """The generalised force `M v̇ + C v + N` that a motion requires (equation 3)."""
        return value_of(self, "mass_matrix", q) @ v_dot + value_of(self, "bias", q, v)

    def forward_dynamics(
        self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"], force: Float[Array, " speeds"]
    ) -> Float[Array, " speeds"]:
        """The acceleration `v̇` under a generalised force; NaN where `M` is singular."""
        return solve_positive(value_of(self, "mass_matrix", q), force - value_of(self, "bias", q, v))

    @property
    def computes_by_numpy(self) -> bool:
        """Whether NumPy alone computes the equations of motion at known numbers, without a program."""
        return False

    def refuse_impossible(self) -> None:
        """Raise `ProblemError` for known numbers that no such system has, such as negative masses."""

    def stated_twice(self, q: Float[Numbers, " coordinates"]) -> dict[str, tuple[Array, Array]]:
        """Rules, in words, each with a quantity by two ways that differ where a model breaks it; none by default."""
        del q
        return {}

    def _named_map(self) -> Float[np.ndarray, "speeds actuators"]:
        """Which torque acts along which velocity, by their names."""
        along, actuators = [f"{name.removesuffix('_rate')}_torque" for name in self.speeds], self.actuators
        if unknown := [name for name in actuators if name not in along]:
            raise ProblemError(
                f"{type(self).__name__}: the names {unknown} do not say along which velocity these torques act; "
                f"expected some of {along}. Rename them, or write actuation(q)."
            )
        return np.array([[float(name == one) for one in actuators] for name in along]).reshape(len(along), -1)

    def prepared(self) -> Self:
        """The model at an instant, which may have computed what does not depend on its posture."""
        return self

    def seen_at(self, q: Float[Numbers, " coordinates"]) -> Self:
        """The model at an instant, which may have computed what several of its methods need at these coordinates."""
        del q
        return self

    def outputs(self, motion: Motion) -> Mapping[str, Any]:
        """Further quantities of interest by name: positions, distances. `motion` has `q`, `v`, `torque` and more."""
        del motion
        return {}


def constraint_of(model: AbstractMechanical, q: Float[Array, " coordinates"]) -> Float[Array, " constraints"]:
    """`g(q)` as an array: of closed loops, then the model's own. Raises `ProblemError` for another shape."""
    loops, own = model.closing(q), len(model.constraint_names)
    return jnp.concatenate([loops, value_of(model, "constraint", q)]) if own else loops


def load_on(model: AbstractMechanical, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Any:
    """`Q(q, v)`; zero, as a number, where there is none. Raises `ProblemError` for another shape."""
    return model.external(q, v) if model.is_loaded else 0.0


def required_force(model: AbstractMechanical, q: Array, v: Array, v_dot: Array) -> Float[Array, " speeds"]:
    """The generalised force that the actuators must provide for a motion, under the external load (equation 69)."""
    force = value_of(model, "inverse_dynamics", q, v, v_dot)
    return force - load_on(model, q, v) if model.is_loaded else force


def driven(model: AbstractMechanical, q: Array, v: Array, force: Array) -> Float[Array, " speeds"]:
    """The acceleration under the actuators' generalised force and the external load (equation 68)."""
    return value_of(model, "forward_dynamics", q, v, force + load_on(model, q, v))


def value_of(model: AbstractMechanical, name: str, *arguments: Any) -> Float[Array, "..."]:
    """The value of a user's method as an array. Raises `ProblemError` for what is none, or has another shape."""
    who, expected = f"{type(model).__name__}.{call_of(name)}", METHODS[name].shape
    array = traceable(who, evaluated(model, name, *arguments))
    if array.shape != (shape := tuple(len(getattr(model, names)) for names in expected)):
        raise ProblemError(f"{who}: expected shape {shape}; received {array.shape}.")
    return array


def evaluated(model: AbstractMechanical, name: str, *arguments: Any) -> Any:
    """The value of a user's method, called with the time if it takes it. Raises `ProblemError` if the time is not
    known.
    """
    if model._when is None and is_timed(model):
        raise ProblemError(
            f"{type(model).__name__} depends on time, which is not known here: use the model at an instant, such as "
            f"model.at(0.0).{name}(...)."
        )
    time = {"t": model._when.t} if model._when is not None and name in timed_methods(type(model)) else {}
    return called(model, getattr(model, name), *arguments, **time)


def rates(model: AbstractMechanical, q: Array, v: Array) -> Float[Array, " coordinates"]:
    """`q̇ = H(q) v`, equation (4)."""
    return v if model.moves_directly else value_of(model, "velocity_map", q) @ v


def accelerations(model: AbstractMechanical, q: Array, v: Array, v_dot: Array) -> Float[Array, " coordinates"]:
    """`q̈ = H v̇ + Ḣ v`, equation (65), with the total derivative `Ḣ` along the motion as a directional derivative."""
    if model.moves_directly:
        return v_dot
    return along_time(rates, model, (q, v), (rates(model, q, v), v_dot))[1]


def on_manifold(model: AbstractMechanical, position: Array, velocity: Array, acceleration: Array) -> Any:
    """The curve projected to valid coordinates (unit quaternions), with its time derivatives."""
    if model.moves_directly:
        return position, velocity, acceleration

    def first(at: Array, along: Array) -> tuple[Array, Array]:
        return jax.jvp(model.normalised, (at,), (along,))

    (q, q_dot), (_, q_ddot) = jax.jvp(first, (position, velocity), (velocity, acceleration))
    return q, q_dot, q_ddot
