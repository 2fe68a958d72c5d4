"""Limits on statistics of all systems: the sampled statistics compared with the bounds."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator._core.shown import Printed
from aleator.design import Constraint, Estimated, Problem, Statistic, estimated, grid_at
from aleator.references._estimate import pair
from aleator.validation._disagreement import reach

# Half-width of a 95 % confidence interval, in standard errors.
_CONFIDENT = 1.96


@final
@dataclass(frozen=True)
class Compared(Printed):
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
    if not any(isinstance(leaf, Statistic) for leaf in expression.leaves):
        return None
    found = estimated(problem, expression, known, decisions)
    if found is None:
        return None
    value, error = found
    times = np.asarray(grid_at(problem, jnp.asarray(decisions)).times)
    lower, upper = float(constraint.lower), float(constraint.upper)
    beyond = np.maximum(value - upper, lower - value)
    sure = reach(freedom, value.size)
    i = int(np.argmax(beyond - sure * error))
    when = float(times[i // (value.size // len(times))]) if constraint.is_path else None
    worst, off, far = (float(np.ravel(part)[i]) for part in (value, error, beyond))
    bound = upper if worst - upper >= lower - worst else lower
    return Compared(constraint.name, str(constraint), worst, off, when, bound, far, tolerance, sure)
