"""A function of a model's realisations at many germ points, batch by batch."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import Pytree
from aleator._core.beside import in_order
from aleator._core.errors import ProblemError, SimulationError
from aleator._core.given import whole as whole_given
from aleator._core.memory import NUMBER, refuse_beyond_memory
from aleator._core.progress import Progress
from aleator._core.tracing import trace
from aleator.references._outputs import UNTRACEABLE, Function, real_array
from aleator.uncertainty import Survey, realise, survey, uncertain_numbers

_MOST_BYTES = 2 * 2**30


def uncertain_places(verb: str, function: Function, model: Pytree) -> Survey:
    """What is uncertain in a model. Raises `ProblemError` if nothing is, or if `function` is none."""
    if not callable(function):
        raise ProblemError(f"{verb}: expected a function of the model; received {type(function).__name__}.")
    places = survey(model)
    if not places.distributions:
        raise ProblemError(
            f"{verb}: nothing in the model is uncertain; put a distribution, such as al.Uniform.bounds(0.9, 1.1), in "
            "the place of a number."
        )
    return places


def check_whole(verb: str, **numbers: Any) -> None:
    """Refuse anything but whole numbers, positive unless it is the seed."""
    for name, number in numbers.items():
        whole_given(f"{verb}: {name}", number, least=0 if name == "seed" else 1)


def refuse_large_sample(verb: str, samples: int, variables: int) -> None:
    """Refuse a sample whose inputs, as levels and as germ values, would not fit into memory."""
    what = f"{verb}: {samples} samples of {variables} variables"
    refuse_beyond_memory(what, 2 * NUMBER * samples * variables, "Ask for fewer samples.")


def map_to_germ(places: Survey, levels: Float[np.ndarray, "n variables"]) -> Float[np.ndarray, "n variables"]:
    """Germ points at probability levels in (0, 1)."""
    return np.stack([germ.quantile(levels[:, i]) for i, germ in enumerate(places.germs.values())], axis=1)


def evaluate(
    function: Function,
    model: Pytree,
    levels: Float[np.ndarray, "n variables"],
    *,
    traced: bool,
    batch: int,
    progress: Progress,
) -> Pytree:
    """The outputs at points given by their probability levels: NumPy arrays of shape (n, *shape).

    Raises `SimulationError` where an output is not finite, naming the values of the inputs there, and `ProblemError`
    if the outputs are no real arrays, cannot be traced, or would not fit into memory.
    """
    places, total = survey(model), len(levels)
    decisions, batch = jnp.asarray(places.vector("initial")), min(batch, total)
    outputs = _traced(function, model, decisions, batch) if traced else _called(function, model, decisions)
    begins, kept = range(0, total, batch), None

    def values_at(done: int) -> Pytree:
        germ = map_to_germ(places, levels[done : done + batch])
        values = outputs(germ)
        _refuse_nonfinite(values, germ, places, decisions)
        return values

    # Only what JAX has traced may be called by several threads at once.
    found = in_order(values_at, begins) if traced else map(values_at, begins)
    progress("Monte Carlo", 0, total)
    for done, values in zip(begins, found, strict=True):
        kept = _room(total, values) if kept is None else kept
        _refuse_change(kept, values)
        for whole, part in zip(jax.tree.leaves(kept), jax.tree.leaves(values), strict=True):
            whole[done : done + batch] = part
        progress("Monte Carlo", min(done + batch, total), total)
    return kept


def _room(total: int, values: Pytree) -> Pytree:
    """Empty arrays for all points, of the shapes that the first batch has."""
    shapes = [(total, *leaf.shape[1:]) for leaf in jax.tree.leaves(values)]
    size = sum(8 * math.prod(shape) for shape in shapes)
    if size > _MOST_BYTES:
        raise ProblemError(
            f"Samples are kept whole: expected at most {_MOST_BYTES / 2**30:g} GiB; received outputs of shape "
            f"{', '.join(map(str, shapes))}, {size / 2**30:.3g} GiB. Ask for fewer samples, or return fewer numbers "
            "(every tenth instant, a maximum)."
        )
    return jax.tree.map(lambda leaf: np.empty((total, *leaf.shape[1:])), values)


def _refuse_change(kept: Pytree, values: Pytree) -> None:
    first, now = (
        (jax.tree.structure(tree), [leaf.shape[1:] for leaf in jax.tree.leaves(tree)]) for tree in (kept, values)
    )
    if first != now:
        raise ProblemError(f"The function must return the same arrays at every point; received {first} and {now}.")


def _traced(function: Function, model: Pytree, decisions: jax.Array, batch: int) -> Callable[[np.ndarray], Pytree]:
    """The function vectorised by JAX, traced for this use alone: it may read what changes until the next one."""

    def one(germ: jax.Array) -> Pytree:
        return jax.tree.map(lambda value: real_array(value, jnp), function(realise(model, germ, decisions)))

    variables = len(survey(model).germs)
    name = f"'{getattr(function, '__name__', type(function).__name__)}'"
    try:
        found = trace(jax.vmap(one), jnp.zeros((batch, variables)), code=function, name=name)
    except UNTRACEABLE as error:
        raise ProblemError(
            f"The function cannot be traced by JAX ({str(error).splitlines()[0]}) Write it with jax.numpy, or say "
            "traced=False: it is then called with plain numbers, point by point."
        ) from error

    def outputs(germ: np.ndarray) -> Pytree:
        # The last batch is filled up, so that one compiled size serves all.
        filled = jnp.asarray(np.resize(germ, (batch, variables)))
        return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(germ)], found(filled))

    return outputs


def _called(function: Function, model: Pytree, decisions: jax.Array) -> Callable[[np.ndarray], Pytree]:
    """The function called with plain numbers, point by point."""

    def one(germ: np.ndarray) -> Pytree:
        realised = jax.tree.map(_plain, realise(model, jnp.asarray(germ), decisions))
        return jax.tree.map(lambda value: real_array(value, np), function(realised))

    def outputs(germ: np.ndarray) -> Pytree:
        values = [one(point) for point in germ]
        try:
            return jax.tree.map(lambda *leaves: np.stack(leaves), *values)
        except ValueError as error:
            raise ProblemError(f"The function must return the same arrays at every point: {error}.") from error

    return outputs


def _plain(leaf: Any) -> Any:
    """A realised number as plain Python and NumPy know it."""
    if not isinstance(leaf, jax.Array):
        return leaf
    return leaf.item() if leaf.ndim == 0 else np.asarray(leaf)


def _refuse_nonfinite(values: Pytree, germ: np.ndarray, places: Survey, decisions: jax.Array) -> None:
    for path, leaf in jax.tree_util.tree_leaves_with_path(values):
        good = np.isfinite(leaf).reshape(len(leaf), -1).all(axis=1)
        if good.all():
            continue
        numbers = uncertain_numbers(places, jnp.asarray(germ[np.argmin(good)]), decisions)
        where = ", ".join(f"{name}={float(number):.6g}" for name, number in numbers.items())
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        what = f"the output '{name}'" if name else "the output"
        raise SimulationError(
            f"Monte Carlo: {what} is not finite at {where}. Bound the distributions, or mend the function there."
        )
