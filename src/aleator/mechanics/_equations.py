"""Mechanical systems from a user's own functions: matrices, energies, or any right-hand side."""

import abc
from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.mechanics._instant import along_time
from aleator.mechanics._mechanical import AbstractMechanical, value_of

_QUADRATIC = (
    "kinetic_energy(q, v): expected a quadratic function of the velocities, whose second derivatives are the mass "
    "matrix at any velocity. Use al.Accelerations for others."
)
_AFFINE = (
    "accelerations(q, v, torque): expected accelerations affine in the torques, with an effect independent of the "
    "velocities. Plan the non-affine term itself as the torque."
)


class AbstractNamed(AbstractMechanical):
    """A mechanical system with names declared in its class: `names = ("shoulder", "elbow")`.

    `velocity_names` and `actuator_names` may be declared too, where there is not one for each coordinate. Coordinates
    that are bound by equations are declared by `constraint_names` and `constraint(q)`:

        constraint_names = ("height",)

        def constraint(self, q):
            return (self.crank * jnp.sin(q[0]) - self.rod * jnp.sin(q[1]),)

    Velocities that are bound where coordinates are not, as of a wheel that rolls, are declared by
    `velocity_constraint_names` and `velocity_constraint(q, v)`, linear in the velocities:

        velocity_constraint_names = ("rolling",)

        def velocity_constraint(self, q, v):
            return (v[0] - self.radius * v[1],)
    """

    names: ClassVar[tuple[str, ...]]
    velocity_names: ClassVar[Sequence[str] | None] = None
    actuator_names: ClassVar[Sequence[str] | None] = None
    _declared: ClassVar[tuple[str, ...]] = ("names", "velocity_names", "actuator_names", *AbstractMechanical._declared)

    def __check_init__(self):
        for field in self._declared:
            if isinstance(given := getattr(self, field, None), str):
                raise ProblemError(
                    f"{type(self).__name__}.{field}: expected names in a tuple; received the text {given!r}. A single "
                    f"name needs a comma: ({given!r},)."
                )

    @property
    @override
    def coordinates(self) -> tuple[str, ...]:
        return tuple(self.names)

    @property
    @override
    def speeds(self) -> tuple[str, ...]:
        return super().speeds if self.velocity_names is None else tuple(self.velocity_names)

    @property
    @override
    def actuators(self) -> tuple[str, ...]:
        return super().actuators if self.actuator_names is None else tuple(self.actuator_names)


class Mechanical(AbstractNamed):
    """A mechanical system by its matrices: `M(q) v̇ + C(q, v) v + N(q, v) = B(q) τ + Q(q, v)`, `q̇ = H(q) v`, (3), (4).

    Subclass it with the coordinates' names in `names`, and write `mass_matrix(q)`; as needed, also `coriolis(q, v)`,
    `forces(q, v)` (gravity, springs, friction; on the left-hand side, so that weight is positive upwards),
    `actuation(q)`, `velocity_map(q)`, and `load(q, v)`, the external force on the side of the torques.

    Each may also take the time: `mass_matrix(q, t)`. Equation (3) then holds with the matrices of the instant, without
    a term `Ṁ v`: mass is gained or lost at the velocity of its body, like sand that runs out of a cart. Mass that
    leaves at another velocity exerts a force of its own: a rocket's thrust is a `load`.
    """

    def coriolis(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, "speeds speeds"]:
        """`C(q, v)`: centrifugal, gyroscopic and Coriolis effects; zero by default."""
        del q
        return jnp.zeros((len(v), len(v)))

    def forces(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        """`N(q, v)`: gravity, springs and friction; zero by default."""
        del q
        return jnp.zeros(len(v))

    @override
    def bias(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        return value_of(self, "coriolis", q, v) @ v + value_of(self, "forces", q, v)


class Lagrangian(AbstractNamed):
    """A mechanical system by its energies, with `v = q̇`: Lagrange's equations, with exact derivatives.

    Subclass it with the coordinates' names in `names`, and write `kinetic_energy(q, v)` and, as needed,
    `potential_energy(q)` and `dissipation(q, v)`, Rayleigh's function `R` with friction `-dR/dv`. Each returns one
    number, J (`R`: W).

    Each may also take the time, `kinetic_energy(q, v, t)`: for example, for a pendulum with a moving support, with
    absolute velocities. Lagrange's equations then hold in full, `d/dt(dT/dv) - dT/dq`. Unlike in `al.Mechanical`,
    masses that change with time conserve momentum, as if added mass had been at rest, and a term `Ṁ v` is included.
    """

    @abc.abstractmethod
    def kinetic_energy(self, q: Float[Array, " n"], v: Float[Array, " n"]) -> Float[Array, ""]:
        """The kinetic energy, J: a quadratic function of `v`."""

    def potential_energy(self, q: Float[Array, " n"]) -> Any:
        """The potential energy, J; zero by default."""
        del q
        return 0.0

    def dissipation(self, q: Float[Array, " n"], v: Float[Array, " n"]) -> Any:
        """Rayleigh's dissipation function, W; zero by default."""
        del q, v
        return 0.0

    def mass_matrix(self, q: Float[Array, " n"]) -> Float[Array, "n n"]:
        """`M = d²T/dv²`."""
        return self._inertia(q, jnp.zeros_like(q))

    @override
    def bias(self, q: Float[Array, " n"], v: Float[Array, " n"]) -> Float[Array, " n"]:
        """`d/dt(dT/dv) - dT/dq` without its acceleration term, plus `dV/dq` and `dR/dv`.

        The momentum `dT/dv` changes with the coordinates, with time, and with parameters that depend on time.
        """

        def momentum(model: Lagrangian, at: Array) -> Array:
            return jax.grad(model._kinetic, argnums=1)(at, v)

        change = along_time(momentum, self, (q,), (v,))[1]
        return change - jax.grad(self._kinetic)(q, v) + self._forces(q, v)

    @override
    def stated_twice(self, q: Float[Array, " n"]) -> dict[str, tuple[Array, Array]]:
        """The mass matrix in motion and at rest: the kinetic energy is quadratic in the velocities."""
        both = self._inertia(q, jnp.linspace(0.4, 0.7, len(q))), self._inertia(q, jnp.zeros_like(q))
        return {_QUADRATIC: both}

    def _forces(self, q: Array, v: Array) -> Array:
        potential = jax.grad(lambda at: value_of(self, "potential_energy", at))(q)
        return potential + jax.grad(lambda at: value_of(self, "dissipation", q, at))(v)

    def _kinetic(self, q: Array, v: Array) -> Array:
        return value_of(self, "kinetic_energy", q, v)

    def _inertia(self, q: Array, v: Array) -> Array:
        return jax.jacfwd(jax.grad(self._kinetic, argnums=1), argnums=1)(q, v)


class Accelerations(AbstractNamed):
    """A mechanical system by any right-hand side `v̇ = f(q, v, τ)` that is affine in the torques.

    Subclass it with the coordinates' names in `names`, and write `accelerations(q, v, torque)`. Its mass matrix is the
    identity, and its forces are accelerations. The effect of the torques may depend on the coordinates, not on the
    velocities.
    """

    def __check_init__(self):
        if self.constraints:
            raise ProblemError(
                f"{type(self).__name__}: constraints act by forces, for which masses must be known: write "
                "al.Mechanical or al.Lagrangian in the place of al.Accelerations."
            )

    @abc.abstractmethod
    def accelerations(self, q: Array, v: Array, torque: Array) -> Any:
        """The accelerations `v̇`, shape (speeds,): affine in `torque`, shape (actuators,)."""

    def mass_matrix(self, q: Float[Array, " coordinates"]) -> Float[Array, "speeds speeds"]:
        """The identity."""
        del q
        return jnp.eye(len(self.speeds))

    @override
    def bias(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        return -self._rates(q, v, jnp.zeros(len(self.actuators)))

    @override
    def actuation(self, q: Float[Array, " coordinates"]) -> Float[Array, "speeds actuators"]:
        """The derivative of the accelerations with respect to the torques, at rest."""
        at_rest = jnp.zeros(len(self.speeds))
        return jax.jacfwd(lambda torque: self._rates(q, at_rest, torque))(jnp.zeros(len(self.actuators)))

    @override
    def stated_twice(self, q: Float[Array, " coordinates"]) -> dict[str, tuple[Array, Array]]:
        """Accelerations, and what they are if they are affine in the torques."""
        v, torque = jnp.linspace(0.4, 0.7, len(self.speeds)), jnp.linspace(0.6, 1.3, len(self.actuators))
        return {
            _AFFINE: (self._rates(q, v, torque), value_of(self, "actuation", q) @ torque - value_of(self, "bias", q, v))
        }

    def _rates(self, q: Array, v: Array, torque: Array) -> Array:
        return value_of(self, "accelerations", q, v, torque)
