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
_LADDER = 10.0 ** -np.arange(3.0, 19.0)
# Differences from exact slopes, relative to these, fall by such factors from step to step where a row is smooth: by the
# step, or by its square, once they are below the first of these numbers, down to the second. Near a kink or a jump they
# stay, by such factors, and then fall at once by all, unless they are below the last number.
_FALLS, _NEAR, _NEARER = (1e-3, 0.2), 0.5, 0.02
_STAYS, _SMALL = (0.5, 2.0), 2e-3
# A derivative a step away from a bound is right if it misses the slope by less than this part of what the one at the
# bound does.
_SAME_BEYOND = 0.1


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
    here, scale = program.evaluate(point), program.variable_scale
    value, found = _values(here), _derivatives(here) * scale
    noise = _ROUNDINGS * np.finfo(float).eps * np.abs(value)

    def sides(which: int, step: float) -> Float[np.ndarray, "2 rows"]:
        """The slopes of all rows by a variable, seen over a step to both sides."""
        seen = np.full((2, value.size), np.nan)
        for slopes, length in zip(seen, (-step, step), strict=True):
            moved = point.copy()
            moved[which] = np.clip(point[which] + length * scale[which], program.lower[which], program.upper[which])
            actual = (moved[which] - point[which]) / scale[which]
            if abs(actual) >= step / 2:
                with np.errstate(invalid="ignore", over="ignore"):
                    slopes[:] = (_values(program.evaluate(moved)) - value) / actual
        return np.where(np.isfinite(seen), seen, np.nan)

    # What is not finite hides nothing of the others. Infinite slopes make others of their row NaN.
    exact, infinite = np.where(np.isfinite(found), found, np.nan), np.isinf(found)
    endless = infinite | (np.isnan(found) & ~infinite.any(axis=1, keepdims=True))
    # By steps, sides, rows and variables.
    every = np.array([[sides(i, step) for step in (*_STEPS, _FAR)] for i in range(point.size)])
    *near, far = np.moveaxis(every.reshape(point.size, len(_STEPS) + 1, 2, value.size), 0, -1)
    seen = np.array(near)
    known = np.nan_to_num(np.abs([exact, *seen.reshape(-1, *exact.shape)]))
    # What shows at each step, beyond rounding.
    shows = noise[:, None] / np.array(_STEPS)[:, None, None] + _SHOWS * known.max(axis=(0, 2), initial=0.0)[:, None]
    gaps = np.abs(seen[:, 1] - seen[:, 0])
    wide = gaps > shows
    ratios = np.divide(gaps[1:], gaps[:-1], out=np.zeros_like(gaps[1:]), where=gaps[:-1] > 0)
    appears = ((wide[:-1] & (ratios > _KINK)) | (gaps[:-1] == 0)) & wide[1:]
    jumps = (wide[1:] & wide[:-1] & (ratios > _JUMP)).any(axis=0)
    low, high = np.fmin(seen[:, 0], seen[:, 1]), np.fmax(seen[:, 0], seen[:, 1])
    with np.errstate(invalid="ignore"):
        outside = np.fmax(low - exact, exact - high) > np.fmax(high - low, 0.0) + shows
    broken = np.stack([appears.any(axis=0) & ~jumps, jumps, outside.all(axis=0) & ~jumps]) & np.isfinite(found)
    for i in np.flatnonzero(broken.any(axis=(0, 1))).tolist():
        lengths = _LADDER[_LADDER * scale[i] > _ROUNDINGS * np.spacing(abs(point[i]))]
        ladder = np.array([sides(i, step) for step in lengths.tolist()]).reshape(-1, 2, value.size)
        broken[:, _is_steep(exact[:, i], ladder, noise / lengths[:, None]), i] = False
    # At a bound one side is not seen: a derivative that is right a step away from it shows a kink, not a wrong rule.
    unseen = np.isnan(seen[0]).all(axis=1)
    for i in np.flatnonzero(broken[2].any(axis=0) & unseen.any(axis=0)).tolist():
        moved, is_below = point.copy(), int(unseen[0, i])
        moved[i] += (2 * is_below - 1) * _STEPS[0] * scale[i]
        slopes = seen[0, is_below, :, i]
        away = np.abs(_derivatives(program.evaluate(moved))[:, i] * scale[i] - slopes)
        is_kink = broken[2, :, i] & (away < _SAME_BEYOND * np.abs(exact[:, i] - slopes))
        broken[0, is_kink, i], broken[2, is_kink, i] = True, False
    effects = np.fmax(np.nan_to_num(np.abs(exact)), np.nan_to_num(np.fmax(*np.abs(far))))
    (left, right), (kinks, jumps, wrong) = seen[-1], broken
    return Slopes(found, left, right, effects, kinks, jumps, wrong, endless)


def _values(there: Evaluation) -> Float[np.ndarray, " rows"]:
    return np.append(there.objective, there.constraints)


def _derivatives(there: Evaluation) -> Float[np.ndarray, "rows n"]:
    return np.concatenate([there.gradient[None], dense_rows(there.jacobian)])


def _is_steep(
    exact: Float[np.ndarray, " rows"],
    ladder: Float[np.ndarray, "steps 2 rows"],
    noise: Float[np.ndarray, "steps rows"],
) -> Bool[np.ndarray, " rows"]:
    """Which rows are smooth: slopes over ever smaller steps tend to the exact one little by little."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        size = np.abs(exact)
        away = np.fmax(*np.moveaxis(np.abs(ladder - exact), 1, 0)) / size
        falls = away[1:] / away[:-1]
        near, seen = away[:-1] < _NEAR, away[1:] > noise[1:] / size
    told = near & seen & (away[1:] < _NEARER) & (falls > _FALLS[0]) & (falls < _FALLS[1])
    stays = near & (away[1:] > _SMALL) & (falls > _STAYS[0]) & (falls < _STAYS[1])
    # Once may be where rounding begins to show.
    return told.any(axis=0) & ~(stays[1:] & stays[:-1]).any(axis=0)


# Steps along a random direction, in typical magnitudes of the variables. A miss of a derivative is the same over both,
# but for this factor, where that of a smooth row falls and rounding rises; and it is above this part of the values.
_ALONG, _SAME, _MATTERS = (1e-3, 1e-4), 2.0, 1e-3


class Miss(NamedTuple):
    """By how much the Lagrangian changes along a random direction, and by how much by its derivatives."""

    seen: float
    exact: float


class Probe(NamedTuple):
    """Steps from a point along a random direction, in which none leaves the bounds.

    - `along`: the direction; `sides`: the signs of the steps; `lengths`: of a longer and a shorter one.
    """

    along: Float[np.ndarray, " n"]
    sides: tuple[float, ...]
    lengths: tuple[float, float]


def probe_at(program: NonlinearProgram, point: Float[np.ndarray, " n"], lengths: tuple[float, float] = _ALONG) -> Probe:
    """Steps from a point to both sides, or to one if there are variables near a bound, which move away from it.

    `lengths`: in typical magnitudes of the variables.
    """
    lower, upper = (point - program.lower) / program.variable_scale, (program.upper - point) / program.variable_scale
    generator = np.random.default_rng(0)
    direction = generator.uniform(0.5, 1.5, point.size) * generator.choice([-1.0, 1.0], point.size)
    reach = lengths[0] * np.abs(direction)
    at_lower, at_upper = lower <= reach, upper <= reach
    direction = np.where(at_lower, np.abs(direction), np.where(at_upper, -np.abs(direction), direction))
    direction[at_lower & at_upper] = 0.0
    return Probe(direction * program.variable_scale, (1.0,) if (at_lower | at_upper).any() else (-1.0, 1.0), lengths)


def missed_slope(
    program: NonlinearProgram,
    point: Float[np.ndarray, " n"],
    multipliers: Float[np.ndarray, " m"],
    probe: Probe | None = None,
) -> Miss | None:
    """Where values around a point do not follow their derivatives, by four evaluations; None where they do.

    The rows that hold the point are among them, by their multipliers.
    """
    along, sides, lengths = probe or probe_at(program, point)
    line = line_of(program, point, along, multipliers)
    here = line.evaluate(line.start)
    exact, steps = float(here.gradient[0]), np.array([[side * step for side in sides] for step in lengths])
    values = np.array([line.evaluate(np.array([step])).objective for step in steps.ravel()]).reshape(steps.shape)
    slopes = (values - here.objective) / steps
    if not np.isfinite(slopes).all():
        return None
    least, most = slopes.min(axis=1), slopes.max(axis=1)
    first, last = np.maximum(least - exact, exact - most) - (most - least)
    is_missed = last > _MATTERS * (here.objective + np.abs(slopes).max()) and first / _SAME < last < _SAME * first
    return Miss(float(slopes[-1].mean()), exact) if is_missed else None


def line_of(
    program: NonlinearProgram,
    point: Float[np.ndarray, " n"],
    direction: Float[np.ndarray, " n"],
    multipliers: Float[np.ndarray, " m"],
) -> NonlinearProgram:
    """The Lagrangian without constraints as a function of the steps along a direction; its value is that of its terms,
    to which rounding is relative.
    """
    here = program.evaluate(point)
    terms = abs(here.objective) + float(np.abs(multipliers) @ np.abs(here.constraints))

    def evaluate(step: Float[np.ndarray, " 1"]) -> Evaluation:
        there = program.evaluate(np.clip(point + step * direction, program.lower, program.upper))
        change = there.objective - here.objective + float(multipliers @ (there.constraints - here.constraints))
        slope = (there.gradient + multipliers @ there.jacobian) @ direction
        return Evaluation(terms + change, np.array([slope]), nothing, np.zeros((0, 1)))

    start, nothing = np.zeros(1), np.zeros(0)
    return NonlinearProgram(evaluate, start, start - np.inf, start + np.inf, nothing, nothing, nothing, start + 1.0)
