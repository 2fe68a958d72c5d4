"""A function of uncertain inputs at a whole sample, kept in memory."""

import math
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator._core.given import whole as whole_given
from aleator._core.memory import NUMBER, refuse_beyond_memory
from aleator._core.progress import Progress
from aleator.ensemble import AbstractEnsemble, BoxEnsemble, Function, at_levels, ensemble_for, uncertain_places

_MOST_BYTES = 2 * 2**30


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
    total, kept = len(levels), None
    found = ensemble.in_batches(levels, min(batch, total))
    progress("Monte Carlo", 0, total)
    for part, values in found:
        kept = _room(total, values) if kept is None else kept
        done = part.first + len(part.points)
        for whole, some in zip(jax.tree.leaves(kept), jax.tree.leaves(values), strict=True):
            whole[part.first : done] = some
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
