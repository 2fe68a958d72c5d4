"""Shapes of what stands side by side: states, signals, integrals and outputs of one realisation."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float


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

    def columns(self, names: Sequence[str], name: str) -> slice:
        """Where an output stands among some that are side by side."""
        before = names[: list(names).index(name)]
        return slice(self.size(before), self.size(before) + self.size([name]))

    def histories(self, names: Sequence[str], rows: Float[Array, " numbers"]) -> dict[str, Array]:
        """Histories of some outputs by name, from all of their numbers, instant by instant."""
        if not names:
            return {}
        table = rows.reshape(-1, self.size(names))
        return {name: table[:, self.columns(names, name)].reshape(-1, *self.outputs[name]) for name in names}


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
