"""The numbers of a realisation at one mesh point, and how they stand side by side."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float


class Signals(NamedTuple):
    """The signals of a realisation: the shape of each by name, in the order of `Pointwise.known`, none where they are
    uncertain; whether some are the system's own, of which decisions are not known, whether some may jump, and whether
    some follow from the states that the system begins with.
    """

    shapes: dict[str, tuple[int, ...]]
    are_own: bool
    have_jumps: bool
    follow_states: bool

    @property
    def size(self) -> int:
        """How many numbers they are at one point."""
        return sum(map(math.prod, self.shapes.values()))


@final
@dataclass(frozen=True)
class Shapes:
    """How many states, algebraic variables and signals there are, and the shapes of integrals and of outputs at one
    instant.
    """

    states: int
    algebraic: int
    signals: int
    integrals: tuple[tuple[int, ...], ...]
    outputs: dict[str, tuple[int, ...]]

    def size(self, names: Sequence[str]) -> int:
        """How many numbers some outputs are."""
        return sum(math.prod(self.outputs[name]) for name in names)

    def by_name(self, names: Sequence[str], table: Any) -> dict[str, Any]:
        """Some outputs, side by side along the last axis, by name."""
        return dict(zip(names, apart(table, [self.outputs[name] for name in names]), strict=True))


def apart(numbers: Any, shapes: Sequence[tuple[int, ...]]) -> list[Any]:
    """Arrays of some shapes, from their numbers side by side along the last axis; axes before it are kept."""
    parts, first = [], 0
    for shape in shapes:
        last = first + math.prod(shape)
        parts.append(numbers[..., first:last].reshape(*numbers.shape[:-1], *shape))
        first = last
    return parts


def taken_by(make: Callable[[], Any], numbers: Array) -> tuple[Any, Array]:
    """The first of some numbers in the shapes of what `make` gives, which is not computed, and those after them."""
    like, unravel = ravel_pytree(jax.tree.map(lambda one: jnp.zeros(one.shape), jax.eval_shape(make)))
    return unravel(numbers[: like.size]), numbers[like.size :]


def flat(tree: Any) -> Float[Array, " numbers"]:
    """All numbers of a tree side by side."""
    leaves = [jnp.ravel(one) for one in jax.tree.leaves(tree)]
    return jnp.concatenate([jnp.zeros(0), *leaves])
