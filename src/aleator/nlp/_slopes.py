"""The slopes of a program's rows by each variable: the exact ones beside those seen over small steps to either side."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from aleator.nlp._matrices import dense_rows
from aleator.nlp._program import Evaluation, NonlinearProgram

# Lengths of the steps, in typical magnitudes of the variables, and of those over which effects are measured, since an
# exact slope may be zero at an optimum.
_STEPS, _FAR = (1e-3, 1e-5, 1e-7), 0.1
# A change below this many rounding errors of a row's value cannot be told from none.
_ROUNDINGS = 1e3
# The gap between the slopes to both sides falls with the step where a row is smooth, by a factor of 100 here. Above the
# first of these ratios there is a kink; above the second a jump, across which the gap grows as steps become smaller.
_KINK, _JUMP = 0.3, 10.0
# Gaps, and errors of exact slopes, below this part of a row's largest slope are none.
_SHOWS = 1e-4


class Slopes(NamedTuple):
    """Slopes at a point: of the objective first, then of each constraint, by each variable; shape (1 + m, n).

    All are changes over a typical magnitude of the variable. NaN where no step is possible: fixed variables, one side
    at a bound, points at which the model is not finite.

    - `exact`: by the program's derivatives; `left`, `right`: seen over the smallest step;
    - `effects`: the largest magnitude of the exact one and of those over a tenth of a typical magnitude;
    - `kinks`, `jumps`: where slopes to both sides differ however small the step, and where values do;
    - `wrong`: where the exact slope is neither of them, nor between them.
    """

    exact: Float[np.ndarray, "rows n"]
    left: Float[np.ndarray, "rows n"]
    right: Float[np.ndarray, "rows n"]
    effects: Float[np.ndarray, "rows n"]
    kinks: Bool[np.ndarray, "rows n"]
    jumps: Bool[np.ndarray, "rows n"]
    wrong: Bool[np.ndarray, "rows n"]


def slopes_at(program: NonlinearProgram, point: Float[np.ndarray, " n"]) -> Slopes:
    """Compare exact slopes with those over steps of three lengths to both sides: eight evaluations a variable."""
    here = program.evaluate(point)
    exact = _derivatives(here) * program.variable_scale
    *steps, far = (_sides(program, point, here, step) for step in (*_STEPS, _FAR))
    sides = np.stack(steps)
    values = np.abs(_values(here))[:, None]
    noise = _ROUNDINGS * np.finfo(float).eps * values / np.array(_STEPS)[:, None, None]
    shows = _SHOWS * np.nanmax(np.abs(np.concatenate([exact[None], *sides])), axis=(0, 2), initial=0.0)[:, None]
    gaps = np.abs(sides[:, 1] - sides[:, 0])
    wide = gaps > noise + shows
    ratios = np.divide(gaps[1:], gaps[:-1], out=np.zeros_like(gaps[1:]), where=gaps[:-1] > 0)
    appears = wide[1:] & (gaps[:-1] == 0)
    kinks = ((wide[1:] & wide[:-1] & (ratios > _KINK)) | appears).any(axis=0)
    jumps = (wide[1:] & wide[:-1] & (ratios > _JUMP)).any(axis=0)
    wrong = _is_wrong(exact, sides, noise, shows) & ~jumps
    effects = np.fmax(np.abs(exact), np.nan_to_num(np.fmax(*np.abs(far))))
    left, right = sides[-1]
    return Slopes(exact, left, right, effects, kinks & ~jumps, jumps, wrong)


def _is_wrong(
    exact: Float[np.ndarray, "rows n"],
    sides: Float[np.ndarray, "steps 2 rows n"],
    noise: Float[np.ndarray, "steps rows 1"],
    shows: Float[np.ndarray, "rows 1"],
) -> Bool[np.ndarray, "rows n"]:
    """Whether exact slopes lie outside those to both sides, by more than these differ, whatever the step."""
    with np.errstate(invalid="ignore"):
        low, high = np.fmin(*np.moveaxis(sides, 1, 0)), np.fmax(*np.moveaxis(sides, 1, 0))
        outside = np.fmax(low - exact, exact - high)
        return np.all(outside > np.fmax(high - low, 0.0) + noise + shows, axis=0)


def _sides(
    program: NonlinearProgram, point: Float[np.ndarray, " n"], here: Evaluation, step: float
) -> Float[np.ndarray, "2 rows n"]:
    """The slopes of all rows by each variable, seen over a step to the left and to the right."""
    every = range(point.size)
    return np.stack([np.stack([_side(program, point, here, i, one) for i in every], axis=-1) for one in (-step, step)])


def _side(
    program: NonlinearProgram, point: Float[np.ndarray, " n"], here: Evaluation, which: int, step: float
) -> Float[np.ndarray, " rows"]:
    moved = point.copy()
    moved[which] += step * program.variable_scale[which]
    moved[which] = np.clip(moved[which], program.lower[which], program.upper[which])
    actual = (moved[which] - point[which]) / program.variable_scale[which]
    if abs(actual) < abs(step) / 2:
        return np.full(1 + here.constraints.size, np.nan)
    return (_values(program.evaluate(moved)) - _values(here)) / actual


def _values(found: Evaluation) -> Float[np.ndarray, " rows"]:
    return np.append(found.objective, found.constraints)


def _derivatives(found: Evaluation) -> Float[np.ndarray, "rows n"]:
    every = np.arange(found.constraints.size)
    return np.concatenate([found.gradient[None], dense_rows(found.jacobian, every)])
