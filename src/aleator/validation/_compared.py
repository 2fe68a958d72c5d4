"""Limits on statistics of all systems: the sampled statistics compared with the bounds."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator.design import AbstractScopeOfInstants, Constraint, Problem, Statistic, grid_at, step_at
from aleator.references._estimate import pair
from aleator.statistics import AbstractStatistic
from aleator.uncertainty import named_numbers
from aleator.validation._disagreement import reach

# Half-width of a 95 % confidence interval, in standard errors.
_CONFIDENT = 1.96


class Estimated(NamedTuple):
    """A statistic of the samples with its standard error: numbers, or one number per instant."""

    value: Float[np.ndarray, "*shape"]
    standard_error: Float[np.ndarray, "*shape"]


@final
@dataclass(frozen=True)
class Compared:
    """A limit on a statistic, evaluated with the sampled statistic instead of the expansion's.

    - `value`, `standard_error`: its expression by the samples, at the `time` (s) closest to or furthest beyond the
      bound, None for a number; the error is an upper bound where it contains several statistics;
    - `bound`: the nearer, or the more exceeded, of the two bounds; `beyond`: by how much it is exceeded, negative
      inside; `tolerance`: the excess that is ignored;
    - `reach`: how many standard errors are beyond chance, given the number of its instants.
    """

    name: str
    text: str
    value: float
    standard_error: float
    time: float | None
    bound: float
    beyond: float
    tolerance: float
    reach: float

    @property
    def meets(self) -> bool | None:
        """Whether the limit is met, with 95 % confidence; None where the samples cannot decide."""
        # NaN meets no limit; an extreme has no standard error.
        if np.isnan(self.beyond) or self.beyond > self.tolerance + self.reach * self.standard_error:
            return False
        return True if self.beyond + _CONFIDENT * self.standard_error <= self.tolerance else None

    def sentence(self) -> str:
        """The sampled value, and the verdict on the limit."""
        when = "" if self.time is None else f" at t = {self.time:.4g} s"
        found = f"{self.value:.6g}" if not self.standard_error > 0 else pair(self.value, self.standard_error)
        verdict = {True: "met", False: "BROKEN", None: "within its error of the bound"}[self.meets]
        return f"{self.text}: sampled {found}{when}, {verdict}"

    def __str__(self) -> str:
        return self.sentence()


@final
class _SampledScope(AbstractScopeOfInstants):
    """Takes statistics from the samples, with the statistic `moved`, if any, shifted by its standard error."""

    def __init__(self, known: Mapping[Any, Estimated], numbers: Mapping[str, Array], step: Array, moved: Any = None):
        self._known, self._numbers, self.step, self._moved = known, numbers, step, moved

    @override
    def statistic(self, functionals: tuple[Any, ...], kind: AbstractStatistic) -> Array:
        key = Statistic(functionals, kind).text()
        one = self._known[key]
        return jnp.asarray(one.value + one.standard_error if key == self._moved else one.value)

    @override
    def value(self, name: str) -> Array:
        return self._numbers[name]


def compared(
    problem: Problem,
    constraint: Constraint,
    known: Mapping[str, Estimated],
    decisions: Float[np.ndarray, " n"],
    tolerance: float,
    freedom: int,
) -> Compared | None:
    """A limit evaluated with sampled statistics, `known` by their texts; None where one that it needs is missing."""
    expression = constraint.expression
    needed = {leaf.text() for leaf in expression.leaves if isinstance(leaf, Statistic)}
    if not needed or not needed <= set(known):
        return None
    at = jnp.asarray(decisions)
    numbers, step = named_numbers(problem.simulation, at), step_at(problem, at)
    times = np.asarray(grid_at(problem, at).times)

    def evaluated(moved: str | None = None) -> np.ndarray:
        return np.asarray(expression.evaluate(_SampledScope(known, numbers, step, moved)))

    value = evaluated()
    # The sum of the errors is the worst case: the dependence between statistics of one sample is not known.
    error = sum((np.abs(evaluated(one) - value) for one in needed), start=np.zeros(value.shape))
    lower, upper = float(constraint.lower), float(constraint.upper)
    beyond = np.maximum(value - upper, lower - value)
    sure = reach(freedom, value.size)
    i = int(np.argmax(beyond - sure * error))
    when = float(times[i // (value.size // len(times))]) if constraint.is_path else None
    found, off, far = (float(np.ravel(part)[i]) for part in (value, error, beyond))
    bound = upper if found - upper >= lower - found else lower
    return Compared(constraint.name, str(constraint), found, off, when, bound, far, tolerance, sure)
