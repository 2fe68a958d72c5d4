"""The discretisation of a problem's uncertainty: basis and collocation points, chosen once or at an answer, and the
scenarios at which limits on the worst case are imposed.

A limit on the worst case is a limit on every realisation. The program imposes it at a few of them, which are added when
they are found to break it, and dropped when they no longer bind: the method of cutting sets (Mutapcic and Boyd, 2009,
Cutting-set methods for robust convex optimization with pessimizing oracles). They are stored in slots, whose germ
points are data and whose bounds are infinite while they are empty, so that another scenario compiles nothing.

A limit at the collocation points is imposed at these alone: they are in the first slots, and stay there.
"""

from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator._core.errors import ProblemError
from aleator.design import (
    Problem,
    functionals_of,
    is_at_points,
    is_worst_case,
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
from aleator.uncertainty import AbstractGerm

_FEWEST_SLOTS = 8
# Kept discretisations: enough for the problems of a session; a front or a calibration needs one.
_KEPT = 16


class Scenarios(NamedTuple):
    """Germ points in slots: `points` of shape (slots, variables).

    - `used`: the slots at which limits on the worst case are imposed;
    - `collocated`: how many slots, the first ones, hold the collocation points; 0 if no limit is at these.
    """

    points: Float[np.ndarray, "slots variables"]
    used: Bool[np.ndarray, " slots"]
    collocated: int = 0

    @property
    def held(self) -> Float[np.ndarray, "scenarios variables"]:
        """The points at which limits on the worst case are imposed."""
        return self.points[self.used]

    @property
    def fixed(self) -> Bool[np.ndarray, " slots"]:
        """The slots of the collocation points."""
        return np.arange(len(self.used)) < self.collocated

    @property
    def found(self) -> Float[np.ndarray, "scenarios variables"]:
        """The points at which limits on the worst case are imposed, but for the collocation points."""
        return self.points[self.used & ~self.fixed]

    @classmethod
    def of(cls, points: Float[np.ndarray, "scenarios variables"]) -> "Scenarios":
        """Some points in as many slots as they need."""
        slots = _FEWEST_SLOTS
        while slots < len(points):
            slots *= 2
        # Empty slots hold a copy: the model is evaluated there too.
        return cls(np.resize(points, (slots, points.shape[1])), np.arange(slots) < len(points))

    def beginning(self, points: Float[np.ndarray, "scenarios variables"]) -> "Scenarios":
        """The collocation points if they are held, and other points in the place of the present ones."""
        return Scenarios.of(np.concatenate([self.points[self.fixed], points]))._replace(collocated=self.collocated)

    def joined(self, new: Float[np.ndarray, "new variables"], idle: Bool[np.ndarray, " slots"]) -> "Scenarios":
        """Add points: in empty slots, then in the place of `idle` ones, then in twice as many slots.

        The others keep their slots, so that multipliers of their rows remain theirs.
        """
        idle = idle & ~self.fixed
        places = np.concatenate([np.flatnonzero(~self.used), np.flatnonzero(self.used & idle)])
        if len(places) < len(new):
            wider = Scenarios.of(np.concatenate([self.points, self.points]))
            used = np.concatenate([self.used, np.zeros(len(wider.used) - len(self.used), dtype=bool)])
            return Scenarios(wider.points, used, self.collocated).joined(new, np.zeros(len(used), dtype=bool))
        points, used = self.points.copy(), self.used.copy()
        points[places[: len(new)]], used[places[: len(new)]] = new, True
        return Scenarios(points, used, self.collocated)


def germ_box(problem: Problem) -> Float[np.ndarray, "variables 2"]:
    """The ends of each germ variable, between which realisations are searched.

    Raises `ProblemError` if a variable is unbounded, or correlated.
    """
    distributions = problem.placements.distributions.items()
    limits = ", ".join(dict.fromkeys(repr(one.name) for one in problem.constraints if is_worst_case(one)))
    if correlated := [place for place, distribution in distributions if distribution.dependence is not None]:
        raise ProblemError(
            f"worst_case of {limits}: {', '.join(map(repr, correlated[:5]))} are correlated, and the search moves each "
            "variable by itself. The worst system is that of independent ones, for any values within the bounds may "
            "meet: limit it in a problem without correlations, or take probability=0.999 instead."
        )
    ranges = {name: one.reach() for place, one in distributions for name in one.germs(place)}
    unbounded = [name for name, ends in ranges.items() if not np.all(np.isfinite(ends))]
    if unbounded:
        raise ProblemError(
            f"worst_case of {limits}: {', '.join(map(repr, unbounded[:5]))} can take values without bound, of which "
            "none is the worst; use bounded distributions such as Uniform or Beta, al.Toleranced of a known "
            "capability, whose zone counts, or probability=0.999 instead."
        )
    return np.array(list(ranges.values()), dtype=float).reshape(-1, 2)


def first_scenarios(problem: Problem, points: Float[np.ndarray, "points variables"]) -> Scenarios | None:
    """Two opposite corners of the germ's box to begin with, and the collocation points if limits are at these.

    None if there is no limit on realisations.
    """
    worst, collocated = any(map(is_worst_case, problem.constraints)), any(map(is_at_points, problem.constraints))
    if not worst and not collocated:
        return None
    box = germ_box(problem) if worst else np.zeros((0, 2))
    if not collocated:
        return Scenarios.of(box.T) if len(box) else Scenarios(np.zeros((1, 0)), np.ones(1, dtype=bool))
    scenarios = Scenarios(points, np.ones(len(points), dtype=bool), len(points))
    return scenarios.beginning(box.T) if len(box) else scenarios


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
