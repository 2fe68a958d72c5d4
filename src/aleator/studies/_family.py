"""`fly`: one plan on its whole family of systems, every output kept; what a problem does not speak of is known too."""

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


@final
@dataclass(frozen=True)
class Family:
    """One plan on many random systems.

    - `times`: the instants, shape (instants,), s;
    - `nominal`: the outputs of the system in the middle of every law, by name, shape (instants,);
    - `systems`: those of the random ones, shape (systems, instants).
    """

    times: Float[np.ndarray, " instants"]
    nominal: Mapping[str, Float[np.ndarray, " instants"]]
    systems: Mapping[str, Float[np.ndarray, "systems instants"]]


def _histories(problem: al.Problem, germ: Float[Array, "systems variables"], decisions: Float[Array, " n"]) -> History:
    return jax.vmap(lambda point: history(problem, point, decisions))(germ)


HISTORIES = Compiled(_histories)


def fly(problem: al.Problem, decisions: Any, count: int, *, seed: int = 0, finer: int = 1) -> Family:
    """Simulate a problem's systems at given decisions: `count` random ones, and the nominal one.

    The grid has `finer` times as many steps. A deterministic problem is flown on the family it stands for, and the same
    seed draws the same systems.
    """
    # The systems alone: what is asked of them would be compiled anew for every plan.
    whole: Any = uncertain(problem)
    anything = al.terminal(whole.system.model.coordinates[0]).mean
    bare: Any = al.Problem(whole.system, grid=whole.grid.finer(finer), minimize=anything)
    generator = np.random.default_rng(seed)
    germs = bare.survey.germs.values()
    levels = generator.uniform(np.finfo(float).tiny, 1.0, (count + 1, len(germs)))
    levels[0] = 0.5
    drawn = np.stack([germ.quantile(levels[:, i]) for i, germ in enumerate(germs)], axis=1)
    x = jnp.asarray(decisions)
    found = HISTORIES(numbers_to_arrays(bare), jnp.asarray(drawn), x)
    return Family(
        times=np.asarray(grid_at(bare, x).times),
        nominal={name: np.asarray(rows)[0] for name, rows in found.items()},
        systems={name: np.asarray(rows)[1:] for name, rows in found.items()},
    )
