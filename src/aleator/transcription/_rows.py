"""The rows of constraints in the vector of a program's constraints: their places and bounds."""

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from aleator.design import Constraint, is_at_points, is_worst_case
from aleator.transcription._magnitudes import spread
from aleator.transcription._scenarios import Scenarios


def rows_of(sizes: Int[np.ndarray, " constraints"]) -> tuple[slice, ...]:
    """The rows of each constraint, from how many it has."""
    ends = np.cumsum([0, *sizes]).tolist()
    return tuple(slice(first, last) for first, last in itertools.pairwise(ends))


def row_bounds(
    constraints: Sequence[Constraint], rows: tuple[slice, ...], scenarios: Scenarios | None
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """The lower and upper bounds of all rows, infinite for limits on realisations in slots that do not count."""
    lower = spread(rows, [float(one.lower) for one in constraints])
    upper = spread(rows, [float(one.upper) for one in constraints])
    for one, where in zip(constraints, rows, strict=True):
        if (used := _used(one, scenarios)) is not None:
            empty = ~np.resize(used, where.stop - where.start)
            lower[where][empty], upper[where][empty] = -np.inf, np.inf
    return lower, upper


def _used(constraint: Constraint, scenarios: Scenarios | None) -> Bool[np.ndarray, " slots"] | None:
    """The slots at which a constraint is imposed; None if it is not one on realisations."""
    if scenarios is None or not (is_worst_case(constraint) or is_at_points(constraint)):
        return None
    return scenarios.used if is_worst_case(constraint) else scenarios.fixed


def as_read(
    constraint: Constraint,
    scenarios: Scenarios | None,
    values: Float[np.ndarray, " rows"],
    multipliers: Float[np.ndarray, " rows"],
    active: Bool[np.ndarray, " rows"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A constraint's rows for reports: for a limit on realisations, the worst over its scenarios."""
    if (used := _used(constraint, scenarios)) is None:
        return values, multipliers, active
    values, multipliers, active = (one.reshape(-1, len(used))[:, used] for one in (values, multipliers, active))
    worst = values.max(axis=1) if np.isfinite(float(constraint.upper)) else values.min(axis=1)
    return worst, multipliers.sum(axis=1), np.asarray(active.any(axis=1))
