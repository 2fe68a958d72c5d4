"""Controls on a mesh: their nodes are among its own, and where it is refined, they follow."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from aleator.design import Problem, declared_anew, integrated_paths
from aleator.dynamics import Grid
from aleator.trajectories import Piecewise, piecewise_in
from aleator.uncertainty import Decision

# Nodes closer than this are the same, up to rounding.
_SAME = 1e-12


def first_nodes(problem: Problem) -> tuple[float, ...]:
    """The nodes of a problem's first mesh, as fractions of the duration: the instants of its grid, the middles between
    them where statistics are integrated over time, and all nodes of its controls.
    """
    assert isinstance(problem.grid, Grid)
    grid, is_integrated = problem.grid, bool(integrated_paths(problem.expressions))
    nodes = np.array(grid.node_fractions if is_integrated else grid.fractions)
    for one in piecewise_in(problem.simulation):
        added = np.array(one.nodes)
        away = np.abs(added[:, None] - nodes).min(axis=1)
        nodes = np.sort(np.append(nodes, added[away > _SAME]))
    return tuple(nodes.tolist())


def whole_parts(problem: Problem, parts: Int[np.ndarray, " intervals"]) -> Int[np.ndarray, " intervals"]:
    """In how many parts intervals are divided: powers of two where there are controls, so that equal steps reach every
    node.
    """
    return 2 ** np.ceil(np.log2(parts)).astype(int) if piecewise_in(problem.simulation) else parts


def followed(
    problem: Problem, decisions: Float[np.ndarray, " n"], nodes: tuple[float, ...]
) -> tuple[Problem, Float[np.ndarray, " finer"]]:
    """The problem with its controls on the nodes of a finer mesh, and its decisions there, interpolated."""
    old = piecewise_in(problem.simulation)
    if not old:
        return problem, decisions

    def finer(node: Any) -> Any:
        return _on(node, nodes) if isinstance(node, Piecewise) else node

    simulation = jax.tree.map(finer, problem.simulation, is_leaf=lambda node: isinstance(node, Piecewise))
    found = declared_anew(problem, simulation)
    curves = {id(new.levels): one for new, one in zip(piecewise_in(found.simulation), old, strict=True)}
    places, vector = problem.placements.decisions, found.placements.vector("initial")
    for name, place in found.placements.decisions.items():
        values, curve = decisions[places[name].where], curves.get(id(place.decision))
        vector[place.where] = values if curve is None else _interpolated(curve, values, nodes)
    return found, vector


def _on(control: Piecewise, nodes: tuple[float, ...]) -> Piecewise:
    decision = control.levels
    if isinstance(decision, Decision):
        parts = (_interpolated(control, one, nodes) for one in (decision.initial, decision.lower, decision.upper))
        return replace(control, levels=Decision(*parts), nodes=nodes)
    return replace(control, levels=_interpolated(control, decision, nodes), nodes=nodes)


def _interpolated(control: Piecewise, levels: Any, nodes: tuple[float, ...]) -> Float[np.ndarray, " finer"]:
    """Levels on finer nodes that give the same function of time; bounds may be infinite."""
    levels, known, new = np.asarray(levels), np.array(control.nodes), np.array(nodes)
    places = new if control.degree else (new[:-1] + new[1:]) / 2
    first = np.clip(np.searchsorted(known, places + _SAME, side="right") - 1, 0, len(known) - 2)
    if control.degree == 0:
        return levels[first]
    share = np.clip((places - known[first]) / np.diff(known)[first], 0.0, 1.0)
    share = np.where(share < _SAME, 0.0, np.where(share > 1 - _SAME, 1.0, share))
    parts = (
        np.where(weight > 0, levels[one], 0.0) * weight for one, weight in ((first, 1 - share), (first + 1, share))
    )
    return sum(parts, start=np.zeros(len(places)))
