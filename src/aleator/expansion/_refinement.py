"""`MultiElement`: elements of a germ's domain, each a cell with an expansion of its own, divided until they suffice."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from aleator._core import border
from aleator._core.arrays import Pytree, jax_array
from aleator._core.errors import ExpansionWarning, ProblemError
from aleator._core.leaves import Module
from aleator.ensemble import at_levels, concrete, even_levels
from aleator.expansion._basis import AbstractBasis
from aleator.expansion._collocation import ROUNDING, UNRESOLVED, leave_one_out
from aleator.expansion._elements import Cell, PiecewiseBasis
from aleator.expansion._expansion import Discretisation, Expansion, collocate
from aleator.expansion._fit import Respond, responses
from aleator.uncertainty import AbstractGerm

# Fresh points at a time for checking elements with small errors: their own samples cannot show a jump or a spike
# between them.
_FRESH_POINTS = 1024
# Halving along a jump leaves all of the squared error, halving across it half; what did not lower it counts for so much
# less in the next choice.
_IN_VAIN, _DAMPED = 0.9, 0.1


@final
class MultiElement(Module):
    """Settings of a multi-element expansion, for outputs that no single polynomial fits: jumps, kinks, long times.

    The element of the germ's domain with the largest error is split in two until the error is small enough. In a
    `Problem`, elements are divided so at the start, stay as they are while a design is sought, and are divided further
    at the answer, from which the search goes on, until they suffice there.

    - `order`: the total degree in each element;
    - `error`: the relative root mean square error of the piecewise expansion at which splitting stops, estimated by
      leaving one sample out and at fresh points;
    - `budget`: the largest number of calls of the function, in a problem for each division;
    - `cells`: the elements to begin with, such as those of an earlier solution's `problem.expansion`; by default one.

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
    cells: tuple[Cell, ...] = eqx.field(static=True)

    def __init__(
        self, order: int = 4, *, error: float = 1e-3, budget: int = 10_000, cells: tuple[Cell, ...] | None = None
    ):
        self.order = border.whole("MultiElement: order", order)
        self.error = border.positive("MultiElement: error", error, below=1.0)
        self.budget = border.whole("MultiElement: budget, the number of calls,", budget)
        self.cells = () if cells is None else tuple(border.members("MultiElement: cells", cells, Cell))

    @property
    def tolerance(self) -> float:
        """The relative leave-one-out error up to which an output counts as resolved, as in an `Expansion`."""
        return max(UNRESOLVED, self.error)

    def text(self, germs: Mapping[str, AbstractGerm]) -> str:
        """The settings in words, for the given germ variables."""
        return f"elements of order {self.order} in {len(germs)} variables, to a relative error of {self.error:g}"


def plain(outputs: Pytree) -> Pytree:
    """Outputs as plain numbers, for decisions that depend on them. Raises `ProblemError` while they are compiled."""
    values = [concrete(leaf) for leaf in jax.tree.leaves(outputs)]
    if any(value is None for value in values):
        raise ProblemError(
            "How a function is expanded by elements or adaptively depends on its values, which are not known inside "
            "jax.jit: expand outside of it (jax.grad alone is no obstacle), or by a fixed expansion."
        )
    return jax.tree.unflatten(jax.tree.structure(outputs), values)


@final
@dataclass(frozen=True)
class Element:
    """The expansion of all outputs in one cell.

    - `coefficients`: of each output, shape (terms, *shape);
    - `known`: the same as plain numbers, a list with shapes (terms, entries);
    - `squared_errors`: mean squared leave-one-out error of each output, summed over its entries;
    - `in_vain`: the variable whose halving made this element, without lowering an error; None where it did.
    """

    cell: Cell
    basis: AbstractBasis
    points: int
    coefficients: Pytree
    known: list[Float[np.ndarray, "terms entries"]]
    squared_errors: Float[np.ndarray, " outputs"]
    in_vain: int | None = None

    def prediction(self, points: Float[np.ndarray, "n variables"]) -> list[Float[np.ndarray, "n entries"]]:
        """Each output at germ points of the cell."""
        matrix = self.basis.matrix(points)
        return [matrix @ terms for terms in self.known]


def _expanded_in(cell: Cell, germs: Mapping[str, AbstractGerm], expansion: Expansion, respond: Respond) -> Element:
    """Expand all outputs in one cell."""
    basis, collocation = collocate(cell.germs(germs), expansion)
    samples = respond(np.asarray(collocation.points))
    values = responses(lambda _: plain(samples), basis.names, np.asarray(collocation.points))
    known = [np.asarray(collocation.coefficients(jax_array(output))) for output in values]
    errors = [
        float(leave_one_out(collocation, jax_array(output), jax_array(terms))) ** 2 * output.var(axis=0).sum()
        for output, terms in zip(values, known, strict=True)
    ]
    coefficients = jax.tree.map(collocation.coefficients, samples)
    return Element(cell, basis, len(collocation.points), coefficients, known, np.array(errors))


@final
class Refinement:
    """A set of elements that is refined, starting from those of its settings.

    - `elements`: at present; `splits`: the variable of each split, in order; `calls`: of the function;
    - `error`: the estimated relative rms error of the piecewise expansion.
    """

    def __init__(
        self,
        germs: Mapping[str, AbstractGerm],
        settings: MultiElement,
        respond: Respond,
        fresh_points: int = _FRESH_POINTS,
    ):
        self._respond, self._settings, self._expansion = respond, settings, Expansion(settings.order)
        self.germs, self._fresh_points = germs, fresh_points
        self.elements: list[Element] = []
        self.splits: list[str] = []
        self.calls = 0
        self._generator = np.random.default_rng(0)
        self._levels = np.zeros((0, len(self.germs)))
        self._values: list[Float[np.ndarray, "fresh entries"]] = []
        for cell in settings.cells or (Cell((0.0,) * len(germs), (1.0,) * len(germs)),):
            self._add(cell)

    def run(self) -> None:
        """Split until the error is small enough, at fresh points too, or the budget is spent.

        Warns with `ExpansionWarning` if the budget does not suffice.
        """
        per_split = 2 * self.elements[0].points
        while True:
            if self.error <= self._settings.error:
                self._try_fresh_points()
                if self.error <= self._settings.error:
                    return
            if self.calls + per_split > self._settings.budget:
                warnings.warn(
                    f"MultiElement: {len(self.elements)} elements leave an estimated error of {self.error:.1e} of the "
                    f"standard deviation, where {self._settings.error:.1e} is asked, after {self.calls} of "
                    f"{self._settings.budget} calls. Raise the budget or the error.",
                    ExpansionWarning,
                    stacklevel=4,
                )
                return
            self._split(self.elements.pop(int(np.argmax(self._shares().max(axis=1)))))

    @property
    def basis(self) -> PiecewiseBasis:
        """The polynomials of all elements."""
        return PiecewiseBasis(
            self.germs, tuple(one.cell for one in self.elements), tuple(one.basis for one in self.elements)
        )

    @property
    def error(self) -> float:
        """The estimated relative rms error, the largest over the outputs."""
        return float(np.sqrt(self._shares().sum(axis=0).max()))

    def _add(self, cell: Cell) -> None:
        element = _expanded_in(cell, self.germs, self._expansion, self._respond)
        self.calls += element.points
        self.elements.append(self._checked(element))

    def _split(self, worst: Element) -> None:
        across = _direction(worst)
        for half in worst.cell.halves(across):
            self._add(half)
        before, after = worst.squared_errors, np.mean([one.squared_errors for one in self.elements[-2:]], axis=0)
        if (after >= _IN_VAIN * before).all():
            self.elements[-2:] = [replace(one, in_vain=across) for one in self.elements[-2:]]
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
        count = max(min(self._fresh_points, self._settings.budget - self.calls), 0)
        levels = even_levels(self._generator, count, len(self.germs))
        if not len(levels):
            return
        points = at_levels(self.germs.values(), levels)
        values = list(responses(lambda at: plain(self._respond(at)), tuple(self.germs), points, self.calls))
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

    Two, because a response that is odd about the element's middle, such as a jump there, has no even terms. If both are
    but rounding, as where the element's samples miss what fresh points meet, it is the variable in which it is widest.
    Few samples at a jump may point along it: what was halved in vain counts less in the next choice.
    """
    degrees = worst.basis.indices
    highest = degrees.sum(axis=1) >= degrees.sum(axis=1).max() - 1
    squares = sum(np.sum(terms**2, axis=1) / (np.sum(terms[1:] ** 2) or 1.0) for terms in worst.known)
    parts = (squares * highest) @ degrees
    parts = parts if parts.max() > ROUNDING**2 else np.subtract(worst.cell.high, worst.cell.low)
    return int(np.argmax(np.where(np.arange(len(parts)) == worst.in_vain, _DAMPED * parts, parts)))


def collocate_elements(
    germs: Mapping[str, AbstractGerm], settings: MultiElement, cells: tuple[Cell, ...]
) -> Discretisation:
    """The polynomials of some cells, and the points of all of them with the map to coefficients."""
    each = [collocate(cell.germs(germs), Expansion(settings.order)) for cell in cells]
    basis = PiecewiseBasis(germs, cells, tuple(one.basis for one in each))
    return Discretisation(basis, basis.joined([one.collocation for one in each]))
