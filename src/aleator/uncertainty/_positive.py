"""Numbers that physics requires to be positive (masses, stiffnesses): declared in the model, checked before use."""

import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import numpy as np

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator.uncertainty._decision import Decision
from aleator.uncertainty._distribution import AbstractDistribution
from aleator.uncertainty._survey import AtMean, is_special


def parameter(unit: str = "", *, positive: bool = False, **options: Any) -> Any:
    """A field of a model with its unit: `m_s: float = al.parameter("kg", positive=True)`.

    With `positive`, a number, decision or distribution in this field that can reach zero is refused.
    """
    return eqx.field(metadata={"unit": unit, "positive": positive}, **options)


def fields_of(model: Pytree, path: str = "") -> Iterator[tuple[str, dataclasses.Field, Any]]:
    """The fields of a model and of the modules anywhere inside it: name, field, value."""
    for where, module in jax.tree_util.tree_leaves_with_path(model, is_leaf=_is_module):
        if not _is_module(module) or is_special(module):
            continue
        place = path + "".join(f"{jax.tree_util.keystr((key,), simple=True)}." for key in where)
        for field in dataclasses.fields(module):
            value = getattr(module, field.name, None)
            yield place + field.name, field, value
            if not field.metadata.get("static", False):
                yield from fields_of(value, f"{place}{field.name}.")


def _is_module(node: Any) -> bool:
    return isinstance(node, eqx.Module)


def refuse_nonpositive(model: Pytree) -> None:
    """Raise `ProblemError` if a number declared positive can reach zero, for some germ or some decision."""
    for name, field, value in fields_of(model):
        if not field.metadata.get("positive", False):
            continue
        for leaf in jax.tree.leaves(value, is_leaf=is_special):
            lowest = _lowest(leaf)
            if lowest is not None and not lowest > 0:
                raise ProblemError(_message(name.removeprefix("system."), leaf, lowest))


def _lowest(leaf: Any) -> float | None:
    """The smallest value that a leaf can take."""
    if isinstance(leaf, AtMean):
        leaf = leaf.distribution
    if isinstance(leaf, AbstractDistribution):
        # Both ends, because a spread that may become negative swaps them.
        return float(np.min([float(end) for law in _corners(leaf) for end in law.support()]))
    if isinstance(leaf, Decision):
        return float(np.min(leaf.lower, initial=np.inf))
    if isinstance(leaf, int | float | np.ndarray | jax.Array) and np.asarray(leaf).dtype.kind in "biuf":
        return float(np.min(np.asarray(leaf, dtype=float), initial=np.inf))
    return None


def _corners(law: AbstractDistribution) -> Iterator[AbstractDistribution]:
    """The law at every combination of the bounds of its decisions: its support is monotone in each of them."""
    names = list(law.decisions)
    for ends in itertools.product(("lower", "upper"), repeat=len(names)):
        end = dict(zip(names, ends, strict=True))
        yield law.decided(lambda name, decision, end=end: getattr(decision, end[name]))


def _message(name: str, leaf: Any, lowest: float) -> str:
    shown = leaf.distribution if isinstance(leaf, AtMean) else leaf
    return (
        f"'{name}' must stay positive, but {shown} can reach {lowest:g}. "
        "Reduce its spread, choose a bounded distribution, or raise the lower bound of its decisions."
    )
