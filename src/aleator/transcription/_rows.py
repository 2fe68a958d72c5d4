"""The rows of constraints in the vector of a program's constraints: their places and bounds."""

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from aleator.design import Constraint, is_worst_case
from aleator.transcription._magnitudes import spread
from aleator.transcription._scenarios import Scenarios


def rows_of(sizes: Int[np.ndarray, " constraints"]) -> tuple[slice, ...]:
    """The rows of each constraint, from how many it has."""
    ends = np.cumsum([0, *sizes]).tolist()
    return tuple(slice(first, last) for first, last in itertools.pairwise(ends))


def row_bounds(
    constraints: Sequence[Constraint], rows: tuple[slice, ...], scenarios: Scenarios | None
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """The lower and upper bounds of all rows, infinite for limits on the worst case in empty slots."""
    lower = spread(rows, [float(one.lower) for one in constraints])
    upper = spread(rows, [float(one.upper) for one in constraints])
    for one, where in zip(constraints, rows, strict=True):
        if scenarios is not None and is_worst_case(one):
            empty = ~np.resize(scenarios.used, where.stop - where.start)
            lower[where][empty], upper[where][empty] = -np.inf, np.inf
    return lower, upper


def as_read(
    constraint: Constraint,
    scenarios: Scenarios | None,
    values: Float[np.ndarray, " rows"],
    multipliers: Float[np.ndarray, " rows"],
    active: Bool[np.ndarray, " rows"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A constraint's rows for reports: for a limit on the worst case, the worst over its scenarios."""
    if scenarios is None or not is_worst_case(constraint):
        return values, multipliers, active
    used = scenarios.used
    values, multipliers, active = (one.reshape(-1, len(used))[:, used] for one in (values, multipliers, active))
    worst = values.max(axis=1) if np.isfinite(float(constraint.upper)) else values.min(axis=1)
    return worst, multipliers.sum(axis=1), np.asarray(active.any(axis=1))
