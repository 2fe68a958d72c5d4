"""The same design at half the widths of `al.smooth`: what it owes to smoothing."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from aleator.certification._check import Check, begin_check, row_sizes
from aleator.solution import TOLERATED, Smoothing
from aleator.transcription import AbstractTranscribed


def at_half_width(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], check: Check
) -> Smoothing | None:
    """Objective and limits at half the widths, on the grid of a check; None without widths."""
    narrower = transcribed.problem.narrower()
    if narrower is None:
        return None
    again = begin_check(replace(transcribed, problem=narrower), point, check.factor, check.systems)()
    sizes, moved, broken = row_sizes(transcribed, point), dict[str, float](), dict[str, None]()
    each = zip(narrower.constraints, transcribed.rows, check.values[1:], again.values[1:], strict=True)
    for one, rows, *values in each:
        moved[one.name] = max(moved.get(one.name, 0.0), float(np.max(np.abs(values[1] - values[0]))))
        before, after = (float(np.max(np.maximum(value - one.upper, one.lower - value))) for value in values)
        if not after <= max(before, 0.0) + TOLERATED * float(np.max(sizes[rows])):
            broken[one.name] = None
    return Smoothing(float(check.values[0]), float(again.values[0]), moved, tuple(broken))
