"""Samples that fail: refused, or dropped with a warning on the bias that this may bring."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from aleator._core.arrays import Pytree
from aleator._core.border import real, refusal
from aleator._core.errors import ProblemError, SimulationError, SimulationWarning, warn_outside
from aleator.ensemble import Realisation, as_outputs, same_shapes

# Inputs of the dropped samples are named where these lie within this part of the range of all samples.
_NARROW = 0.5

# As many inputs as a warning names.
_MOST_NAMED = 3


def drop_given(what: str, drop: Any) -> float:
    """The largest part of the samples that may be dropped, from 0 to less than one half."""
    part = real(what, drop, "a number from 0 to less than 0.5")
    if not 0 <= part < 0.5:
        raise refusal(what, "a number from 0 to less than 0.5", drop)
    return part


def most_of(drop: float, count: int) -> int:
    """How many of `count` samples may be dropped; products such as 0.29 * 100 are not rounded down."""
    return math.floor(drop * count * (1 + 1e-12))


def sound(given: Any, name: str, first: tuple[Realisation, Pytree] | None) -> Pytree:
    """What a box called `name` returned, as finite arrays of the same shapes as those of a `first` sample.

    Raises `SimulationError` if it is anything else, in words that go on after the name of the sample.
    """
    try:
        outputs = as_outputs(given, name, np)
    except ProblemError as error:
        raise SimulationError(str(error).rstrip(".")) from error
    if not jax.tree.leaves(outputs):
        raise SimulationError("it returned no outputs")
    for path, leaf in jax.tree_util.tree_leaves_with_path(outputs):
        if not np.isfinite(leaf).all():
            output = jax.tree_util.keystr(path, simple=True, separator=".")
            bad = leaf[~np.isfinite(leaf)].flat[0]
            raise SimulationError(f"{f'output {output!r}' if output else 'its output'} is {bad}")
    if first is not None and not same_shapes(outputs, first[1]):
        before, now = (_shapes(one) for one in (first[1], outputs))
        raise SimulationError(f"it returned {now}, where sample {first[0].number} had {before}")
    return outputs


def _shapes(outputs: Pytree) -> str:
    """The outputs and their shapes, for messages."""
    named = jax.tree_util.tree_leaves_with_path(outputs)
    texts = [(jax.tree_util.keystr(path, simple=True, separator="."), leaf.shape) for path, leaf in named]
    return ", ".join(f"{name!r} of shape {shape}" if name else f"an array of shape {shape}" for name, shape in texts)


def warn_of_dropped(name: str, realisations: Sequence[Realisation], failures: Mapping[int, str]) -> None:
    """Warn that samples were dropped: how many, why the first one, and where they lie among all.

    `failures`: the reasons, by index into the realisations.
    """
    first = min(failures)
    warn_outside(
        f"{len(failures)} of {len(realisations)} samples of {name} failed and were dropped, first {realisations[first]}"
        f": {failures[first]}. {_whereabouts(realisations, list(failures))} Statistics may be biased: they describe "
        "the inputs at which it works, and an expansion extrapolates to the others.",
        SimulationWarning,
    )


def _whereabouts(realisations: Sequence[Realisation], dropped: Sequence[int]) -> str:
    """In words: whether the dropped samples lie together, and how many others lie among them."""
    names = list(realisations[0].inputs)
    values = np.array([list(one.inputs.values()) for one in realisations])
    low, high = values[dropped].min(axis=0), values[dropped].max(axis=0)
    width = (high - low) / np.maximum(np.ptp(values, axis=0), np.finfo(float).tiny)
    narrow = [i for i in np.argsort(width, kind="stable")[:_MOST_NAMED].tolist() if width[i] <= _NARROW]
    if not narrow or len(dropped) < 2:
        return "They do not lie together." if len(dropped) > 1 else "It may be one of many that would fail nearby."
    among = np.all((values >= low) & (values <= high), axis=1)
    ranges = ", ".join(f"{names[i]} from {low[i]:.4g} to {high[i]:.4g}" for i in sorted(narrow))
    return f"They lie within {ranges}, where {len(dropped)} of {np.count_nonzero(among)} samples failed."
