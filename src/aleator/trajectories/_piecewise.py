"""`Piecewise`: values at nodes, constant or linear between them, and which side of a jump is meant."""

import math
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from typing import Any, ClassVar, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.leaves import transparent
from aleator.trajectories._trajectory import AbstractTrajectory, Derivative, Fractions, as_array

Tree = TypeVar("Tree")

# A fraction this close to a node is that node, up to rounding.
_AT = 1e-12
# Nodes are whole multiples of a part of the duration, which is not smaller than this.
_FINEST = 10**7


@final
@transparent("levels")
class Piecewise(AbstractTrajectory):
    """Constant over each interval between nodes (degree 0), or linear between its values at the nodes (degree 1).

    - `levels`: one for each interval or one for each node, shape (intervals,) or (intervals + 1,);
    - `nodes`: fractions of the duration, from 0 to 1;
    - `is_before`: whether a value at a jump is that of the interval before it, rather than of the one that begins.
    """

    levels: Any
    nodes: tuple[float, ...] = eqx.field(static=True)
    degree: int = eqx.field(static=True)
    is_before: bool = eqx.field(static=True, default=False)

    curve_fields: ClassVar[tuple[str, ...]] = ("levels",)

    @property
    @override
    def shape(self) -> tuple[int, ...]:
        return ()

    @property
    @override
    def derivatives(self) -> float:
        return self.degree

    @property
    def least_steps(self) -> int:
        """The least number of equal steps of the duration that end one at each node."""
        return _least_steps(self.nodes)

    @override
    def values(self, fractions: Fractions, duration: Any = 1.0, order: int = 0) -> Float[Array, " n"]:
        if order > self.degree:
            return jnp.zeros(len(fractions))
        xp = np if isinstance(fractions, np.ndarray) else jnp
        nodes, levels = xp.asarray(self.nodes), as_array(self.levels)
        first = xp.searchsorted(nodes[1:-1] + (_AT if self.is_before else -_AT), fractions, side="right")
        if self.degree == 0:
            return levels[first]
        length, rise = nodes[first + 1] - nodes[first], levels[first + 1] - levels[first]
        if order == 1:
            return rise / (length * duration)
        return levels[first] + (fractions - nodes[first]) / length * rise

    @override
    def breaks(self) -> Float[np.ndarray, " ends"]:
        return np.array(self.nodes)


@lru_cache(maxsize=256)
def _least_steps(nodes: tuple[float, ...]) -> int:
    return math.lcm(*(Fraction(node).limit_denominator(_FINEST).denominator for node in nodes))


def piecewise_in(tree: Any) -> list[Piecewise]:
    """All such trajectories in a model or a part of it, in order."""
    return [one for one in jax.tree.leaves(tree, is_leaf=_is_piecewise) if _is_piecewise(one)]


def least_steps(tree: Any) -> int:
    """The least number of equal steps that end one at each node of all such trajectories; 1 if there are none."""
    return math.lcm(1, *(one.least_steps for one in piecewise_in(tree)))


def has_jumps(signals: Any) -> bool:
    """Whether any of some signals jumps at a node: a derivative does where its trajectory has a corner."""

    def is_seen(node: Any) -> bool:
        return isinstance(node, Piecewise | Derivative)

    seen = [one for one in jax.tree.leaves(signals, is_leaf=is_seen) if is_seen(one)]
    return any(one.degree == 0 if isinstance(one, Piecewise) else bool(piecewise_in(one)) for one in seen)


def jumps_of(signals: Any) -> Float[np.ndarray, " jumps"]:
    """The fractions of the duration at which any of some signals may jump; none if none does."""
    nodes = [one.nodes[1:-1] for one in piecewise_in(signals)] if has_jumps(signals) else []
    return np.unique(np.concatenate([np.zeros(0), *nodes]))


def before_jumps(signals: Tree) -> Tree:
    """The same signals, whose values at a jump are those before it."""

    def before(node: Any) -> Any:
        return replace(node, is_before=True) if _is_piecewise(node) else node

    return jax.tree.map(before, signals, is_leaf=_is_piecewise)


def _is_piecewise(node: Any) -> bool:
    return isinstance(node, Piecewise)
