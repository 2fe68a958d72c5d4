"""Where a simulation failed: the realisation, its parameter values, the output and the time."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator.design import first_broken, grid_at, unsolved
from aleator.dynamics import Grid
from aleator.ensemble import inputs_at, listed
from aleator.transcription import AbstractTranscribed

# Most numbers in a message.
_MOST_NUMBERS = 5


def diagnose(transcribed: AbstractTranscribed, decisions: Float[np.ndarray, " n"]) -> str:
    """A message on the first point, output and instant whose value is not finite: the reason, then a few numbers."""
    outputs = {name: np.asarray(values) for name, values in transcribed.outputs(decisions).items()}
    times = grid_at(transcribed.problem, jnp.asarray(decisions)).times
    broken = first_broken(outputs)
    numbers = dict(zip(transcribed.places.entry_names(), decisions.tolist(), strict=True))
    if broken is None:
        return (
            "Where the solver stopped, every simulation is finite, but the objective, a constraint or its derivative "
            "is not: look for a root or logarithm of zero, or a division by zero, in outputs or cost curves. The "
            f"decisions are {_few(numbers, _MOST_NUMBERS)}."
        )
    name, point, instant = broken
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
