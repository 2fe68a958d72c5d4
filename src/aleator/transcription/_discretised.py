"""The discretisation of a problem's uncertainty: basis and collocation points, chosen once or at an answer."""

from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator.design import (
    Problem,
    functionals_of,
    refuse_large_histories,
    responses,
    statistics_in,
)
from aleator.ensemble import in_batches
from aleator.expansion import (
    AbstractBasis,
    Adaptive,
    Collocation,
    Discretisation,
    Expansion,
    MultiElement,
    PiecewiseBasis,
    Refinement,
    Sparse,
    collocate,
    collocate_elements,
)
from aleator.statistics import Constants, Preparation
from aleator.transcription._scenarios import Scenarios
from aleator.uncertainty import AbstractGerm

# Kept discretisations: enough for the problems of a session; a front or a calibration needs one.
_KEPT = 16


class Discretised(NamedTuple):
    """The discretisation of a problem's uncertainty.

    - `basis`, `collocation`: see `collocate`; `constants`: of the problem's statistics.
    """

    basis: AbstractBasis
    collocation: Collocation
    constants: Constants

    def at_scenarios(self, scenarios: Scenarios | None) -> "Discretised":
        """The same, with limits on the worst case held at some realisations; itself without any."""
        if scenarios is None:
            return self
        return self._replace(constants=replace(self.constants, scenarios=jax_array(scenarios.points)))


def discretised(problem: Problem) -> Discretised:
    """Basis, collocation and constants for a problem, reused from an earlier one if all that they depend on is equal.

    An expansion that chooses its terms by the model's outputs does so once, at the initial decisions. It does not
    depend on bounds and margins, and so is the same throughout a front and a calibration.

    Raises `ProblemError` if the collocation, or the histories at its points, would not fit into memory.
    """
    germs, expansion = tuple(problem.placements.germs.items()), problem.expansion
    if isinstance(expansion, MultiElement):
        chooses = not expansion.cells
    else:
        chooses = isinstance(expansion.index_set, Adaptive) or isinstance(expansion.fit, Sparse)
    needed = (one.kind.preparation for one in statistics_in(problem.expressions))
    preparations = tuple(dict.fromkeys(one for one in needed if one is not None))
    outputs = _Outputs.of(problem) if chooses and germs else None
    # A user's own preparation may compute something else than in an earlier problem.
    code = "" if problem.is_declared else problem.physics.text
    result = _discretised(germs, expansion, preparations, outputs, code)
    # Outputs of one instant are differentiated at that instant, by the few numbers known there.
    decided = problem.placements.vector("initial").size if problem.is_integrated else 0
    refuse_large_histories(
        problem, len(result.collocation.points), decided, "Take fewer steps, fewer points or a lower order."
    )
    return result


Germs = tuple[tuple[str, AbstractGerm], ...]


@lru_cache(maxsize=_KEPT)
def _discretised(
    germs: Germs,
    expansion: Expansion | MultiElement,
    preparations: tuple[Preparation, ...],
    outputs: "_Outputs | None",
    code: str,
) -> Discretised:
    del code  # part of the key
    basis, collocation = _collocated(germs, expansion, outputs)
    return Discretised(basis, collocation, Constants(preparations, tuple(one(basis) for one in preparations)))


@lru_cache(maxsize=_KEPT)
def _collocated(germs: Germs, expansion: Expansion | MultiElement, outputs: "_Outputs | None") -> Discretisation:
    if not isinstance(expansion, MultiElement):
        return collocate(dict(germs), expansion, outputs)
    if not germs:
        return collocate({}, Expansion(expansion.order))
    cells = expansion.cells
    if outputs is not None:
        refinement = Refinement(dict(germs), expansion, outputs)
        refinement.run()
        cells = refinement.basis.cells
    return collocate_elements(dict(germs), expansion, cells)


def divided(problem: Problem, discretised: Discretised, decisions: Float[np.ndarray, " n"]) -> Problem | None:
    """The problem with its elements divided until they suffice at some decisions; None where they do already.

    Warns with `ExpansionWarning` if the budget does not suffice.
    """
    expansion, basis = problem.expansion, discretised.basis
    if not (isinstance(expansion, MultiElement) and isinstance(basis, PiecewiseBasis)):
        return None
    settings = replace(expansion, cells=expansion.cells or basis.cells)
    refinement = Refinement(basis.germs, settings, _Outputs.of(problem, decisions))
    refinement.run()
    if not refinement.splits:
        return None
    settings = replace(expansion, cells=refinement.basis.cells)
    return eqx.tree_at(lambda tree: tree.expansion, problem, settings)


@final
@dataclass(frozen=True)
class _Outputs:
    """A problem's functionals at germ points, at the initial decisions or others.

    Equal if they give the same numbers.
    """

    key: Hashable
    problem: Problem = field(compare=False)
    decisions: Float[np.ndarray, " n"] = field(compare=False)

    @classmethod
    def of(cls, problem: Problem, decisions: Float[np.ndarray, " n"] | None = None) -> "_Outputs":
        """Those of a problem, distinguished by its equations, its numbers and its functionals, not by its bounds."""
        leaves, structure = jax.tree.flatten(numbers_to_arrays(problem.simulation))
        data = tuple((one.shape, np.asarray(one).tobytes()) if eqx.is_array(one) else one for one in leaves)
        at = problem.placements.vector("initial") if decisions is None else decisions
        return cls((problem.physics, functionals_of(problem.expressions), structure, data, at.tobytes()), problem, at)

    def __call__(self, points: Float[np.ndarray, "points variables"]) -> dict[str, Float[np.ndarray, "points ..."]]:
        """The functionals by their texts."""
        # Functionals are the same whatever the expansion, so that further elements compile nothing.
        problem = eqx.tree_at(lambda tree: tree.expansion, self.problem, Expansion(1))
        traced, at = numbers_to_arrays(problem), jax_array(self.decisions)
        texts = [one.text() for one in functionals_of(self.problem.expressions)]
        return dict(zip(texts, in_batches(RESPOND, traced, points, at), strict=True))


def _respond(
    problem: Problem, germ: Float[Array, "points variables"], decisions: Float[Array, " n"]
) -> tuple[Float[Array, "points ..."], ...]:
    return responses(problem, functionals_of(problem.expressions), germ, decisions)


RESPOND = Compiled(_respond, use=Use.ONCE)
