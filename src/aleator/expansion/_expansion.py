"""`Expansion`: settings of an expansion; `collocate`, which applies them to a germ; `Unseen`, what its points miss."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Float

from aleator._core import border
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, Printed
from aleator.expansion._adaptive import Adaptive, grow
from aleator.expansion._basis import AbstractBasis, AbstractIndexSet, Basis, TotalDegree
from aleator.expansion._collocation import UNRESOLVED, Collocation
from aleator.expansion._fit import AbstractFit, LeastSquares, Respond
from aleator.expansion._points import (
    AbstractCountedPoints,
    AbstractPoints,
    Nodes,
    SobolPoints,
    UsualPoints,
)
from aleator.uncertainty import AbstractGerm

# Matrices of points by terms that a fit holds at once: the matrix in NumPy, in JAX and weighted, its orthogonal
# factor, and the map to coefficients, twice in NumPy and once in JAX.
_MATRICES = 7

# The default order of fixed index sets, and the default limit of those that grow.
_ORDER, _HIGHEST_ORDER = 3, 20

# Corners that are checked: all those of up to ten variables, and at most as many of more variables.
_MOST_CORNERS = 1024

# Most variables that a sentence names.
_NAMED = 5


@final
class Expansion(Module):
    """Settings of an expansion in products of orthonormal polynomials up to an `order`.

    - `order`: by default 3; for an `Adaptive` index set its limit, by default 20;
    - `index_set`: which products to keep, by default all up to that total degree; `Adaptive(error, budget)` finds them;
    - `points`: where to evaluate the model: a point set, or a number of points, by default three per term, as the
      dissertation advises after equation (29). A number means Hammersley points if every germ is bounded, in more than
      eight variables Sobol points; otherwise least squares takes `InducedPoints`, which cover the tails. `Adaptive`
      takes Sobol points;
    - `fit`: how to find the coefficients, by default by least squares;
    - `tolerance`: the relative leave-one-out error up to which an output counts as resolved, by default 0.05: a new
      sample is then predicted to a twentieth of the standard deviation, and all but 1/400 of the variance is explained.

    Raises `ProblemError` if the order or the tolerance is not positive, or if an adaptive index set is combined with a
    fit other than least squares.
    """

    order: int = eqx.field(static=True)
    index_set: AbstractIndexSet | Adaptive
    points: AbstractPoints
    fit: AbstractFit
    tolerance: float

    def __init__(
        self,
        order: int | None = None,
        *,
        index_set: AbstractIndexSet | Adaptive | None = None,
        points: int | AbstractPoints | None = None,
        fit: AbstractFit | None = None,
        tolerance: float = UNRESOLVED,
    ):
        adaptive = isinstance(index_set, Adaptive)
        if order is None:
            order = _HIGHEST_ORDER if adaptive else _ORDER
        self.order = border.whole("Expansion: the order", order)
        sets = (AbstractIndexSet, Adaptive)
        self.index_set = border.one_of(
            "Expansion: index_set",
            TotalDegree() if index_set is None else index_set,
            sets,
            "al.index_sets.TotalDegree()",
        )
        if not isinstance(points, AbstractPoints | None):
            points = border.whole("Expansion: points", points)
        self.fit = border.one_of(
            "Expansion: fit", LeastSquares() if fit is None else fit, AbstractFit, "al.fits.LeastSquares()"
        )
        if not isinstance(points, AbstractPoints):
            tails = isinstance(self.fit, LeastSquares)
            points = SobolPoints(points) if adaptive else UsualPoints(points, tails)
        self.points = points
        self.tolerance = border.positive("Expansion: tolerance, the relative error of a resolved output", tolerance)
        if adaptive and not isinstance(self.fit, LeastSquares):
            raise ProblemError(
                f"Expansion: an Adaptive index set is fitted by least squares; received {type(fit).__name__}. Drop "
                "the fit, or take a fixed index set."
            )

    def text(self, germs: Mapping[str, AbstractGerm]) -> str:
        """The settings in words, for the given germ variables."""
        order = f"order up to {self.order}" if isinstance(self.index_set, Adaptive) else f"order {self.order}"
        return (
            f"{order} in {len(germs)} variables, {type(self.index_set).__name__} index set, "
            f"{type(self.points.of(germs)).__name__}, {type(self.fit).__name__} fit"
        )


class Discretisation(NamedTuple):
    """An expansion for a germ: its polynomials, and its points with the map from samples to coefficients."""

    basis: AbstractBasis
    collocation: Collocation

    @property
    def order(self) -> int:
        """The highest total degree of a term: as asked for, or as reached by growth or selection."""
        return self.basis.order

    def __str__(self) -> str:
        return (
            f"order {self.order}, {self.basis.terms} terms, {len(self.collocation.points)} points, condition number "
            f"{float(self.collocation.condition_number):.3g}"
        )


def collocate(
    germs: Mapping[str, AbstractGerm], expansion: Expansion, respond: Respond | None = None
) -> Discretisation:
    """Choose basis and points for a germ and factorise the collocation matrix.

    `respond` gives a model's outputs at germ points of shape (n, variables): an array with a leading axis for the
    points, or a pytree of such arrays. It is called only if outputs choose the terms (`Adaptive`, `Sparse`). The result
    is a fixed basis in any case, linear in the samples.

    Raises `ProblemError` if points, index set and fit do not go together, if the matrices would not fit into memory, if
    there are fewer points than terms, or if the matrix is singular to working precision; `SimulationError` if an output
    that chooses terms is not finite. Warns with `ExpansionWarning` if an adaptive set does not reach its error.
    """
    if not germs:
        nothing = Basis(germs, np.zeros((1, 0), dtype=int))
        return Discretisation(nothing, LeastSquares().collocation(nothing, Nodes(np.zeros((1, 0)), np.ones(1))))
    if isinstance(expansion.index_set, Adaptive):
        basis, nodes = grow(germs, expansion.order, expansion.index_set, expansion.points, respond)
    else:
        candidates, nodes = candidate_terms(germs, expansion)
        basis = expansion.fit.select(candidates, nodes, respond)
    return Discretisation(basis, expansion.fit.collocation(basis, nodes))


def candidate_terms(germs: Mapping[str, AbstractGerm], expansion: Expansion) -> tuple[Basis, Nodes]:
    """The terms of an index set that is not adaptive, and the points: known before any output is.

    Raises `ProblemError` if an adaptive index set is asked for, or if the matrices would not fit into memory.
    """
    if isinstance(expansion.index_set, Adaptive):
        raise ProblemError(
            "Adaptive chooses its points by the model's outputs, a few at a time, so that they are not known before: "
            "take a fixed index set, such as al.index_sets.TotalDegree()."
        )
    candidates = Basis(germs, expansion.index_set.indices(tuple(germs), expansion.order))
    candidates.matrix(np.zeros((0, len(germs))))  # refuses an order that data do not carry, before points are chosen
    usual = expansion.fit.points_per_term * candidates.terms
    if isinstance(expansion.points, AbstractCountedPoints):
        candidates.refuse_beyond_memory(expansion.points.count or usual, _MATRICES)
    nodes = expansion.points.nodes(candidates, usual)
    candidates.refuse_beyond_memory(len(nodes.points), _MATRICES)
    return candidates, nodes


@final
@dataclass(frozen=True)
class Unseen(Printed):
    """A corner of the germ's domain that holds no collocation point, about which an expansion knows nothing.

    A spike there, such as a resonance that only the softest spring with the lightest damper meets, changes no
    coefficient and no leave-one-out error. The probability of such a corner shows how much can be missed.

    - `probability`: that a system lies in it; `share`: the part of each variable's own distribution that it covers;
    - `ends`: the end of each variable's distribution at which it lies, "low" or "high".
    """

    probability: float
    share: float
    ends: Mapping[str, str]

    def sentence(self) -> str:
        """Its place and its probability in words."""
        named = [f"{name} {end}" for name, end in self.ends.items()]
        where = ", ".join(named[:_NAMED]) + (f", ... {len(named)} variables" if len(named) > _NAMED else "")
        each = "" if len(named) == 1 else f", the outermost {100 * self.share:.2g} % of each"
        return f"the largest corner without a point ({where}{each}) holds {100 * self.probability:.2g} % of all systems"

    def __str__(self) -> str:
        return self.sentence()


def unseen(basis: AbstractBasis, points: Float[np.ndarray, "points variables"]) -> Unseen | None:
    """The most probable corner without a point, with the same level for each variable; None without variables.

    Beyond ten variables only some corners are checked.
    """
    if basis.variables == 0:
        return None
    levels = np.stack(
        [germ.cumulative(values) for germ, values in zip(basis.germs.values(), np.asarray(points).T, strict=True)],
        axis=1,
    )
    corners = _corners(basis.variables)
    reaches = [_reach(levels, corner) for corner in corners]
    reach, corner = max(reaches), corners[int(np.argmax(reaches))]
    ends = {name: "high" if high else "low" for name, high in zip(basis.names, corner.tolist(), strict=True)}
    return Unseen(reach**basis.variables, reach, ends)


def _reach(levels: Float[np.ndarray, "points variables"], corner: np.ndarray) -> float:
    """The side of the largest cube without points at a corner of the unit cube."""
    return float(np.where(corner, 1 - levels, levels).max(axis=1).min())


def _corners(variables: int) -> np.ndarray:
    """Corners of the unit cube: True where a variable is high."""
    if 2**variables <= _MOST_CORNERS:
        return np.array([[bool(i >> k & 1) for k in range(variables)] for i in range(2**variables)])
    return np.random.default_rng(0).integers(0, 2, (_MOST_CORNERS, variables)).astype(bool)
