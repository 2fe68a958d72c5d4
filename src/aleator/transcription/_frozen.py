"""A problem apart from its signals: what is known at an instant is given to it as numbers."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Int

from aleator._core.arrays import jax_array
from aleator._core.leaves import is_leaf
from aleator.design import Problem
from aleator.dynamics import Simulation
from aleator.trajectories import AbstractSignal
from aleator.uncertainty import Decision, placements


def has_random_signals(problem: Problem) -> bool:
    """Whether signals are uncertain: what is known at an instant then differs between realisations."""
    # Signals in the place of numbers count too.
    signals = [one for one in jax.tree.leaves(problem.system, is_leaf=_is_signal) if _is_signal(one)]
    return bool(placements((signals, problem.inputs)).distributions)


def _is_signal(node: Any) -> bool:
    return isinstance(node, AbstractSignal)


def frozen(problem: Problem) -> tuple[Problem, Int[np.ndarray, " direct"]]:
    """The problem without the decisions of its signals and its final time, and where the others are among all."""

    def plain(leaf: Any) -> Any:
        return jax_array(leaf.initial) if isinstance(leaf, Decision) else leaf

    def still(tree: Any) -> Any:
        return jax.tree.map(plain, tree, is_leaf=is_leaf)

    system = problem.system
    for name in system.signal_fields:  # type: ignore[union-attr]
        system = eqx.tree_at(lambda tree, name=name: getattr(tree, name), system, still(getattr(system, name)))
    whole = problem.simulation
    simulation = Simulation(
        system, still(whole.inputs), still(whole.grid), whole.integrator, whole.numbers, whole.equations
    )
    fixed = eqx.tree_at(lambda tree: tree.simulation, problem, simulation)
    places = problem.placements.decisions
    where = [np.arange(places[name].where.start, places[name].where.stop) for name in fixed.placements.decisions]
    return fixed, np.concatenate([np.zeros(0, dtype=int), *where])
