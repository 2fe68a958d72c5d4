"""Elements of a germ's domain, each a cell with an expansion of its own: multi-element gPC, [11]-[16]."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from aleator._core import border
from aleator._core.arrays import Pytree, in_library, jax_array
from aleator._core.errors import ExpansionWarning
from aleator._core.leaves import Module, is_traced
from aleator.analysis._sampling import Sampler, plain
from aleator.ensemble import at_levels, even_levels
from aleator.expansion import ROUNDING, Basis, Expansion, GaussPoints, HammersleyPoints, collocate, leave_one_out
from aleator.statistics import AbstractTail
from aleator.uncertainty import AbstractGerm, LegendreGerm
from aleator.uncertainty._families import tanh_sinh
from aleator.uncertainty._measure import recurrence_of

# Probability levels that cluster at both ends of an element, with their weights.
_LEVELS, _WEIGHTS = tanh_sinh(240, -4.0, 4.0)

# Fresh points at a time for checking elements with small errors, of traced and of called functions: their own samples
# cannot show a jump or a spike between them.
_FRESH_POINTS, _CALLED = 1024, 128

# Sample size for statistics that are no sums over elements.
POINTS = 2**14
# Fewer of them in a tail leave its probability uncertain by more than a tenth.
_FEW = 100


@final
class MultiElement(Module):
    """Settings of a multi-element expansion, for outputs that no single polynomial fits: jumps, kinks, long times.

    The element of the germ's domain with the largest error is split in two until the error is small enough.

    - `order`: the total degree in each element;
    - `error`: the relative root mean square error of the piecewise expansion at which splitting stops, estimated by
      leaving one sample out and at fresh points;
    - `budget`: the largest number of calls of the function.

    Before it stops, the function is evaluated at 1024 fresh points, 128 with `traced=False`, as far as the budget
    allows, evenly spread over each variable. What none of these meets is not seen: of one variable, a spike narrower
    than a thousandth of the probability.

    Sources: Wan and Karniadakis (2005), An adaptive multi-element generalized polynomial chaos method for stochastic
    differential equations; by collocation: Foo, Wan and Karniadakis (2008), The multi-element probabilistic collocation
    method.
    """

    order: int = eqx.field(static=True)
    error: float = eqx.field(static=True)
    budget: int = eqx.field(static=True)

    def __init__(self, order: int = 4, *, error: float = 1e-3, budget: int = 10_000):
        self.order = border.whole("MultiElement: order", order)
        self.error = border.positive("MultiElement: error", error, below=1.0)
        self.budget = border.whole("MultiElement: budget, the number of calls,", budget)


def restricted(germ: AbstractGerm, low: float, high: float) -> AbstractGerm:
    """The distribution of `germ` given that its probability level lies between `low` and `high`."""
    return germ if (low, high) == (0.0, 1.0) else RestrictedGerm(germ, low, high)


@final
@dataclass(frozen=True)
class RestrictedGerm(AbstractGerm):
    """The distribution of `germ` given that its probability level lies between `low` and `high`.

    Its values are those of `germ` itself. A restricted uniform distribution is uniform. The polynomials of any other
    follow by Stieltjes' procedure from quadrature over the levels (Wan and Karniadakis, 2006, Multi-element generalized
    polynomial chaos for arbitrary probability measures).
    """

    germ: AbstractGerm
    low: float
    high: float

    @override
    def recurrence(self, order: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        if isinstance(self.germ, LegendreGerm):
            a, b = self.germ.recurrence(order)
            return a + (self.low + self.high - 1), b * (self.high - self.low)
        a, b, _ = recurrence_of(*self._quadrature(), order)
        return a, b

    @override
    def quantile(self, level: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return self.germ.quantile(self.low + level * (self.high - self.low))

    @override
    def cumulative(self, germ: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return np.clip((self.germ.cumulative(germ) - self.low) / (self.high - self.low), 0.0, 1.0)

    @override
    def support(self) -> tuple[float, float]:
        first, last = self.germ.support()
        low = first if self.low == 0 else float(self.germ.quantile(np.array(self.low)))
        high = last if self.high == 1 else float(self.germ.quantile(np.array(self.high)))
        return low, high

    def _quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Germ values and probability weights. The nodes cluster at an end of an unbounded distribution."""
        levels = self.low + _LEVELS * (self.high - self.low)
        inside = (levels > 0) & (levels < 1)
        return self.germ.quantile(levels[inside]), _WEIGHTS[inside] / _WEIGHTS[inside].sum()


@final
@dataclass(frozen=True)
class Cell:
    """The probability levels of each germ variable between `low` and `high`."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    @property
    def probability(self) -> float:
        """The probability that the germ lies in the cell."""
        return float(np.prod(np.subtract(self.high, self.low)))

    def halves(self, variable: int) -> tuple["Cell", "Cell"]:
        """Two cells of equal probability, from a cut across one variable."""
        middle = (self.low[variable] + self.high[variable]) / 2

        def at_middle(ends: tuple[float, ...]) -> tuple[float, ...]:
            return (*ends[:variable], middle, *ends[variable + 1 :])

        return Cell(self.low, at_middle(self.high)), Cell(at_middle(self.low), self.high)

    def germs(self, germs: Mapping[str, AbstractGerm]) -> dict[str, AbstractGerm]:
        """The distributions of the germ variables, conditional on the cell."""
        limits = zip(germs.items(), self.low, self.high, strict=True)
        return {name: restricted(germ, low, high) for (name, germ), low, high in limits}

    def holds(self, levels: Float[np.ndarray, "n variables"]) -> Bool[np.ndarray, " n"]:
        """Which points of the unit cube lie in the cell. A face between two cells belongs to the upper one."""
        low, high = np.array(self.low)[None], np.array(self.high)[None]
        return np.all((levels >= low) & ((levels < high) | (high == 1)), axis=1)


@final
@dataclass(frozen=True)
class Element:
    """The expansion of all outputs in one cell.

    - `coefficients`: of each output, shape (terms, *shape);
    - `known`: the same as plain numbers, a list with shapes (terms, entries);
    - `squared_errors`: mean squared leave-one-out error of each output, summed over its entries.
    """

    cell: Cell
    basis: Basis
    points: int
    coefficients: Pytree
    known: list[Float[np.ndarray, "terms entries"]]
    squared_errors: Float[np.ndarray, " outputs"]

    def prediction(self, points: Float[np.ndarray, "n variables"]) -> list[Float[np.ndarray, "n entries"]]:
        """Each output at germ points of the cell."""
        matrix = self.basis.matrix(points)
        return [matrix @ terms for terms in self.known]


def expanded_in(cell: Cell, germs: Mapping[str, AbstractGerm], expansion: Expansion, sampler: Sampler) -> Element:
    """Expand all outputs in one cell."""
    basis, collocation = collocate(cell.germs(germs), expansion)
    samples = sampler.samples(collocation.points)
    values = flat(samples)
    known = [np.asarray(collocation.coefficients(jax_array(output))) for output in values]
    errors = [
        float(leave_one_out(collocation, jax_array(output), jax_array(terms))) ** 2 * output.var(axis=0).sum()
        for output, terms in zip(values, known, strict=True)
    ]
    coefficients = jax.tree.map(collocation.coefficients, samples)
    return Element(cell, basis, len(collocation.points), coefficients, known, np.array(errors))


def flat(samples: Pytree) -> list[Float[np.ndarray, "points entries"]]:
    """Each output as plain numbers."""
    return [values.reshape(len(values), -1) for values in jax.tree.leaves(plain(samples))]


@final
class Refinement:
    """A set of elements that is refined, starting from one.

    - `elements`: at present; `splits`: the variable of each split, in order; `calls`: of the function;
    - `error`: the estimated relative rms error of the piecewise expansion.
    """

    def __init__(self, sampler: Sampler, settings: MultiElement):
        self._sampler, self._settings, self._expansion = sampler, settings, Expansion(settings.order)
        self.germs = sampler.places.germs
        self.elements: list[Element] = []
        self.splits: list[str] = []
        self.calls = 0
        self._generator = np.random.default_rng(0)
        self._levels = np.zeros((0, len(self.germs)))
        self._values: list[Float[np.ndarray, "fresh entries"]] = []
        self._add(Cell((0.0,) * len(self.germs), (1.0,) * len(self.germs)))

    def run(self) -> None:
        """Split until the error is small enough, at fresh points too, or the budget is spent."""
        per_split = 2 * self.elements[0].points
        while True:
            if self.error <= self._settings.error:
                self._try_fresh_points()
                if self.error <= self._settings.error:
                    return
            if not self._affords(per_split):
                return
            self._split(self.elements.pop(int(np.argmax(self._shares().max(axis=1)))))

    @property
    def error(self) -> float:
        """The estimated relative rms error, the largest over the outputs."""
        return float(np.sqrt(self._shares().sum(axis=0).max()))

    def _affords(self, calls: int) -> bool:
        return self.calls + calls <= self._settings.budget

    def _add(self, cell: Cell) -> None:
        element = expanded_in(cell, self.germs, self._expansion, self._sampler)
        self.calls += element.points
        self.elements.append(self._checked(element))

    def _split(self, worst: Element) -> None:
        across = _direction(worst)
        for half in worst.cell.halves(across):
            self._add(half)
        self.splits.append(worst.basis.names[across])

    def _shares(self) -> Float[np.ndarray, "elements outputs"]:
        """Each element's part in the squared error of each output, relative to its variance."""
        probability = np.array([element.cell.probability for element in self.elements])
        errors = probability[:, None] * np.array([element.squared_errors for element in self.elements])
        outputs = zip(*(element.known for element in self.elements), strict=True)
        seen = [values.var(axis=0).sum() for values in self._values] or 0.0
        scale = np.maximum([_variance(probability, terms) for terms in outputs], seen)
        return errors / np.where(scale > 0, scale, 1.0)[None]

    def _try_fresh_points(self) -> None:
        """Raise the errors of elements to those at all fresh points so far and some more, which no fit has used."""
        count = _FRESH_POINTS if self._sampler.is_traced else _CALLED
        levels = even_levels(self._generator, min(count, self._settings.budget - self.calls), len(self.germs))
        if not len(levels):
            return
        values = flat(self._sampler.samples(jax_array(at_levels(self.germs.values(), levels))))
        self.calls += len(levels)
        self._levels = np.concatenate([self._levels, levels])
        pairs = zip(self._values, values, strict=True)
        self._values = list(map(np.concatenate, pairs)) if self._values else values
        self.elements = [self._checked(element) for element in self.elements]

    def _checked(self, element: Element) -> Element:
        """An element whose errors are at least those at the fresh points so far."""
        inside = element.cell.holds(self._levels)
        if not inside.any():
            return element
        predicted = element.prediction(at_levels(self.germs.values(), self._levels[inside]))
        misses = zip(predicted, self._values, strict=True)
        squares = np.array([((one - true[inside]) ** 2).sum() for one, true in misses])
        fresh = squares / (len(self._levels) * element.cell.probability)
        return replace(element, squared_errors=np.maximum(element.squared_errors, fresh))


def _variance(probability: Float[np.ndarray, " elements"], terms: tuple[np.ndarray, ...]) -> float:
    """The variance of one output over all elements, summed over its entries; at least that of rounding."""
    means = np.stack([coefficients[0] for coefficients in terms])
    within = np.array([(coefficients[1:] ** 2).sum() for coefficients in terms])
    away = ((means - (probability @ means)[None]) ** 2).sum(axis=1)
    return float(probability @ (within + away + ROUNDING**2 * (means**2).sum(axis=1)))


def _direction(worst: Element) -> int:
    """The variable to split: the one with the largest part in the terms of the two highest degrees.

    Two, because a response that is odd about the element's middle, such as a jump there, has no even terms. If nothing
    varies at the element's samples, it is the variable in which the element is widest.
    """
    degrees = worst.basis.indices
    highest = degrees.sum(axis=1) >= degrees.sum(axis=1).max() - 1
    squares = sum(np.sum(terms**2, axis=1) / (np.sum(terms[1:] ** 2) or 1.0) for terms in worst.known)
    parts = (squares * highest) @ degrees
    return int(np.argmax(parts if parts.max() > 0 else np.subtract(worst.cell.high, worst.cell.low)))


class Scattered(NamedTuple):
    """Germ points sorted by element.

    - `matrices`: for each element, its polynomials at its points;
    - `back`: the index of each given point among the sorted ones.
    """

    matrices: list[Float[np.ndarray, "n terms"]]
    back: Int[np.ndarray, " points"]

    def evaluate(self, coefficients: Float[Array, "elements terms *shape"]) -> Float[Array, "points *shape"]:
        """A piecewise expansion at the points, in the order given."""
        library, terms = in_library(coefficients)
        pieces = [library.tensordot(matrix, terms[k], axes=1) for k, matrix in enumerate(self.matrices) if len(matrix)]
        return jax_array(library.concatenate(pieces)[self.back])


@final
@dataclass(frozen=True, eq=False)
class Partition:
    """Cells that fill a germ's probability space, with the orthonormal polynomials in each."""

    germs: Mapping[str, AbstractGerm]
    cells: tuple[Cell, ...]
    bases: tuple[Basis, ...]

    @property
    def probability(self) -> Float[np.ndarray, " elements"]:
        """The probability of each element."""
        return np.array([cell.probability for cell in self.cells])

    def scatter(self, points: Float[np.ndarray, "points variables"]) -> Scattered:
        """Germ points by element."""
        levels = [germ.cumulative(points[:, i]) for i, germ in enumerate(self.germs.values())]
        owner = np.zeros(len(points), dtype=int)
        for k, cell in enumerate(self.cells):
            owner[cell.holds(np.stack(levels, axis=1))] = k
        matrices = [basis.matrix(points[owner == k]) for k, basis in enumerate(self.bases)]
        return Scattered(matrices, np.argsort(np.argsort(owner, kind="stable"), kind="stable"))

    @cached_property
    def cloud(self) -> Scattered:
        """A low-discrepancy sample of the whole domain."""
        whole = Basis(self.germs, self.bases[0].indices)
        return self.scatter(whole.map_to_germ(HammersleyPoints(POINTS).levels(POINTS, whole.variables)))

    @cached_property
    def quadrature(self) -> list[tuple[Float[np.ndarray, "nodes terms"], Float[np.ndarray, " nodes"]]]:
        """For each element, its polynomials at Gauss nodes, with weights: exact for fourth powers of an expansion."""
        return [_gauss(basis) for basis in self.bases]


def _gauss(basis: Basis) -> tuple[np.ndarray, np.ndarray]:
    nodes = GaussPoints(2 * max(basis.degrees) + 1).nodes(basis, 0)
    return basis.matrix(nodes.points), nodes.weights


def warn_of_few_points(kind: AbstractTail, values: Sequence[Array]) -> None:
    """Warn (`ExpansionWarning`) of a statistic of a tail in which few of the points lie that it is counted among."""
    if is_traced(kind):
        return
    known = [float(one) for leaf in values for one in ([np.nan] if is_traced(leaf) else np.ravel(leaf))]
    chance = float(np.nanmin([0.5, *(kind.tail(one)[0] for one in known)]))
    if chance * POINTS < _FEW:
        off = np.sqrt(max(chance, 1 / POINTS) / POINTS)
        warnings.warn(
            f"{kind.text('output')} is counted among {POINTS} points of the piecewise expansion, of which fewer than "
            f"{_FEW} lie in that tail: its probability is uncertain by about {off:.1g}.",
            ExpansionWarning,
            stacklevel=4,
        )
