"""Adaptive refinement: which element to split, across which variable, and when to stop."""

from dataclasses import replace
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator.analysis._box import Box
from aleator.analysis._element import Element, element, flat
from aleator.analysis._multi_element import MultiElement
from aleator.analysis._sampling import Sampler
from aleator.ensemble import at_levels, random_levels
from aleator.expansion import Expansion

# Fresh points for checking elements with small errors: their own samples cannot show a jump between them.
_FRESH_POINTS = 128

# Outputs that vary by less than this part of their size are constant up to rounding.
_ROUNDING = 1e-12


@final
class Refinement:
    """A set of elements that is refined, starting from one.

    - `elements`: at present; `splits`: the variable of each split, in order; `calls`: of the function;
    - `error`: the estimated relative rms error of the piecewise expansion.
    """

    def __init__(self, sampler: Sampler, wish: MultiElement):
        self._sampler, self._wish, self._expansion = sampler, wish, Expansion(wish.order)
        self.germs = sampler.places.germs
        self.elements: list[Element] = []
        self.splits: list[str] = []
        self.calls = 0
        self._generator = np.random.default_rng(0)
        self._fresh_variance: Float[np.ndarray, " outputs"] = np.zeros(1)
        self._add(Box((0.0,) * len(self.germs), (1.0,) * len(self.germs)))

    def run(self) -> None:
        """Split until the error is small enough, at fresh points too, or the budget is spent."""
        per_split = 2 * self.elements[0].points
        while True:
            if self.error <= self._wish.error:
                if not self._affords(_FRESH_POINTS):
                    return
                self._try_fresh_points()
                if self.error <= self._wish.error:
                    return
            if not self._affords(per_split):
                return
            self._split(self.elements.pop(int(np.argmax(self._shares().max(axis=1)))))

    @property
    def error(self) -> float:
        """The estimated relative rms error, the largest over the outputs."""
        return float(np.sqrt(self._shares().sum(axis=0).max()))

    def _affords(self, calls: int) -> bool:
        return self.calls + calls <= self._wish.budget

    def _add(self, box: Box) -> None:
        self.elements.append(element(box, self.germs, self._expansion, self._sampler))
        self.calls += self.elements[-1].points

    def _split(self, worst: Element) -> None:
        across = _direction(worst)
        for half in worst.box.halves(across):
            self._add(half)
        self.splits.append(worst.basis.names[across])

    def _shares(self) -> Float[np.ndarray, "elements outputs"]:
        """Each element's part in the squared error of each output, relative to its variance."""
        probability = np.array([one.box.probability for one in self.elements])
        errors = probability[:, None] * np.array([one.squared_errors for one in self.elements])
        outputs = zip(*(one.known for one in self.elements), strict=True)
        scale = np.maximum([_variance(probability, terms) for terms in outputs], self._fresh_variance)
        return errors / np.where(scale > 0, scale, 1.0)[None]

    def _try_fresh_points(self) -> None:
        """Raise the errors of elements to those at fresh points, which no fit has used."""
        levels = random_levels(self._generator, _FRESH_POINTS, len(self.germs))
        points = at_levels(self.germs.values(), levels)
        values = flat(self._sampler.samples(jax_array(points)))
        self.calls += _FRESH_POINTS
        self._fresh_variance = np.array([one.var(axis=0).sum() for one in values])
        for k, one in enumerate(self.elements):
            inside = one.box.holds(levels)
            misses = zip(one.prediction(points[inside]), values, strict=True)
            squares = np.array([((predicted - true[inside]) ** 2).sum() for predicted, true in misses])
            fresh = squares / (_FRESH_POINTS * one.box.probability)
            self.elements[k] = replace(one, squared_errors=np.maximum(one.squared_errors, fresh))


def _variance(probability: Float[np.ndarray, " elements"], terms: tuple[np.ndarray, ...]) -> float:
    """The variance of one output over all elements, summed over its entries; at least that of rounding."""
    means = np.stack([one[0] for one in terms])
    within = np.array([(one[1:] ** 2).sum() for one in terms])
    away = ((means - (probability @ means)[None]) ** 2).sum(axis=1)
    return float(probability @ (within + away + _ROUNDING**2 * (means**2).sum(axis=1)))


def _direction(worst: Element) -> int:
    """The variable to split: the one with the largest part in the terms of the two highest degrees.

    Two, because a response that is odd about the element's middle, such as a jump there, has no even terms. If nothing
    varies at the element's samples, it is the variable in which the element is widest.
    """
    degrees = worst.basis.indices
    highest = degrees.sum(axis=1) >= degrees.sum(axis=1).max() - 1
    squares = sum(np.sum(terms**2, axis=1) / (np.sum(terms[1:] ** 2) or 1.0) for terms in worst.known)
    parts = (squares * highest) @ degrees
    return int(np.argmax(parts if parts.max() > 0 else np.subtract(worst.box.high, worst.box.low)))
