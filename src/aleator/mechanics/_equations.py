"""Mechanical systems from a user's own functions: matrices, energies, or any right-hand side."""

import abc
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator.mechanics._mechanical import AbstractNamed


class Mechanical(AbstractNamed):
    """A mechanical system by its matrices: `M(q) v̇ + C(q, v) v + N(q, v) = B(q) τ`, `q̇ = H(q) v`, (3) and (4).

    Subclass it with the coordinates' names in `names`, and write `mass_matrix(q)`; where there are such, `coriolis(q,
    v)`, `forces(q, v)` (gravity, springs, friction; on the left-hand side, so that weight is positive upwards),
    `actuation(q)` and `velocity_map(q)`.
    """

    def coriolis(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, "speeds speeds"]:
        """`C(q, v)`: centrifugal, gyroscopic and Coriolis effects; none by default."""
        del q
        return jnp.zeros((len(v), len(v)))

    def forces(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        """`N(q, v)`: gravity, springs and friction; none by default."""
        del q
        return jnp.zeros(len(v))

    def bias(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        """See `AbstractMechanical.bias`."""
        n = len(self.speeds)
        along = _shaped(self, "coriolis(q, v)", self.coriolis(q, v), (n, n)) @ v
        return along + _shaped(self, "forces(q, v)", self.forces(q, v), (n,))


class Lagrangian(AbstractNamed):
    """A mechanical system by its energies, with `v = q̇`: Lagrange's equations, by exact derivatives.

    Subclass it with the coordinates' names in `names`, and write `kinetic_energy(q, v)` and, where there are such,
    `potential_energy(q)` and `dissipation(q, v)`, Rayleigh's function `R` with friction `-dR/dv`. All give one number,
    J (`R`: W).
    """

    @abc.abstractmethod
    def kinetic_energy(self, q: Float[Array, " n"], v: Float[Array, " n"]) -> Float[Array, ""]:
        """The kinetic energy, J: a quadratic function of `v`."""

    def potential_energy(self, q: Float[Array, " n"]) -> Any:
        """The potential energy, J; none by default."""
        del q
        return 0.0

    def dissipation(self, q: Float[Array, " n"], v: Float[Array, " n"]) -> Any:
        """Rayleigh's dissipation function, W; none by default."""
        del q, v
        return 0.0

    def mass_matrix(self, q: Float[Array, " n"]) -> Float[Array, "n n"]:
        """`M = d²T/dv²`."""
        return jax.jacfwd(jax.grad(self.kinetic_energy, argnums=1), argnums=1)(q, jnp.zeros_like(q))

    def coriolis(self, q: Float[Array, " n"], v: Float[Array, " n"]) -> Float[Array, "n n"]:
        """`C(q, v)` by Christoffel's symbols of `M`: the choice that makes `Ṁ - 2 C` skew-symmetric."""
        slope = jax.jacfwd(self.mass_matrix)(q)  # [i, j, k]: dM_ij / dq_k
        along = slope @ v
        across = jnp.einsum("ikj,k->ij", slope, v)
        return 0.5 * (along + across - across.T)

    def bias(self, q: Float[Array, " n"], v: Float[Array, " n"]) -> Float[Array, " n"]:
        """See `AbstractMechanical.bias`: `d/dt(dT/dv) - dT/dq` without acceleration, `dV/dq` and `dR/dv`."""

        def momentum(at: Array) -> Array:
            return jax.grad(self.kinetic_energy, argnums=1)(at, v)

        change = jax.jvp(momentum, (q,), (v,))[1]
        return change - jax.grad(self.kinetic_energy)(q, v) + self._forces(q, v)

    def _forces(self, q: Array, v: Array) -> Array:
        potential = jax.grad(lambda at: jnp.asarray(self.potential_energy(at), dtype=float))(q)
        return potential + jax.grad(lambda at: jnp.asarray(self.dissipation(q, at), dtype=float))(v)


class Accelerations(AbstractNamed):
    """A mechanical system by any right-hand side `v̇ = f(q, v, τ)` that is affine in the torques.

    Subclass it with the coordinates' names in `names`, and write `accelerations(q, v, torque)`. Its mass matrix is one,
    and its forces are accelerations. What the torques do may depend on the coordinates, not on the velocities.
    """

    @abc.abstractmethod
    def accelerations(self, q: Array, v: Array, torque: Array) -> Any:
        """The accelerations `v̇`, shape (speeds,): affine in `torque`, shape (actuators,)."""

    def mass_matrix(self, q: Float[Array, " coordinates"]) -> Float[Array, "speeds speeds"]:
        """One: see `AbstractMechanical.mass_matrix`."""
        del q
        return jnp.eye(len(self.speeds))

    def bias(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        """See `AbstractMechanical.bias`."""
        return -self._rates(q, v, jnp.zeros(len(self.actuators)))

    def actuation(self, q: Float[Array, " coordinates"]) -> Float[Array, "speeds actuators"]:
        """See `AbstractMechanical.actuation`: how the accelerations change with the torques, at rest."""
        at_rest = jnp.zeros(len(self.speeds))
        return jax.jacfwd(lambda torque: self._rates(q, at_rest, torque))(jnp.zeros(len(self.actuators)))

    def trouble(self, q: Float[Array, " coordinates"]) -> str:
        """See `AbstractMechanical.trouble`: accelerations that are not affine in the torques."""
        v, torque = jnp.linspace(0.4, 0.7, len(self.speeds)), jnp.linspace(0.6, 1.3, len(self.actuators))
        expected = self.actuation(q) @ torque - self.bias(q, v)
        if jnp.allclose(self._rates(q, v, torque), expected, rtol=1e-6, atol=1e-9, equal_nan=True):
            return ""
        return (
            f"{type(self).__name__}.accelerations(q, v, torque): expected them to be affine in the torques, whatever "
            "the velocities are. Make what is not affine part of the torque that is planned."
        )

    def _rates(self, q: Array, v: Array, torque: Array) -> Array:
        given = self.accelerations(q, v, torque)
        return _shaped(self, "accelerations(q, v, torque)", given, (len(self.speeds),))


def _shaped(model: AbstractNamed, part: str, value: Any, shape: tuple[int, ...]) -> Float[Array, "..."]:
    """What a user's method gives, as an array. Raises `ProblemError` for another shape, which would broadcast."""
    found = jnp.asarray(value, dtype=float)
    if found.shape != shape:
        raise ProblemError(f"{type(model).__name__}.{part}: expected shape {shape}; received {found.shape}.")
    return found
