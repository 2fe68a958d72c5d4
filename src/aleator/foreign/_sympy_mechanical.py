"""`SymPyMechanical`: a mechanical system whose matrices are programs made of SymPy's expressions."""

from collections.abc import Mapping
from typing import Any, NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.leaves import transparent
from aleator.foreign._sympy_program import Program
from aleator.mechanics import AbstractMechanical, Motion


class Mechanics(NamedTuple):
    """A mechanical system without its numbers: the structure, which determines what is compiled.

    - `bias`: the forces on the left-hand side at zero torque; `torques`: the effect `B` of the torques, row by row;
    - `rates`: the map `H` from speeds to the coordinates' rates, row by row; none where these are the same;
    - `multipliers`: the names under which outputs read SymPy's multipliers, which have the other sign.
    """

    coordinates: tuple[str, ...]
    speeds: tuple[str, ...]
    actuators: tuple[str, ...]
    constraints: tuple[str, ...]
    multipliers: tuple[str, ...]
    mass: Program
    bias: Program
    torques: Program
    rates: Program | None
    closed: Program
    names: tuple[str, ...]
    outputs: Program
    units: tuple[tuple[str, str], ...]


@final
@transparent("numbers")
class SymPyMechanical(AbstractMechanical):
    """A mechanical system from SymPy; made by `al.foreign.from_kane` and `al.foreign.from_lagrange`."""

    numbers: dict[str, Any]
    equations: Mechanics = eqx.field(static=True)

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """The units of outputs, as far as they are given."""
        return dict(self.equations.units)

    @property
    @override
    def coordinates(self) -> tuple[str, ...]:
        return self.equations.coordinates

    @property
    @override
    def speeds(self) -> tuple[str, ...]:
        return self.equations.speeds

    @property
    @override
    def actuators(self) -> tuple[str, ...]:
        return self.equations.actuators

    @property
    @override
    def constraints(self) -> tuple[str, ...]:
        return self.equations.constraints

    @property
    @override
    def moves_directly(self) -> bool:
        return self.equations.rates is None

    @override
    def mass_matrix(self, q: Float[Array, " coordinates"]) -> Float[Array, "speeds speeds"]:
        return self._matrix(self.equations.mass, q, len(self.speeds), len(self.speeds))

    @override
    def bias(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        speeds = dict(zip(self.speeds, v, strict=True))
        return jnp.stack(self.equations.bias({**self._posture(q), **speeds}))

    @override
    def actuation(self, q: Float[Array, " coordinates"]) -> Float[Array, "speeds actuators"]:
        return self._matrix(self.equations.torques, q, len(self.speeds), len(self.actuators))

    @override
    def velocity_map(self, q: Float[Array, " coordinates"]) -> Float[Array, "coordinates speeds"]:
        if self.equations.rates is None:
            return jnp.eye(len(self.coordinates))
        return self._matrix(self.equations.rates, q, len(self.coordinates), len(self.speeds))

    @override
    def constraint(self, q: Float[Array, " coordinates"]) -> Float[Array, " constraints"]:
        return self._matrix(self.equations.closed, q, len(self.constraints))

    @override
    def outputs(self, motion: Motion) -> dict[str, Array]:
        mine, at = self.equations, motion
        values = self._posture(at.q) | dict(zip(mine.actuators, at.torque, strict=True))
        values |= dict(zip(mine.speeds, at.v, strict=True))
        values |= dict(zip(map(rate_of, mine.speeds), at.v_dot, strict=True))
        values |= dict(zip(map(rate_of, mine.coordinates), at.q_dot, strict=True))
        values |= dict(zip(map(acceleration_of, mine.coordinates), at.q_ddot, strict=True))
        values |= dict(zip(mine.multipliers, -at.multipliers, strict=True)) if mine.multipliers else {}
        return dict(zip(mine.names, mine.outputs(values), strict=True))

    def _posture(self, q: Array) -> dict[str, Any]:
        return {**self.numbers, **dict(zip(self.coordinates, q, strict=True))}

    def _matrix(self, program: Program, q: Array, *shape: int) -> Array:
        entries = program(self._posture(q))
        return jnp.stack(entries).reshape(shape) if entries else jnp.zeros(shape)


# Under these names, which no symbol has, programs read rates and accelerations.
def rate_of(name: str) -> str:
    """The rate of a coordinate or a speed."""
    return f"\0rate of {name}"


def acceleration_of(name: str) -> str:
    """The acceleration of a coordinate."""
    return f"\0acceleration of {name}"
