"""Germ points at probability levels, and work on many of them in batches: of one size, in order, on all devices."""

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree, jax_array
from aleator._core.compilation import Compiled
from aleator._core.errors import AleatorWarning, warn_outside
from aleator._core.parallel import over_devices, working
from aleator.uncertainty import AbstractGerm

# Systems whose histories are held in memory at a time: larger batches gain little time.
_TOGETHER = 64

# Work that takes longer than this is announced, s.
_LONG = 60.0


def at_levels(
    germs: Collection[AbstractGerm], levels: Float[np.ndarray, "n variables"]
) -> Float[np.ndarray, "n variables"]:
    """Germ points at given probability levels between 0 and 1, one column per germ variable."""
    columns = [germ.quantile(levels[:, i]) for i, germ in enumerate(germs)]
    return np.stack(columns, axis=1) if columns else levels


def random_levels(generator: np.random.Generator, *shape: int) -> Float[np.ndarray, "..."]:
    """Independent probability levels, never 0 or 1, where unbounded distributions are infinite."""
    # The generator excludes its upper end, but not its lower one.
    return generator.uniform(np.finfo(float).tiny, 1.0, shape)


def even_levels(generator: np.random.Generator, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
    """Random probability levels, one in each of `count` equal parts of every variable (a Latin hypercube)."""
    parts = generator.permuted(np.tile(np.arange(count)[:, None], variables), axis=0)
    return np.minimum((parts + random_levels(generator, count, variables)) / count, 1 - np.finfo(float).eps)


def draw(
    germs: Collection[AbstractGerm], count: int, generator: np.random.Generator
) -> Float[np.ndarray, "count variables"]:
    """Independent random germ points."""
    return at_levels(germs, random_levels(generator, count, len(germs)))


def drawn_from(
    germs: Collection[AbstractGerm], seed: int, first: int, count: int
) -> Float[np.ndarray, "count variables"]:
    """Those of the random germ points of a seed that follow the `first` ones: all of them together are one `draw`."""
    bits = np.random.PCG64(seed)
    # One state of the generator for each number.
    bits.advance(first * len(germs))
    return draw(germs, count, np.random.Generator(bits))


_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Part(NamedTuple):
    """A batch: how many points come before it, and its points."""

    first: int
    points: Float[np.ndarray, "some variables"]


def parts(points: Float[np.ndarray, "n variables"], size: int) -> list[Part]:
    """The points in parts of `size`; the last part may be smaller."""
    return [Part(first, points[first : first + size]) for first in range(0, len(points), size)]


def fill(points: Float[np.ndarray, "some variables"], size: int) -> Float[np.ndarray, "size variables"]:
    """The points, repeated until there are `size` of them, so that one compiled size serves all parts."""
    return points if len(points) == size else np.resize(points, (size, points.shape[1]))


def each(
    work: Callable[[_Item], _Result], some: Sequence[_Item], *, at_once: bool = True
) -> Iterator[tuple[_Item, _Result]]:
    """The results of `work` for each part, in order. Every evaluation in batches goes through here.

    With `at_once`, as many parts are evaluated in parallel as there are cores, each on one of JAX's devices in turn,
    with the digits of a plain loop. Only executables may be: a user's function need not be thread-safe. Warns with
    `AleatorWarning` if the parts will take more than a minute.
    """

    def worked(part: _Item) -> tuple[_Item, _Result]:
        return part, work(part)

    # Any other ordered map, such as that of an executor, would go here. The first executables are compiled on the way.
    if at_once:
        return announced(over_devices(worked, some), len(some), unlike=working(), like=working())
    return announced(map(worked, some), len(some), unlike=0, like=1)


def announced(
    results: Iterator[_Result], total: int, *, unlike: int, like: int, clock: Callable[[], float] = time.monotonic
) -> Iterator[_Result]:
    """The results as they come; warns with `AleatorWarning` if those to come will take more than a minute.

    The pace is that of `like` results after the first ones, which are `unlike` the others.
    """
    began = clock()
    for done, result in enumerate(results, 1):
        if done == unlike:
            began = clock()
        elif done == unlike + like:
            pace = (clock() - began) / like
            if (left := pace * (total - done)) > _LONG:
                message = (
                    f"{total} batches take {pace:.2g} s each: the next {total - done} about {left / 60:.2g} minutes."
                )
                warn_outside(message, AleatorWarning)
        yield result


def in_batches(
    program: Compiled, model: Pytree, points: Float[np.ndarray, "n variables"], decisions: Float[Array, " n_x"]
) -> Pytree:
    """The results of `program(model, points, decisions)` at any number of points, as NumPy arrays; compiled for 64."""

    def outputs(part: Part) -> Pytree:
        values = program(model, jax_array(fill(part.points, _TOGETHER)), decisions)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(part.points)], values)

    if len(points) > _TOGETHER:
        # Traced here, because only the calling thread may run a user's code.
        program.prepare(model, jax_array(points[:_TOGETHER]), decisions)
    return joined(outputs, points, _TOGETHER)


def joined(work: Callable[[Part], Pytree], points: Float[np.ndarray, "n variables"], size: int) -> Pytree:
    """The results of `work` for parts of the points, of `size` or fewer, one after the other as NumPy arrays."""
    results = [values for _, values in each(work, parts(points, size))]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *results)
