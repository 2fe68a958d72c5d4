"""`Mesh`: intervals of a duration, and a scheme's points in them; controls, whose nodes are among its own."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, final

import jax
import numpy as np
from jaxtyping import Float, Int, Num

from aleator._core.errors import ProblemError
from aleator._core.leaves import is_leaf
from aleator.design import Problem, declared_anew, integrated_paths
from aleator.dynamics import AbstractScheme, Grid, Simulation
from aleator.trajectories import Piecewise, jumping_in, piecewise_in
from aleator.uncertainty import Decision

# Nodes closer than this are the same, up to rounding.
_SAME = 1e-12


@final
@dataclass(frozen=True)
class Mesh:
    """Intervals of the duration, and the points of a scheme in them. Ends of intervals are shared.

    - `nodes`: the ends of the intervals, as fractions of the duration; every instant of the grid is one of them;
    - `has_jumps`: whether signals may jump at the nodes. They then have two values there, one for each interval, at
      `places` of their own, and rates are asked of each.
    """

    nodes: tuple[float, ...]
    scheme: AbstractScheme
    has_jumps: bool = False

    @property
    def lengths(self) -> Float[np.ndarray, " intervals"]:
        """The length of each interval, as a fraction of the duration."""
        return np.diff(self.nodes)

    @property
    def points(self) -> Int[np.ndarray, "intervals points"]:
        """The numbers of each interval's points among all."""
        steps = len(self.scheme.points) - 1
        return np.arange(len(self.lengths))[:, None] * steps + np.arange(steps + 1)

    @property
    def fractions(self) -> Float[np.ndarray, " points"]:
        """All points as fractions of the duration."""
        nodes = np.array(self.nodes)
        inside = nodes[:-1, None] + self.lengths[:, None] * self.scheme.points[:-1]
        return np.append(inside.ravel(), nodes[-1])

    @property
    def asked(self) -> Int[np.ndarray, " asked"]:
        """The numbers of the points where blocks begin, in ascending order: each once, if nothing jumps there."""
        return self.points[:, self.scheme.asked].ravel()[self._once]

    @property
    def stages(self) -> Int[np.ndarray, "intervals stages"]:
        """Which of the points `asked` the blocks of each interval begin at."""
        every = self.points[:, self.scheme.asked]
        return np.arange(every.size).reshape(every.shape) if self.has_jumps else np.searchsorted(self.asked, every)

    @property
    def places(self) -> Float[np.ndarray, "places 2"]:
        """Where signals are told: fractions of the duration, each with 1 for signals as they are before a jump there,
        else 0. Nodes are told once, or where signals jump for each interval.
        """
        nodes = np.array(self.nodes)
        inside = nodes[:-1, None] + self.lengths[:, None] * self.scheme.told[:-1]
        every = np.stack(np.broadcast_arrays(np.append(inside, nodes[1:, None], axis=1), 0.0), axis=2)
        every[:, -1, 1] = self.has_jumps
        return self._by_place(every)

    @property
    def sides(self) -> Int[np.ndarray, " places"]:
        """The number of the point that each of the `places` is at, or after."""
        return self._by_place(self.points[:, np.searchsorted(self.scheme.points, self.scheme.told, side="right") - 1])

    @property
    def asked_sides(self) -> Int[np.ndarray, "asked seen"]:
        """Which of the `places` each block depends on."""
        seen = self.scheme.seen
        return self._sides[:, seen].reshape(-1, seen.shape[1])[self._once]

    @property
    def weights(self) -> Float[np.ndarray, " places"]:
        """The scheme's quadrature over the whole duration, for a duration of one."""
        weights = np.zeros(len(self.places))
        np.add.at(weights, self._sides, self.lengths[:, None] * self.scheme.quadrature)
        return weights

    @property
    def weighed(self) -> Int[np.ndarray, " weighed"]:
        """Which of the `places` this quadrature has."""
        return np.flatnonzero(self.weights)

    def refined(self, scheme: AbstractScheme, parts: Int[np.ndarray, " intervals"]) -> "Mesh":
        """The mesh with each interval in so many equal parts, and a scheme in each of these."""
        ends = zip(self.nodes[:-1], self.nodes[1:], parts, strict=True)
        inside = [np.linspace(first, last, count + 1)[:-1] for first, last, count in ends]
        return Mesh((*np.concatenate(inside).tolist(), self.nodes[-1]), scheme, self.has_jumps)

    def instants(self, fractions: Float[np.ndarray, " instants"]) -> Int[np.ndarray, " instants"]:
        """The numbers of the points that some instants are."""
        return np.searchsorted(self.fractions, fractions - _SAME)

    def instant_sides(self, fractions: Float[np.ndarray, " instants"]) -> Int[np.ndarray, " instants"]:
        """Which of the `places` are those of these points: at a jump, that of the interval which begins."""
        return np.searchsorted(self.places[:, 0], fractions + _SAME) - 1

    @property
    def _sides(self) -> Int[np.ndarray, "intervals told"]:
        """The numbers of each interval's places among all."""
        count = len(self.scheme.told)
        apart = count if self.has_jumps else count - 1
        return np.arange(len(self.lengths))[:, None] * apart + np.arange(count)

    def _by_place(self, every: Num[np.ndarray, "intervals told ..."]) -> Num[np.ndarray, "places ..."]:
        """What belongs to the places of each interval, by place."""
        by_place = np.zeros((self._sides[-1, -1] + 1, *every.shape[2:]), dtype=every.dtype)
        by_place[self._sides] = every
        return by_place

    @property
    def _once(self) -> Int[np.ndarray, " asked"]:
        """Which of all intervals' blocks there are: of two that begin at the same point one, if nothing jumps there."""
        every = self.points[:, self.scheme.asked].ravel()
        return np.arange(every.size) if self.has_jumps else np.unique(every, return_index=True)[1]


def first_nodes(problem: Problem, phase: Simulation) -> tuple[float, ...]:
    """The nodes of the first mesh of one of a problem's phases, as fractions of the duration: the instants of its grid,
    the middles between them where statistics are integrated over time, all nodes of its controls, and the jumps of its
    signals.

    Raises `ProblemError` for jumps and nodes that are not at a fixed fraction of the duration.
    """
    grid, is_integrated = phase.grid, bool(integrated_paths(problem.expressions))
    assert isinstance(grid, Grid)
    nodes = np.array(grid.node_fractions if is_integrated else grid.fractions)
    jumping, controls = jumping_in(phase), piecewise_in(phase)
    if grid.until is not None and (jumping or controls):
        raise ProblemError(
            f"Simultaneous: {phase.system.title} follows a signal with jumps or nodes at fixed times, while each "
            f"realisation ends at its own '{grid.until}': intervals of a mesh are shares of that. Give an al.BSpline, "
            "or use al.Sequential(), whose steps follow them."
        )
    moving = [one.times for one in jumping], grid.t_final
    if jumping and any(map(is_leaf, jax.tree.leaves(moving, is_leaf=is_leaf))):
        raise ProblemError(
            "Simultaneous: a signal jumps at a time that is uncertain or decided, or while the final time is: "
            "intervals of a mesh end at jumps, and so these have to stay. Use al.Sequential(), whose steps follow them."
        )
    jumps = [(np.asarray(one.jumps) - grid.t_start) / grid.duration for one in jumping]
    for added in (*(np.array(one.nodes) for one in controls), *jumps):
        added = added[(added > 0) & (added < 1)]
        away = np.abs(added[:, None] - nodes).min(axis=1)
        nodes = np.sort(np.append(nodes, added[away > _SAME]))
    return tuple(nodes.tolist())


def whole_parts(problem: Problem, parts: Int[np.ndarray, " intervals"]) -> Int[np.ndarray, " intervals"]:
    """In how many parts intervals are divided: powers of two where there are controls, so that equal steps reach every
    node.
    """
    return 2 ** np.ceil(np.log2(parts)).astype(int) if piecewise_in(problem.simulation) else parts


def joined(problem: Problem, meshes: Iterable[Mesh]) -> tuple[Mesh, ...]:
    """Meshes of all phases, those that share a control with the same nodes."""
    joint = dict(zip(problem.simulation.phases, meshes, strict=True))
    controls = {name: {id(one) for one in piecewise_in(phase)} for name, phase in problem.simulation.phases.items()}
    for _ in joint:  # along a chain of phases that share one with the next
        for name in joint:
            nodes = np.sort(
                [node for other in joint if controls[name] & controls[other] for node in joint[other].nodes]
            )
            if nodes.size:
                apart = nodes[np.diff(nodes, prepend=-1.0) > _SAME]
                joint[name] = replace(joint[name], nodes=tuple(apart.tolist()))
    return tuple(joint.values())


def followed(
    problem: Problem, decisions: Float[np.ndarray, " n"], meshes: tuple[Mesh, ...]
) -> tuple[Problem, Float[np.ndarray, " finer"]]:
    """The problem with its controls on the nodes of finer meshes, and its decisions there, interpolated."""
    old = piecewise_in(problem.simulation)
    if not old:
        return problem, decisions
    phases = zip(problem.simulation.phases.values(), meshes, strict=True)
    nodes_of = {id(one): mesh.nodes for phase, mesh in phases for one in piecewise_in(phase)}

    def finer(node: Any) -> Any:
        return _on(node, nodes_of[id(node)]) if isinstance(node, Piecewise) else node

    simulation = jax.tree.map(finer, problem.simulation, is_leaf=lambda node: isinstance(node, Piecewise))
    finer_problem = declared_anew(problem, simulation)
    curves = {id(new.levels): one for new, one in zip(piecewise_in(finer_problem.simulation), old, strict=True)}
    places, vector = problem.placements.decisions, finer_problem.placements.vector("initial")
    for name, place in finer_problem.placements.decisions.items():
        values, curve = decisions[places[name].where], curves.get(id(place.decision))
        vector[place.where] = values if curve is None else _interpolated(curve, values, nodes_of[id(curve)])
    return finer_problem, vector


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
