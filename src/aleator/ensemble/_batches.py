"""Many points in batches: of one compiled size, in order, on all cores."""

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree
from aleator._core.beside import in_order
from aleator._core.compilation import Compiled

# Systems whose histories are held in memory at a time: more of them gain little time.
_TOGETHER = 64
_FINE_TOGETHER = 50

_Result = TypeVar("_Result")


class Part(NamedTuple):
    """Some of many points: how many come before them, and the points themselves."""

    first: int
    points: Float[np.ndarray, "some variables"]


def parts(points: Float[np.ndarray, "n variables"], size: int) -> Iterator[Part]:
    """The points in parts of `size`, the last one of what is left."""
    return (Part(first, points[first : first + size]) for first in range(0, len(points), size))


def fill(points: Float[np.ndarray, "some variables"], size: int) -> Float[np.ndarray, "size variables"]:
    """The points, repeated until there are `size` of them, so that one compiled size serves all parts."""
    return points if len(points) == size else np.resize(points, (size, points.shape[1]))


def each(
    work: Callable[[Part], _Result], some: Iterable[Part], *, at_once: bool = True
) -> Iterator[tuple[Part, _Result]]:
    """What `work` gives for each part, in their order. Every batch of points passes here, whoever evaluates it.

    `at_once` works on as many parts as there are cores, with the digits of a plain loop. That is for executables alone:
    a user's function need not bear to be called by several threads.
    """

    def worked(part: Part) -> tuple[Part, _Result]:
        return part, work(part)

    # Whatever else maps in order, such as an executor, has its place here.
    return in_order(worked, some) if at_once else map(worked, some)


def in_batches(
    program: Compiled, model: Pytree, points: Float[np.ndarray, "n variables"], decisions: Float[Array, " n_x"]
) -> Pytree:
    """What `program(model, points, decisions)` gives at any number of points, as NumPy arrays: compiled for 64."""

    def outputs(part: Part) -> Pytree:
        values = program(model, jnp.asarray(fill(part.points, _TOGETHER)), decisions)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(part.points)], values)

    if len(points) > _TOGETHER:
        # Traced here: a user's code is run by the calling thread alone.
        program.prepare(model, jnp.asarray(points[:_TOGETHER]), decisions)
    found = [values for _, values in each(outputs, parts(points, _TOGETHER))]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *found)


def few_at_once(
    function: Callable[[Float[Array, " variables"]], Pytree], points: Float[Array, "n variables"]
) -> Pytree:
    """A JAX function at each point, some at a time inside one program: fine histories of all would fill the memory."""
    return jax.lax.map(function, points, batch_size=min(_FINE_TOGETHER, len(points)))
