"""`Coupling`: a coordinate that follows another one, as gears, differentials and held joints have it."""

from collections.abc import Mapping, Sequence
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.leaves import Module


@final
class Coupling(Module):
    """A coordinate that is a polynomial of another one, of which it is measured from references.

    `follower - rest = coefficients[0] + coefficients[1] (leader - leader_rest) + ...`, up to the fourth power; without
    a leader the follower stays where it is. All in the units of the coordinates, rad or m. Its constraint is called
    `name`.
    """

    name: str = eqx.field(static=True)
    follower: str = eqx.field(static=True)
    leader: str | None = eqx.field(static=True)
    coefficients: Any = (0.0, 1.0, 0.0, 0.0, 0.0)
    rest: Any = 0.0
    leader_rest: Any = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its equations."""
        return (self.name,)

    @property
    def units(self) -> tuple[str, ...]:
        """The units of its multipliers, which are not known: of a torque or a force."""
        return ()

    def residual(self, at: Mapping[str, Any]) -> Float[Array, ""]:
        """What is left of the equation, for coordinates by name."""
        away = 0.0 if self.leader is None else at[self.leader] - self.leader_rest
        return at[self.follower] - self.rest - jnp.polyval(jnp.flip(jnp.asarray(self.coefficients)), jnp.asarray(away))


def parted(closures: Sequence[Any]) -> tuple[list[Any], list[Coupling]]:
    """Joints that close loops, and couplings of coordinates, each in their order."""
    couplings = [one for one in closures if isinstance(one, Coupling)]
    return [one for one in closures if not isinstance(one, Coupling)], couplings
