"""Violated constraints that no decision can change: a start inside an obstacle, an end beyond a limit."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator.design import Constraint, Problem
from aleator.nlp import HELD, Outcome
from aleator.transcription._abstract import AbstractTranscribed
from aleator.transcription._magnitudes import Values


def refuse_unsatisfiable(
    problem: Problem,
    values: Values,
    derivatives: Values,
    scales: list[float],
    times: Callable[[], Float[np.ndarray, " instants"]],
    elsewhere: Callable[[], Sequence[Values]],
) -> None:
    """Raise `ProblemError` for a constraint that is violated whatever the decisions are.

    - `values`, `derivatives`: of the constraints at the initial decisions;
    - `times`: the instants; `elsewhere`: gives the values at some other decisions. It is called only for suspect
      constraints, because a derivative may vanish at one point by chance, or over a range.
    """
    suspects = [
        (i, int(np.argmax(np.where(row, excess, -np.inf))))
        for i, (one, value, slope, scale) in enumerate(
            zip(problem.constraints, values, derivatives, scales, strict=True)
        )
        if (row := ((excess := _excess(one, value)) > HELD * scale) & np.all(slope == 0, axis=1)).any()
    ]
    if not suspects:
        return
    others = elsewhere()
    for i, row in suspects:
        if all(other[i][row] == values[i][row] for other in others):
            raise ProblemError(_sentence(problem.constraints[i], float(values[i][row]), len(values[i]), row, times()))


def refuse_blind(outcome: Outcome, transcribed: AbstractTranscribed) -> None:
    """Raise `ProblemError` for decisions that change values although all derivatives by them are zero."""
    names = blind_decisions(outcome, transcribed)
    if not names:
        return
    raise ProblemError(
        f"The objective or a constraint changes with {names}, but all its derivatives tried are zero, so that no "
        "solver by derivatives can choose: the model rounds, floors, casts to whole numbers or stops gradients. "
        "Make the effect smooth, let a search compare values (al.solvers.DifferentialEvolution()), or fix the number "
        "and compare its values one by one."
    )


def blind_decisions(outcome: Outcome, transcribed: AbstractTranscribed) -> str:
    """The decisions that change values although all derivatives by them are zero, in words; empty if there is none."""
    names = dict(zip(transcribed.decided.tolist(), transcribed.places.entry_names(), strict=True))
    return " and ".join(f"'{names[i]}'" for i in outcome.blind if i in names)


def _excess(constraint: Constraint, value: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):  # Infinite values of an infinite bound exceed nothing.
        return np.maximum(value - float(constraint.upper), float(constraint.lower) - value)


def _sentence(constraint: Constraint, value: float, rows: int, row: int, times: np.ndarray) -> str:
    when = f" at t = {times[row * len(times) // rows]:.4g} s" if constraint.is_path else ""
    return (
        f"Constraint '{constraint.name}' ({constraint}) is {value:.6g}{when} whatever the decisions are, so that "
        "no design can meet it. Move what is fixed there (a start inside an obstacle, an end beyond a limit), or "
        "change the bound."
    )
