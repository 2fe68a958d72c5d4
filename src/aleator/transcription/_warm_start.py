"""Warm starts from a solution of a coarser or finer problem: decisions by name, curves refitted."""

from collections.abc import Collection, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree, jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import is_leaf
from aleator.design import Problem
from aleator.solution import Solution
from aleator.trajectories import AbstractTrajectory
from aleator.uncertainty import AbstractDecision, at_means, realise

# Gauss points in each piece of the curves, at which they are compared.
_POINTS = 12


def started_from(
    problem: Problem, solution: Solution, given: Collection[str] = (), *, needs_all: bool = True
) -> Float[np.ndarray, " n"]:
    """The decisions of a problem that come closest to a solution of another one, within their bounds.

    Numbers of the same name and shape are copied. If a trajectory in the same place has other control points, knots,
    ends or another degree, its free numbers follow by least squares: the curve over the fraction of time stays the same
    if the new one can represent it, as a spline can whose knots contain the old ones.

    - `given`: names of decisions whose values are given otherwise;
    - `needs_all`: whether decisions that the solution does not have are refused, by a `ProblemError`; else they keep
      their initial values.
    """
    places, old = problem.placements, solution.problem
    curves, known = _curves(problem.simulation), _curves(old.simulation)
    both = [path for path in curves if path in known and curves[path].shape == known[path].shape]
    changed = [path for path in both if not eqx.tree_equal(_undecided(curves[path]), _undecided(known[path]))]
    sought, framed = _sought(problem, [curves[path] for path in changed])
    values = old.placements.named(solution.vector)
    vector = places.vector("initial")
    for name, place in places.decisions.items():
        if name in sought and not (place.decision.shared_name and name in values):
            continue
        if name in values and np.shape(values[name]) == np.shape(place.decision.initial):
            vector[place.where] = np.ravel(values[name])
        elif needs_all and name not in {*given, *sought, *framed}:
            raise ProblemError(_unmatched(name, np.shape(place.decision.initial), values))
    free = [place.where for name, place in places.decisions.items() if name in sought and name not in given]
    if free:
        vector = _refitted(problem, vector, np.r_[tuple(free)], solution, changed)
    return np.clip(vector, places.vector("lower"), places.vector("upper"))


def _curves(model: Pytree) -> dict[str, AbstractTrajectory]:
    """The trajectories of a model that are curves, by their places."""
    leaves = jax.tree_util.tree_leaves_with_path(model, is_leaf=_is_curve)
    return {jax.tree_util.keystr(path): leaf for path, leaf in leaves if _is_curve(leaf)}


def _is_curve(node: Any) -> bool:
    return isinstance(node, AbstractTrajectory) and bool(node.curve_fields)


def _undecided(curve: AbstractTrajectory) -> AbstractTrajectory:
    """A curve but for its decisions: where two are equal, the same decisions give the same curve."""
    return jax.tree.map(lambda leaf: np.zeros(leaf.shape) if is_leaf(leaf) else leaf, curve, is_leaf=is_leaf)


def _sought(problem: Problem, curves: Collection[AbstractTrajectory]) -> tuple[set[str], set[str]]:
    """The names of the decisions in which trajectories are affine, and of those that only move their breaks."""
    sought, framed = set(), set()
    for curve in curves:
        inside = {id(leaf) for field in curve.curve_fields for leaf in _decisions(getattr(curve, field))}
        every = {id(leaf): leaf.shared_name for leaf in _decisions(curve)}
        for name, place in problem.placements.decisions.items():
            if id(place.decision) in every or (place.decision.shared_name and name in every.values()):
                (sought if id(place.decision) in inside else framed).add(name)
    return sought, framed


def _decisions(tree: Pytree) -> list[Any]:
    return [leaf for leaf in jax.tree.leaves(tree, is_leaf=is_leaf) if isinstance(leaf, AbstractDecision)]


def _refitted(
    problem: Problem,
    vector: Float[np.ndarray, " n"],
    free: np.ndarray,
    solution: Solution,
    paths: list[str],
) -> Float[np.ndarray, " n"]:
    """Decisions with entries `free` fitted, so that the curves in some places are closest to those of a solution."""
    old, known = _realised(solution.problem, jax_array(solution.vector), paths)
    breaks = [one.breaks() for curves in (old, _realised(problem, jax_array(vector), paths)[0]) for one in curves]
    fractions, weights = _nodes(np.unique(np.concatenate(breaks)))

    def sampled(curves: list[AbstractTrajectory], duration: Any) -> Array:
        rows = [weights[:, None] * one.values(fractions, duration).reshape(len(fractions), -1) for one in curves]
        return jnp.concatenate([jnp.ravel(one) for one in rows])

    def new(moved: Array) -> Array:
        return sampled(*_realised(problem, jax_array(vector).at[free].set(moved), paths))

    # One program each: single operations would be compiled one by one.
    before = np.asarray(jax.jit(lambda: sampled(old, known))())
    now, slopes = jax.jit(lambda moved: (new(moved), jax.jacfwd(new)(moved)))(jax_array(vector[free]))
    result = vector.copy()
    # The solution of least norm leaves decisions unchanged that do not affect the curve.
    result[free] += np.linalg.lstsq(np.asarray(slopes), before - np.asarray(now), rcond=None)[0]
    return result


def _realised(problem: Problem, vector: Array, paths: list[str]) -> tuple[list[AbstractTrajectory], Any]:
    """The trajectories in some places at the means, and the duration that they fill, s."""
    model = realise(at_means(problem.simulation), jnp.zeros(0), vector)
    curves = _curves(model)
    return [curves[path] for path in paths], model.grid.duration


def _nodes(breaks: Float[np.ndarray, " ends"]) -> tuple[Float[np.ndarray, " nodes"], Float[np.ndarray, " nodes"]]:
    """Gauss's points of all pieces, and the roots of their weights."""
    points, weights = np.polynomial.legendre.leggauss(_POINTS)
    lengths = np.diff(breaks)[:, None]
    fractions = breaks[:-1, None] + 0.5 * (points + 1) * lengths
    return fractions.ravel(), np.sqrt(0.5 * weights * lengths).ravel()


def _unmatched(name: str, shape: tuple[int, ...], values: Mapping[str, Any]) -> str:
    what = f"of shape {shape}" if shape else "of one number"
    there = {known: np.shape(value) for known, value in values.items()}
    received = f"shape {there[name]}" if name in there else f"a solution with the decisions {list(there)}"
    return (
        f"solve: the warm start does not have the decision '{name}': expected a decision of that name and {what}; "
        f"received {received}. Give its value in start={{'{name}': ...}}, or start without the solution."
    )
