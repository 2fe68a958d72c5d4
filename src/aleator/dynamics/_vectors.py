"""Chains of vectors in the plane or in space: from a short description to their resultant."""

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator.dynamics._formula import PREVIOUS, Formula, evaluate, read_formula


class Vector(NamedTuple):
    """A length and its direction in degrees: one angle in the plane, azimuth and elevation in space."""

    length: Formula
    direction: tuple[Formula, ...]


class Chain(NamedTuple):
    """Vectors in a row, each starting at the tip of the one before."""

    vectors: tuple[Vector, ...]

    @property
    def components(self) -> int:
        """3 if any vector has an elevation (space), else 2 (plane)."""
        return 1 + max(len(one.direction) for one in self.vectors)

    @property
    def formulas(self) -> tuple[Formula, ...]:
        """All lengths and directions."""
        return tuple(formula for one in self.vectors for formula in (one.length, *one.direction))

    def resultant(self, values: Mapping[str, Any]) -> Float[Array, " components"]:
        """The sum of the vectors: x, y and, in space, z."""
        total = jnp.zeros(3)
        before: tuple[Any, ...] = ()
        for vector in self.vectors:
            angles = tuple(
                evaluate(formula, {**values, PREVIOUS: previous} if before else values)
                for formula, previous in zip(_padded(vector.direction), before or (0.0, 0.0), strict=True)
            )
            azimuth, elevation = map(jnp.deg2rad, angles)
            along = jnp.cos(elevation)
            unit = jnp.stack([along * jnp.cos(azimuth), along * jnp.sin(azimuth), jnp.sin(elevation)])
            total, before = total + evaluate(vector.length, values) * unit, angles
        return total[: self.components]


def _padded(direction: tuple[Formula, ...]) -> tuple[Formula, ...]:
    return (*direction, 0.0)[:2]


def is_chain(given: Any) -> bool:
    """Whether a description is a list of vectors rather than a formula."""
    return isinstance(given, list | tuple)


def read_chain(given: Any, known: Collection[str], where: str) -> Chain:
    """A chain from its description `[(length, direction), ...]`."""
    if not is_chain(given) or len(given) < 2:
        raise ProblemError(f"{where}: expected two or more vectors, [(length, direction), ...]; received {given!r}.")
    return Chain(tuple(_read_vector(one, known, f"{where}, vector {i + 1}", i == 0) for i, one in enumerate(given)))


def _read_vector(given: Any, known: Collection[str], where: str, is_first: bool) -> Vector:
    if not (is_chain(given) and len(given) == 2):
        raise ProblemError(f"{where}: expected (length, direction), such as ('a', 90); received {given!r}.")
    length, direction = given
    angles = tuple(direction) if is_chain(direction) else (direction,)
    if len(angles) not in (1, 2):
        raise ProblemError(
            f"{where}: expected a direction in degrees or, in space, (azimuth, elevation); received {direction!r}."
        )
    turning = known if is_first else {*known, PREVIOUS}
    return Vector(read_formula(length, known, where), tuple(read_formula(one, turning, where) for one in angles))
