"""Polynomials as trajectories: one over the whole duration, or one of degree 0 or 1 between any two nodes."""

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

from aleator._core.arrays import in_library, jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import highest, lowest, realised_shape, stored_numbers, transparent
from aleator.trajectories._jumping import jumping_in
from aleator.trajectories._signals import AbstractTrajectory, Derivative, Fractions, as_array, conditions, instants

_KIND = "PowerSeries"

# A fraction this close to a node is that node, up to rounding.
_AT = 1e-12
# Nodes are whole multiples of a part of the duration, which is not smaller than this.
_FINEST = 10**7


@final
class PowerSeries(AbstractTrajectory):
    """The polynomial `a_1 + a_2 t + a_3 t² + ...` (equation 50) that meets its conditions (equation 51).

    - `start`, `end`: `(value, velocity, acceleration)` there, or the first one or two of them;
    - `middle`: the value at one more instant, such as a `Decision`, or None; `middle_time`: that instant, as a fraction
      of the duration: a number strictly between 0 and 1, or a distribution or `Decision` in that range.

    There are as many coefficients as conditions. Raises `ProblemError` for conditions of different shapes, and for a
    middle time that can reach an end.
    """

    start: tuple[Any, ...]
    end: tuple[Any, ...]
    middle: Any
    middle_time: Any

    curve_fields: ClassVar[tuple[str, ...]] = ("start", "end", "middle")

    def __init__(self, *, start: Any, end: Any = (), middle: Any = None, middle_time: Any = 0.5):
        values = start if isinstance(start, list | tuple) else (start,)
        if not values:
            raise ProblemError(f"{_KIND}: expected at least a value at the start; received none.")
        shape = realised_shape(values[0])
        self.start = conditions(_KIND, "start", start, shape)
        self.end = conditions(_KIND, "end", end, shape)
        self.middle = None if middle is None else stored_numbers(f"{_KIND}: middle", middle)
        if middle is not None and realised_shape(self.middle) != shape:
            raise ProblemError(f"{_KIND}: expected a middle of shape {shape}; received {realised_shape(self.middle)}.")
        self.middle_time = stored_numbers(f"{_KIND}: middle time", middle_time)
        _check_inside(self.middle_time)

    @property
    @override
    def shape(self) -> tuple[int, ...]:
        return realised_shape(self.start[0])

    @override
    def values(self, fractions: Fractions, duration: Any = 1.0, order: int = 0) -> Float[Array, "n ..."]:
        coefficients = self.coefficients(duration)
        library, fractions, coefficients, duration = in_library(fractions, coefficients, duration)
        powers = _powers(fractions, len(coefficients), order)
        return jax_array(library.tensordot(powers, coefficients, axes=1) / duration**order)

    def coefficients(self, duration: Any = 1.0) -> Float[Array, "n ..."]:
        """The coefficients in powers of the fraction of the duration, from the linear system (51)."""
        ends = [(0.0, order, value) for order, value in enumerate(self.start)]
        ends += [(1.0, order, value) for order, value in enumerate(self.end)]
        inner = [] if self.middle is None else [(self.middle_time, 0, self.middle)]
        count = len(ends) + len(inner)
        places, orders, values = zip(*ends, *inner, strict=True)
        library, values, duration = in_library([*map(as_array, values)], duration)
        known, places = in_library([*map(as_array, places)])
        rows = known.stack([_powers(place[None], count, order)[0] for place, order in zip(places, orders, strict=True)])
        wanted = [value * duration**order for value, order in zip(values, orders, strict=True)]
        right = library.stack(wanted).reshape(count, -1)
        # Where all places are known, so is the inverse: a solution takes sixty traced equations.
        found = np.linalg.inv(rows) @ right if known is np else library.linalg.solve(rows, right)
        return jax_array(found.reshape(count, *self.shape))


def _powers(u: Fractions, count: int, order: int) -> Float[np.ndarray | Array, "n count"]:
    """Derivatives of some order of the powers 0 to `count - 1` of `u`."""
    library, u = in_library(u)
    terms = [
        math.perm(power, order) * u ** (power - order) if power >= order else library.zeros_like(u)
        for power in range(count)
    ]
    return library.stack(terms, axis=1)


def _check_inside(time: Any) -> None:
    known = [end for end in (lowest(time), highest(time)) if end is not None]
    if realised_shape(time) != () or not all(0 < end < 1 for end in known):
        raise ProblemError(
            f"{_KIND}: expected a middle time strictly between 0 and 1, as a fraction of the duration, or a "
            f"distribution or a Decision in that range; received {time!r}."
        )


Tree = TypeVar("Tree")


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
    return [node for node in jax.tree.leaves(tree, is_leaf=_is_piecewise) if _is_piecewise(node)]


def least_steps(tree: Any) -> int:
    """The least number of equal steps that end one at each node of all such trajectories; 1 if there are none."""
    return math.lcm(1, *(piecewise.least_steps for piecewise in piecewise_in(tree)))


def has_jumps(signals: Any) -> bool:
    """Whether any of some signals jumps: the derivative of a trajectory does where this has a corner."""

    def is_seen(node: Any) -> bool:
        return isinstance(node, Piecewise | Derivative)

    seen = [node for node in jax.tree.leaves(signals, is_leaf=is_seen) if is_seen(node)]
    at_nodes = (node.degree == 0 if isinstance(node, Piecewise) else bool(piecewise_in(node)) for node in seen)
    return any(at_nodes) or bool(jumping_in(signals))


def jumps_of(signals: Any, t_start: Any, t_final: Any) -> Float[Array, " jumps"]:
    """The times at which any of some signals may jump, s; none if none does."""
    nodes = [piecewise.nodes[1:-1] for piecewise in piecewise_in(signals)] if has_jumps(signals) else []
    at_nodes = instants(np.unique(np.concatenate([np.zeros(0), *nodes])), t_start, t_final)
    return jnp.concatenate([at_nodes, *(one.jumps for one in jumping_in(signals))])


def before_jumps(signals: Tree) -> Tree:
    """The same signals, whose values at a jump are those before it."""

    def before(node: Any) -> Any:
        return replace(node, is_before=True) if _is_piecewise(node) else node

    return jax.tree.map(before, signals, is_leaf=_is_piecewise)


def _is_piecewise(node: Any) -> bool:
    return isinstance(node, Piecewise)
