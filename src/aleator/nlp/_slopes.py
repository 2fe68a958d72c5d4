"""Slopes seen over small steps around a point, beside the exact ones: kinks, jumps and wrong derivatives."""

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
# A smooth row may be steep between these steps. Where something seems wrong, steps go on down to the last of these.
_LADDER = tuple(10.0**-power for power in range(3, 19))
# Differences from exact slopes, relative to these, fall by such factors from step to step where a row is smooth: by the
# step, or by its square, once they are below the first of these numbers, down to the second. Near a kink or a jump they
# stay, by such factors, and then fall at once by all, unless they are below the last number.
_FALLS, _NEAR, _NEARER = (1e-3, 0.2), 0.5, 0.02
_STAYS, _SMALL = (0.5, 2.0), 2e-3


class Slopes(NamedTuple):
    """Slopes at a point: of the objective first, then of each constraint, by each variable; shape (1 + m, n).

    All are changes over a typical magnitude of the variable. NaN where no step is possible: fixed variables, one side
    at a bound, points at which the model is not finite.

    - `exact`: by the program's derivatives; `left`, `right`: seen over the smallest step;
    - `effects`: the largest magnitude of the exact one and of those over a tenth of a typical magnitude;
    - `kinks`, `jumps`: where slopes to both sides differ however small the step, and where values do;
    - `wrong`: where the exact slope is neither of them, nor between them;
    - `endless`: where the exact slope is infinite, or not a number though no other one of the row is infinite.
    """

    exact: Float[np.ndarray, "rows n"]
    left: Float[np.ndarray, "rows n"]
    right: Float[np.ndarray, "rows n"]
    effects: Float[np.ndarray, "rows n"]
    kinks: Bool[np.ndarray, "rows n"]
    jumps: Bool[np.ndarray, "rows n"]
    wrong: Bool[np.ndarray, "rows n"]
    endless: Bool[np.ndarray, "rows n"]


def slopes_at(program: NonlinearProgram, point: Float[np.ndarray, " n"]) -> Slopes:
    """Compare exact slopes with those over steps of three lengths to both sides: eight evaluations a variable.

    Where these suggest a kink, a jump or a wrong slope, up to 32 more tell it from a row that is smooth but steep.
    """
    here = program.evaluate(point)
    found = _derivatives(here) * program.variable_scale
    endless = _endless(found)
    # What is not finite hides nothing of the others.
    exact = np.where(np.isfinite(found), found, np.nan)
    *steps, far = (_sides(program, point, here, step) for step in (*_STEPS, _FAR))
    sides = np.stack(steps)
    values = np.abs(_values(here))[:, None]
    noise = _ROUNDINGS * np.finfo(float).eps * values / np.array(_STEPS)[:, None, None]
    known = np.abs(np.nan_to_num(np.concatenate([exact[None], *sides]), nan=0.0, posinf=0.0, neginf=0.0))
    shows = _SHOWS * known.max(axis=(0, 2), initial=0.0)[:, None]
    gaps = np.abs(sides[:, 1] - sides[:, 0])
    wide = gaps > noise + shows
    ratios = np.divide(gaps[1:], gaps[:-1], out=np.zeros_like(gaps[1:]), where=gaps[:-1] > 0)
    appears = wide[1:] & (gaps[:-1] == 0)
    kinks = ((wide[1:] & wide[:-1] & (ratios > _KINK)) | appears).any(axis=0)
    jumps = (wide[1:] & wide[:-1] & (ratios > _JUMP)).any(axis=0)
    wrong = _is_wrong(exact, sides, noise, shows)
    certain = np.isfinite(found)
    certain &= ~_are_steep(program, point, here, exact, (kinks | jumps | wrong) & certain)
    kinks, jumps, wrong = kinks & ~jumps & certain, jumps & certain, wrong & ~jumps & certain
    effects = np.fmax(np.nan_to_num(np.abs(exact)), np.nan_to_num(np.fmax(*np.abs(far))))
    left, right = sides[-1]
    return Slopes(found, left, right, effects, kinks, jumps, wrong, endless)


def _endless(exact: Float[np.ndarray, "rows n"]) -> Bool[np.ndarray, "rows n"]:
    """Which slopes are to blame where some are not finite: infinite ones, which make others of the row NaN."""
    infinite = np.isinf(exact)
    return infinite | (np.isnan(exact) & ~infinite.any(axis=1, keepdims=True))


def _are_steep(
    program: NonlinearProgram,
    point: Float[np.ndarray, " n"],
    here: Evaluation,
    exact: Float[np.ndarray, "rows n"],
    suspects: Bool[np.ndarray, "rows n"],
) -> Bool[np.ndarray, "rows n"]:
    """Which suspects are smooth: slopes over ever smaller steps tend to the exact one little by little."""
    steep = np.zeros_like(suspects)
    values = np.abs(_values(here))
    for i in np.flatnonzero(suspects.any(axis=0)):
        steps = [step for step in _LADDER if step * program.variable_scale[i] > _ROUNDINGS * np.spacing(abs(point[i]))]
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            size = np.abs(exact[:, i])
            seen = [[_side(program, point, here, int(i), sign * step) for sign in (-1.0, 1.0)] for step in steps]
            away = np.array([np.fmax(*(np.abs(one - exact[:, i]) for one in both)) / size for both in seen])
            noise = _ROUNDINGS * np.finfo(float).eps * values / np.array(steps)[:, None] / size
            falls = away[1:] / away[:-1]
        near = away[:-1] < _NEAR
        told = near & (away[1:] < _NEARER) & (away[1:] > noise[1:]) & (falls > _FALLS[0]) & (falls < _FALLS[1])
        stays = near & (away[1:] > _SMALL) & (falls > _STAYS[0]) & (falls < _STAYS[1])
        # Once may be where rounding begins to show.
        stays = stays[1:] & stays[:-1]
        steep[:, i] = suspects[:, i] & told.any(axis=0) & ~stays.any(axis=0)
    return steep


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
    with np.errstate(invalid="ignore", over="ignore"):
        slopes = (_values(program.evaluate(moved)) - _values(here)) / actual
    return np.where(np.isfinite(slopes), slopes, np.nan)


def _values(found: Evaluation) -> Float[np.ndarray, " rows"]:
    return np.append(found.objective, found.constraints)


def _derivatives(found: Evaluation) -> Float[np.ndarray, "rows n"]:
    every = np.arange(found.constraints.size)
    return np.concatenate([found.gradient[None], dense_rows(found.jacobian, every)])
