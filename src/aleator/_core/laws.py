"""Laws and decisions as the layers below them know them, by their parts: how to tell them, and how low they reach."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from aleator._core.arrays import decided_bounds


def is_law(node: Any) -> bool:
    """Whether `node` is a distribution, also one that is held at its mean."""
    law = getattr(node, "distribution", node)
    return isinstance(law, eqx.Module) and all(callable(getattr(law, part, None)) for part in ("support", "germ"))


def is_unrealised(node: Any) -> bool:
    """Whether `node` is a law or a decision, which realisation replaces by a number."""
    return isinstance(node, eqx.Module) and (decided_bounds(node) is not None or is_law(node))


def lowest(number: Any) -> float | None:
    """The smallest value that a number of a model can take, for every realisation and decision; -inf if unbounded.

    Of an array, or a sequence, it is the smallest of all entries. Nothing where none is known: numbers may be traced.
    """
    if isinstance(number, list | tuple):
        return min((least for least in map(lowest, number) if least is not None), default=None)
    bounds = decided_bounds(number)
    value = number if bounds is None else bounds[0]
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value)):
        return None
    if is_law(value):
        return lowest_of_law(getattr(value, "distribution", value))
    return None if isinstance(value, eqx.Module) else float(np.min(np.asarray(value, dtype=float), initial=np.inf))


def lowest_of_law(law: Any) -> float:
    """The lower end of a law's support, at the corner of its decisions where it is lowest."""
    with np.errstate(invalid="ignore"), jax.ensure_compile_time_eval():
        corners = [law.decided(lambda name, _, at=corner: at[name]) for corner in law.corners()]
        ends = [float(one.support()[0]) for one in corners]
    # An upper end at infinity leaves "infinity less infinity" at its corner; another corner knows the lower end.
    least = float(np.nanmin(ends))
    return least if law.REACHES_ENDS else float(np.nextafter(least, np.inf))
