"""Where a simulation went wrong: the realisation, its parameter values, the output and the time."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator.design import unsolved
from aleator.dynamics import Grid
from aleator.transcription._sequential import Sequential
from aleator.uncertainty import uncertain_numbers


def diagnose(transcription: Sequential, decisions: Float[np.ndarray, " n"]) -> str:
    """One sentence naming the first collocation point, output and instant whose value is not finite."""
    outputs = {name: np.asarray(values) for name, values in transcription.outputs(decisions).items()}
    times = transcription.times(decisions)
    broken = {name: _first(values) for name, values in outputs.items() if not np.isfinite(values).all()}
    where = ", ".join(f"{name}={value:.6g}" for name, value in _flat(transcription, decisions).items())
    if not broken:
        return (
            f"At {where} every simulation is finite, but the objective, a constraint or its derivative is not: "
            "look for a root or logarithm of zero, or a division by zero, in outputs or cost curves."
        )
    name, (point, instant) = min(broken.items(), key=lambda item: item[1][1])
    realisation = ", ".join(
        f"{key}={value:.6g}" for key, value in _realisation(transcription, decisions, point).items()
    )
    who = f"collocation point {point + 1} of {len(outputs[name])} ({realisation})" if realisation else ""
    germ = transcription.collocation.points[point]
    if reason := unsolved(transcription.problem, germ, jnp.asarray(decisions)):
        return f"At {where}{who and ', ' + who}: {reason}"
    what = f"the simulation{who and ' of ' + who} is not finite: output '{name}'"
    if not isinstance(transcription.problem.grid, Grid):
        return f"At {where}, {what}. Look for a root or logarithm of zero, or a division by zero."
    remedy = "Shorten the time step, tighten the decisions' bounds or use an implicit integrator (al.Kvaerno5)."
    return f"At {where}, {what} from t = {times[instant]:.4g} s on. {remedy}"


def _first(values: np.ndarray) -> tuple[int, int]:
    """Point and instant of the earliest value that is not finite, in an array (points, instants, ...)."""
    bad = ~np.isfinite(values.reshape(*values.shape[:2], -1)).all(axis=2)
    instant = int(np.argmax(bad.any(axis=0)))
    return int(np.argmax(bad.take(instant, axis=1))), instant


def _flat(transcription: Sequential, decisions: np.ndarray) -> dict[str, float]:
    return dict(zip(transcription.places.entry_names(), decisions.tolist(), strict=True))


def _realisation(transcription: Sequential, decisions: np.ndarray, point: int) -> dict[str, float]:
    """The uncertain numbers at one collocation point."""
    germ = transcription.collocation.points[point]
    numbers = uncertain_numbers(transcription.places, germ, jnp.asarray(decisions))
    return {name: float(number) for name, number in numbers.items()}
