"""The structure of a model's parts: what they are, whatever their numbers."""

from typing import Any, TypeVar

import jax
import numpy as np

from aleator._core.arrays import is_number
from aleator._core.leaves import is_leaf
from aleator.mechanics._instant import at
from aleator.mechanics._mechanical import AbstractMechanical
from aleator.trajectories import AbstractSignal

Model = TypeVar("Model", bound=AbstractMechanical)
Part = TypeVar("Part")


def with_numbers(model: Model) -> Model:
    """The model with numbers in the place of distributions, decisions and signals."""
    plain = jax.tree.map(_as_number, model, is_leaf=_is_no_number)
    return plain if model._when is not None else at(plain, np.zeros(()), None)


def without_numbers(part: Part) -> Part:
    """The structure of a joint or a closure: it outlives the trace in which its numbers may have been made."""
    return jax.tree.map(lambda leaf: np.zeros(np.shape(leaf)) if is_number(leaf) else leaf, part)


def _is_no_number(node: Any) -> bool:
    return is_leaf(node) or isinstance(node, AbstractSignal)


def _as_number(leaf: Any) -> Any:
    """A placeholder number of the right shape for a distribution, a decision or a signal."""
    if isinstance(leaf, AbstractSignal):
        plain = jax.tree.map(_as_number, leaf, is_leaf=is_leaf)
        return np.ones(jax.eval_shape(plain, jax.ShapeDtypeStruct((), float)).shape)
    return np.ones(leaf.shape) if is_leaf(leaf) else leaf
