"""`fly`: one plan simulated on its family of systems, with every output kept, even those not in the problem."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import aleator as al
from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled
from aleator.design import grid_at, history, uncertain
from aleator.dynamics import History
from aleator.ensemble import at_levels, few_at_once, random_levels


@final
@dataclass(frozen=True)
class Family:
    """One plan on many random systems.

    - `times`: the instants, shape (instants,), s;
    - `nominal`: the outputs of the system at the median of every distribution, by name, shape (instants,);
    - `systems`: those of the random systems, shape (systems, instants);
    - `extremes`: the minimum and maximum of each output of each random system, shape (systems, 2); between the instants
      too, where the plan holds its limits there.
    """

    times: Float[np.ndarray, " instants"]
    nominal: Mapping[str, Float[np.ndarray, " instants"]]
    systems: Mapping[str, Float[np.ndarray, "systems instants"]]
    extremes: Mapping[str, Float[np.ndarray, "systems 2"]]


def _histories(problem: al.Problem, germ: Float[Array, "systems variables"], decisions: Float[Array, " n"]) -> History:
    return jax.vmap(lambda point: history(problem, point, decisions))(germ)


def _extremes(
    problem: al.Problem, germ: Float[Array, "systems variables"], decisions: Float[Array, " n"]
) -> dict[str, Float[Array, "systems 2"]]:
    def one(point: Float[Array, " variables"]) -> dict[str, Float[Array, " 2"]]:
        found = history(problem, point, decisions)
        return {name: jnp.stack([rows.min(), rows.max()]) for name, rows in found.items()}

    return few_at_once(one, germ)


HISTORIES = Compiled(_histories)
EXTREMES = Compiled(_extremes)


def fly(problem: al.Problem, decisions: Any, count: int, *, seed: int = 0, finer: int = 1, between: int = 1) -> Family:
    """Simulate a problem's systems at given decisions: `count` random ones, and the nominal one.

    The grid has `finer` times as many steps; extremes are taken on one with `between` times as many again. A
    deterministic problem is flown on the family it stands for, and the same seed draws the same systems.
    """
    bare = _bare(problem, finer)
    germs = bare.placements.germs.values()
    levels = random_levels(np.random.default_rng(seed), count + 1, len(germs))
    levels[0] = 0.5
    drawn = at_levels(germs, levels)
    x = jnp.asarray(decisions)
    found = HISTORIES(numbers_to_arrays(bare), jnp.asarray(drawn), x)
    systems = {name: np.asarray(rows)[1:] for name, rows in found.items()}
    if between == 1:
        extremes = {name: np.stack([rows.min(axis=1), rows.max(axis=1)], axis=1) for name, rows in systems.items()}
    else:
        extremes = EXTREMES(numbers_to_arrays(_bare(problem, finer * between)), jnp.asarray(drawn[1:]), x)
    return Family(
        times=np.asarray(grid_at(bare, x).times),
        nominal={name: np.asarray(rows)[0] for name, rows in found.items()},
        systems=systems,
        extremes={name: np.asarray(rows) for name, rows in extremes.items()},
    )


def _bare(problem: al.Problem, finer: int) -> Any:
    """The systems of a problem alone, since objectives and constraints would be compiled anew for every plan."""
    whole: Any = uncertain(problem)
    anything = al.terminal(whole.system.model.coordinates[0]).mean
    return al.Problem(whole.system, grid=whole.grid.finer(finer), minimize=anything)
