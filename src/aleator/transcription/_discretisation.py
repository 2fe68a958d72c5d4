"""The basis and the collocation of a problem: built once for all problems that they are the same for."""

from collections.abc import Hashable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator.design import (
    Problem,
    functionals_of,
    has_own_statistics,
    refuse_changed_code,
    refuse_large_histories,
    responses,
    statistics_in,
)
from aleator.ensemble import in_batches
from aleator.expansion import Adaptive, Basis, Collocation, Discretisation, Expansion, Sparse, collocate
from aleator.statistics import Constants, Preparation
from aleator.uncertainty import AbstractGerm

# Enough for the problems of a session; a front or a calibration needs one.
_KEPT = 16


class Discretised(NamedTuple):
    """What a problem is evaluated with.

    - `basis`, `collocation`: see `collocate`; `constants`: what the problem's statistics need of the basis.
    """

    basis: Basis
    collocation: Collocation
    constants: Constants


def discretised(problem: Problem) -> Discretised:
    """Basis, collocation and constants for a problem: those of an earlier one where nothing they depend on differs.

    An expansion that chooses its terms by the model's outputs is asked once, at the initial decisions. Bounds and
    margins are no part of that, so that it is the same all along a front and a calibration.

    Raises `ProblemError` if the collocation, or the histories at its points, would not fit into memory.
    """
    germs, expansion = tuple(problem.placements.germs.items()), problem.expansion
    chooses = isinstance(expansion.index_set, Adaptive) or isinstance(expansion.fit, Sparse)
    needed = (one.kind.preparation for one in statistics_in(problem.expressions))
    preparations = tuple(dict.fromkeys(one for one in needed if one is not None))
    outputs = _Outputs.of(problem) if chooses and germs else None
    # What a preparation of one's own reads may have changed: then what stands for the problem's code has as well.
    code = problem.physics if has_own_statistics(problem.expressions) else ""
    found = _discretised(germs, expansion, preparations, outputs, code)
    # Outputs that follow from one instant are differentiated there, by the few numbers that are known.
    decided = problem.placements.vector("initial").size if problem.is_integrated else 0
    refuse_large_histories(
        problem, len(found.collocation.points), decided, "Take fewer steps, fewer points or a lower order."
    )
    return found


Germs = tuple[tuple[str, AbstractGerm], ...]


@lru_cache(maxsize=_KEPT)
def _discretised(
    germs: Germs, expansion: Expansion, preparations: tuple[Preparation, ...], outputs: "_Outputs | None", code: str
) -> Discretised:
    del code  # tells constants apart that the preparations themselves do not
    basis, collocation = _collocated(germs, expansion, outputs)
    return Discretised(basis, collocation, Constants(preparations, tuple(one(basis) for one in preparations)))


@lru_cache(maxsize=_KEPT)
def _collocated(germs: Germs, expansion: Expansion, outputs: "_Outputs | None") -> Discretisation:
    return collocate(dict(germs), expansion, outputs)


@final
@dataclass(frozen=True)
class _Outputs:
    """A problem's functionals at germ points and the initial decisions. Equal where they give the same numbers."""

    key: Hashable
    problem: Problem = field(compare=False)

    @classmethod
    def of(cls, problem: Problem) -> "_Outputs":
        """Those of a problem, told apart by its equations, its numbers and its functionals, not by its bounds."""
        parts = numbers_to_arrays((problem.simulation, problem.grid, problem.integrator))
        numbers, rest = eqx.partition(parts, eqx.is_array)
        leaves, structure = jax.tree.flatten(numbers)
        static, static_structure = jax.tree.flatten(rest)
        data = tuple((one.shape, np.asarray(one).tobytes()) for one in leaves)
        functionals = functionals_of(problem.expressions)
        return cls((problem.physics, functionals, structure, static_structure, tuple(static), data), problem)

    def __call__(self, points: Float[np.ndarray, "points variables"]) -> dict[str, Float[np.ndarray, "points ..."]]:
        """The functionals by their texts."""
        traced, start = numbers_to_arrays(self.problem), jnp.asarray(self.problem.placements.vector("initial"))
        texts = [one.text() for one in functionals_of(self.problem.expressions)]
        return dict(zip(texts, in_batches(RESPOND, traced, points, start), strict=True))


def _respond(
    problem: Problem, germ: Float[Array, "points variables"], decisions: Float[Array, " n"]
) -> tuple[Float[Array, "points ..."], ...]:
    return responses(problem, functionals_of(problem.expressions), germ, decisions)


RESPOND = Compiled(_respond, use=Use.ONCE, unchanged=refuse_changed_code)
