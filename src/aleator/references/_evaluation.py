"""A function of uncertain inputs at a whole sample, kept in memory."""

import math
from collections.abc import Iterable
from concurrent.futures import Executor
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import Pytree
from aleator._core.elsewhere import each_done
from aleator._core.errors import ProblemError
from aleator._core.given import whole as whole_given
from aleator._core.memory import NUMBER, refuse_beyond_memory
from aleator._core.progress import Progress, silent
from aleator.ensemble import (
    AbstractEnsemble,
    Alone,
    BoxEnsemble,
    Function,
    at_levels,
    ensemble_for,
    uncertain_places,
)

_MOST_BYTES = 2 * 2**30
# Calls of an executor at most.
_CALLS = 32


def ensemble_of(verb: str, function: Function, model: Pytree, *, traced: bool) -> AbstractEnsemble:
    """The function at the realisations of a model. Raises `ProblemError` if nothing in the model is uncertain."""
    return ensemble_for(function, model, uncertain_places(verb, function, model), traced=traced)


def check_whole(verb: str, **numbers: Any) -> None:
    """Refuse anything but whole numbers, which must be positive except for the seed."""
    for name, number in numbers.items():
        whole_given(f"{verb}: {name}", number, least=0 if name == "seed" else 1)


def refuse_large_sample(verb: str, samples: int, variables: int) -> None:
    """Refuse a sample whose inputs, as levels and as germ values, would not fit into memory."""
    what = f"{verb}: {samples} samples of {variables} variables"
    refuse_beyond_memory(what, 2 * NUMBER * samples * variables, "Ask for fewer samples.")


def evaluate(
    ensemble: AbstractEnsemble, levels: Float[np.ndarray, "n variables"], *, batch: int, progress: Progress
) -> Pytree:
    """The outputs at points given by their probability levels: NumPy arrays of shape (n, *shape).

    Raises the errors of an ensemble, and `ProblemError` if the outputs would not fit into memory.
    """
    found = ensemble.in_batches(levels, min(batch, len(levels)))
    return _gathered(len(levels), ((part.first, values) for part, values in found), progress)


def evaluate_elsewhere(
    verb: str,
    executor: Executor,
    ensemble: AbstractEnsemble,
    levels: Float[np.ndarray, "n variables"],
    *,
    batch: int,
    progress: Progress,
) -> Pytree:
    """The same by an executor, in batches of the same size. Raises `ProblemError` for a black box: it has its own."""
    if isinstance(ensemble, BoxEnsemble):
        raise ProblemError(
            f"{verb}: executor: expected a function; received a black box, which runs its samples in its own way: give "
            "the executor to the black box."
        )
    batch = min(batch, len(levels))
    size = batch * max(-(-len(levels) // (_CALLS * batch)), 1)
    begins = range(0, len(levels), size)
    calls = [{"ensemble": ensemble.alone(), "levels": levels[first : first + size], "batch": batch} for first in begins]
    found = each_done(executor, _evaluated_there, calls, [verb] * len(calls))
    return _gathered(len(levels), ((begins[i], values) for i, values in found), progress)


def _evaluated_there(ensemble: Alone, levels: Float[np.ndarray, "n variables"], batch: int) -> Pytree:
    found = ensemble.again().in_batches(levels, batch)
    return _gathered(len(levels), ((part.first, values) for part, values in found), silent)


def _gathered(total: int, found: Iterable[tuple[int, Pytree]], progress: Progress) -> Pytree:
    """Outputs at all points, from those at some points together and the number of the first of these."""
    kept, done = None, 0
    progress("Monte Carlo", 0, total)
    for first, values in found:
        kept = _room(total, values) if kept is None else kept
        for whole, some in zip(jax.tree.leaves(kept), jax.tree.leaves(values), strict=True):
            whole[first : first + len(some)] = some
        done += len(jax.tree.leaves(values)[0])
        progress("Monte Carlo", done, total)
    return kept


def evaluate_kept(
    ensemble: AbstractEnsemble, levels: Float[np.ndarray, "n variables"], *, batch: int, progress: Progress
) -> Pytree:
    """The same without the samples that a box leaves out, for methods that can do without some."""
    if not isinstance(ensemble, BoxEnsemble):
        return evaluate(ensemble, levels, batch=batch, progress=progress)
    progress("Monte Carlo", 0, len(levels))
    values, _ = ensemble.kept(at_levels(ensemble.places.germs.values(), levels))
    progress("Monte Carlo", len(levels), len(levels))
    return values


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
