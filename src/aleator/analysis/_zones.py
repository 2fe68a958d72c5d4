"""Tolerance zones: where each dimension of an assembly may lie."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator.uncertainty import AbstractDistribution, Placements, Toleranced, Uniform, with_distributions

SIGMAS = 3.0


class Zone(NamedTuple):
    """An interval of a dimension, in its unit."""

    lower: float
    upper: float

    @property
    def half_width(self) -> float:
        """Half of its width."""
        return (self.upper - self.lower) / 2

    def __str__(self) -> str:
        return f"{(self.lower + self.upper) / 2:.6g} ± {self.half_width:.4g}"


def zones_of(places: Placements, tolerances: Mapping[str, Any]) -> dict[str, Zone]:
    """The zone of each dimension: as given, or from its distribution. See `tolerance_analysis`."""
    unknown = sorted(set(tolerances) - set(places.distributions))
    if unknown:
        raise ProblemError(
            f"tolerance_analysis: there is no uncertain dimension {unknown}; expected some of "
            f"{list(places.distributions)}."
        )
    return {
        name: _given(distribution, tolerances[name]) if name in tolerances else zone_of(distribution)
        for name, distribution in places.distributions.items()
    }


def zone_of(distribution: AbstractDistribution) -> Zone:
    """The zone that a distribution implies, at the initial values of its decisions."""
    distribution = distribution.initial()
    if isinstance(distribution, Toleranced):
        return Zone(*map(float, distribution.limits()))
    lower, upper = map(float, distribution.support())
    if np.isfinite([lower, upper]).all():
        return Zone(lower, upper)
    middle, reach = float(distribution.mean()), SIGMAS * float(distribution.std())
    return Zone(middle - reach, middle + reach)


def _given(distribution: AbstractDistribution, tolerance: Any) -> Zone:
    minus, plus = tolerance if isinstance(tolerance, tuple) else (tolerance, tolerance)
    if not (np.isfinite([minus, plus]).all() and minus >= 0 and plus >= 0 and minus + plus > 0):
        raise ProblemError(f"tolerance_analysis: a tolerance is positive and finite; received {tolerance!r}.")
    middle = float(distribution.initial().mean())
    return Zone(middle - minus, middle + plus)


def in_zones(model: Pytree, zones: Mapping[str, Zone]) -> Pytree:
    """The model with each dimension free in its zone: uniform distributions, for the worst case."""
    return with_distributions(model, lambda name, _: Uniform.bounds(*zones[name]))
