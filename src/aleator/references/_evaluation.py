"""A function of uncertain inputs at a whole sample, kept in memory."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from typing import Any, TypeAlias

import jax
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import Pytree
from aleator._core.elsewhere import each_of
from aleator._core.errors import ProblemError
from aleator._core.given import whole as whole_given
from aleator._core.journalled import NOTHING, AbstractParts
from aleator._core.memory import NUMBER, refuse_beyond_memory
from aleator._core.part_by_part import part_by_part
from aleator._core.progress import Progress
from aleator.ensemble import (
    AbstractEnsemble,
    Alone,
    BoxEnsemble,
    CalledEnsemble,
    Function,
    Part,
    at_levels,
    ensemble_for,
    parts,
    uncertain_places,
)

Evaluate: TypeAlias = Callable[[Sequence[Part], int], Iterator[tuple[Part, Pytree]]]
"""The outputs at the points of some parts, in order; none has more points than the number."""

_MOST_BYTES = 2 * 2**30
# Parts of a sample at most whose points are evaluated one by one.
_MOST = 128


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
    ensemble: AbstractEnsemble,
    levels: Float[np.ndarray, "n variables"],
    *,
    batch: int,
    progress: Progress,
    by: Evaluate | None = None,
    so_far: AbstractParts = NOTHING,
) -> Pytree:
    """The outputs at points given by their probability levels: NumPy arrays of shape (n, *shape).

    - `by`: another way to evaluate parts of them (see `by_executor`); `so_far`: what an earlier run has found.

    Raises the errors of an ensemble, and `ProblemError` if the outputs would not fit into memory.
    """
    size = _together(ensemble, len(levels), batch)
    work = by or ensemble.in_parts
    found = part_by_part(list(parts(levels, size)), lambda some: work(some, size), so_far)
    return _gathered(len(levels), found, progress)


def by_executor(verb: str, executor: Executor | None, ensemble: AbstractEnsemble) -> Evaluate | None:
    """How an executor evaluates parts; None without one. Raises `ProblemError` for a black box: it has its own."""
    if executor is None:
        return None
    if isinstance(ensemble, BoxEnsemble):
        raise ProblemError(
            f"{verb}: executor: expected a function; received a black box, which runs its samples in its own way: give "
            "the executor to the black box."
        )
    alone = ensemble.alone()
    return lambda some, size: each_of(executor, _evaluated_there, some, {"ensemble": alone, "size": size}, verb)


def _evaluated_there(ensemble: Alone, items: Sequence[Part], size: int) -> list[Pytree]:
    return [jax.tree.map(np.asarray, values) for _, values in ensemble.again().in_parts(items, size)]


def _together(ensemble: AbstractEnsemble, samples: int, batch: int) -> int:
    """How many points are one part: a called function may take long at each, and is called point by point anyway."""
    return min(batch, -(-samples // _MOST) if isinstance(ensemble, CalledEnsemble) else samples)


def _gathered(total: int, found: Iterable[tuple[Part, Pytree]], progress: Progress) -> Pytree:
    """Outputs at all points, from those of each part."""
    kept, done = None, 0
    progress("Monte Carlo", 0, total)
    for part, values in found:
        kept = _room(total, values) if kept is None else kept
        for whole, some in zip(jax.tree.leaves(kept), jax.tree.leaves(values), strict=True):
            whole[part.first : part.first + len(some)] = some
        done += len(jax.tree.leaves(values)[0])
        progress("Monte Carlo", done, total)
    return kept


def evaluate_kept(
    ensemble: AbstractEnsemble,
    levels: Float[np.ndarray, "n variables"],
    *,
    batch: int,
    progress: Progress,
    by: Evaluate | None,
    so_far: AbstractParts,
) -> Pytree:
    """The same without the samples that a box leaves out, for methods that can do without some."""
    if not isinstance(ensemble, BoxEnsemble):
        return evaluate(ensemble, levels, batch=batch, progress=progress, by=by, so_far=so_far)
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
