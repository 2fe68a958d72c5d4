"""Where a simulation failed: the realisation, its parameter values, the output and the time."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator.design import grid_at, unsolved
from aleator.dynamics import Grid
from aleator.ensemble import inputs_at, listed
from aleator.transcription import AbstractTranscribed

# Most numbers in a message.
_MOST_NUMBERS = 5


def diagnose(transcribed: AbstractTranscribed, decisions: Float[np.ndarray, " n"]) -> str:
    """A message on the first point, output and instant whose value is not finite: the reason, then a few numbers."""
    outputs = {name: np.asarray(values) for name, values in transcribed.outputs(decisions).items()}
    times = grid_at(transcribed.problem, jnp.asarray(decisions)).times
    broken = {name: _first(values) for name, values in outputs.items() if not np.isfinite(values).all()}
    numbers = dict(zip(transcribed.places.entry_names(), decisions.tolist(), strict=True))
    if not broken:
        return (
            "Where the solver stopped, every simulation is finite, but the objective, a constraint or its derivative "
            "is not: look for a root or logarithm of zero, or a division by zero, in outputs or cost curves. The "
            f"decisions are {_few(numbers, _MOST_NUMBERS)}."
        )
    name, (point, instant) = min(broken.items(), key=lambda item: item[1][1])
    uncertain = inputs_at(transcribed.places, transcribed.points[point], jnp.asarray(decisions))
    # The realisation's numbers take precedence: one of many failed, while all have the same decisions.
    realised = min(len(uncertain), _MOST_NUMBERS - min(len(numbers), 2))
    count = len(transcribed.collocation.points)
    place = f"collocation point {point + 1} of {count}" if point < count else "a scenario of the worst case"
    who = f"{place} ({_few(uncertain, realised)})" if uncertain else ""
    where = f"The decisions are {_few(numbers, _MOST_NUMBERS - realised)}."
    germ = jnp.asarray(transcribed.points[point])
    if reason := unsolved(transcribed.problem, germ, jnp.asarray(decisions)):
        return f"{reason.rstrip('.')}.{who and f' This is {who}.'} {where}"
    what = f"The simulation{who and ' of ' + who} is not finite: output '{name}'"
    if not isinstance(transcribed.problem.grid, Grid):
        return f"{what}. Look for a root or logarithm of zero, or a division by zero. {where}"
    remedy = (
        "Shorten the time step, tighten the decisions' bounds or use an implicit integrator (al.integrators.Kvaerno5)."
    )
    return f"{what} from t = {times[instant]:.4g} s on. {remedy} {where}"


def _few(numbers: dict[str, float], most: int) -> str:
    """The first of some numbers, and how many more there are."""
    shown = listed(dict(list(numbers.items())[:most]))
    return f"{shown} and {len(numbers) - most} more" if len(numbers) > most else shown


def _first(values: np.ndarray) -> tuple[int, int]:
    """Point and instant of the earliest value that is not finite, in an array (points, instants, ...)."""
    bad = ~np.isfinite(values.reshape(*values.shape[:2], -1)).all(axis=2)
    instant = int(np.argmax(bad.any(axis=0)))
    return int(np.argmax(bad.take(instant, axis=1))), instant
