"""Where a simultaneous program starts: its first decisions and states, simulated where no guess is given."""

import abc
from dataclasses import dataclass
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator.design import Problem
from aleator.dynamics import STATES, Asked, Grid, ObservedStates, Simulation, System
from aleator.uncertainty import realise

# Steps of a simulation in each of the grid: points of a mesh between instants are interpolated.
_FINER = 4
# States that grow by more than this after the first tenth of the time are those of a system that runs away.
_BEGINNING, _MOST_GROWTH = 10, 1e4


def _simulated(
    problem: Problem, points: Float[Array, "realisations germs"], decisions: Float[Array, " n"]
) -> Float[Array, "realisations instants states"]:
    def one(germ: Array) -> Array:
        found = realise(problem.simulation, germ, decisions)
        system = found.traced
        assert isinstance(system, System)
        simulation = Simulation(ObservedStates(system), found.inputs, found.grid, found.integrator, found.numbers)
        return simulation.record(Asked(frozenset({STATES}))).history[STATES]

    return jax.vmap(one)(points)


SIMULATED = Compiled(_simulated, use=Use.ONCE)


def simulated_states(
    problem: Problem,
    fractions: Float[np.ndarray, " points"],
    points: Float[np.ndarray, "realisations germs"],
    decisions: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "realisations points states"]:
    """The states of all realisations at some fractions of the duration. If one cannot be simulated at these decisions,
    or grows beyond reason, all rest at their initial states: a program may begin where nothing can be simulated.
    """
    if not problem.is_integrated:
        return np.zeros((len(points), len(fractions), 0))
    assert isinstance(problem.grid, Grid)
    finer = numbers_to_arrays(problem.on_grid(problem.grid.finer(_FINER)))
    found = np.array(SIMULATED(finer, jnp.asarray(points), jnp.asarray(decisions)))
    begun = np.abs(found[:, : 1 + found.shape[1] // _BEGINNING]).max(axis=(0, 1))
    grown = np.abs(found).max(axis=(0, 1)) > _MOST_GROWTH * np.where(begun > 0, begun, np.inf)
    if not np.isfinite(found).all() or grown.any():
        found = np.repeat(found[:, :1], found.shape[1], axis=1)
    instants = np.linspace(0.0, 1.0, found.shape[1])
    return np.moveaxis(interpolated(instants, np.moveaxis(found, 1, 0), fractions), 0, 1)


def interpolated(
    known: Float[np.ndarray, " n"], values: Float[np.ndarray, "n ..."], at: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "m ..."]:
    """Values between known places, linearly."""
    after = np.clip(np.searchsorted(known, at), 1, len(known) - 1)
    share = np.clip((at - known[after - 1]) / (known[after] - known[after - 1]), 0.0, 1.0)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    return (1 - share) * values[after - 1] + share * values[after]


class AbstractStart(abc.ABC):
    """Where the programs of a problem start, on any mesh."""

    def decisions(self, problem: Problem) -> Float[np.ndarray, " n"]:
        """The first decisions: by default the problem's own initial ones."""
        return problem.placements.vector("initial")

    @abc.abstractmethod
    def states(
        self,
        problem: Problem,
        fractions: Float[np.ndarray, " points"],
        points: Float[np.ndarray, "realisations germs"],
        decisions: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, "realisations points states"]:
        """The states of realisations at some fractions of the duration, for given decisions."""


@final
@dataclass(frozen=True)
class _Simulated(AbstractStart):
    """States as they are simulated."""

    @override
    def states(
        self,
        problem: Problem,
        fractions: Float[np.ndarray, " points"],
        points: Float[np.ndarray, "realisations germs"],
        decisions: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, "realisations points states"]:
        return simulated_states(problem, fractions, points, decisions)


SIMULATED_START = _Simulated()
"""The start where nothing is guessed."""
