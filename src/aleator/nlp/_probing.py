"""What small steps around a point show: slopes of rows beside the exact ones, variables that an answer left at their
start, and those that change the objective although every slope of it is zero: a model that rounds, floors or casts.

First-order conditions hold at maxima, at saddles (a start on a line of symmetry never leaves it), and wherever a model
is flat: a rounded objective is so wherever it is looked at. Solvers descend, so that they end there only if they began
there: a few points nearby are checked. A search by values may end anywhere that is flat, so that all flat variables of
its answer are checked.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from aleator.nlp._matrices import Matrix, alone_in_a_row, column_is_zero, dense_rows, tangents
from aleator.nlp._program import Evaluation, NonlinearProgram
from aleator.nlp._solver import Outcome, Status

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


# Steps in typical magnitudes of all suspects together, and then of each alone: a short one, so that the model is likely
# to be finite, and a long one, across a coarse rounding.
_BLIND_STEPS = (0.05, -0.4)
# Values that differ by less than this part count as equal.
_SAME = 1e-12
# At most this many variables are checked, and named: the first ones.
_MOST = 12


def lost_variables(program: NonlinearProgram, point: np.ndarray, here: Evaluation) -> tuple[int, ...]:
    """Variables by which the slope of the objective is zero at a point and wherever else it is tried, although it
    changes with them.

    Two evaluations if some slope is exactly zero, two more for each of several suspects if the objective changes. In
    sparse programs, where an objective depends on few variables by construction, none is looked for.
    """
    flat = np.flatnonzero((here.gradient == 0) & (program.lower < program.upper))
    if not flat.size or not isinstance(here.jacobian, np.ndarray) or not np.isfinite(here.objective):
        return ()
    if not _are_lost(program, point, here, flat):
        return ()
    return tuple(int(one) for one in flat[:_MOST] if flat.size == 1 or _are_lost(program, point, here, np.array([one])))


def _are_lost(program: NonlinearProgram, point: np.ndarray, here: Evaluation, which: np.ndarray) -> bool:
    """Whether some step of these variables changes the objective without a slope."""
    return any(_changes_blindly(here, there, which) for there in _steps(program, point, which))


def _steps(program: NonlinearProgram, point: np.ndarray, which: np.ndarray) -> Iterator[Evaluation]:
    """Evaluations with some variables moved by each step, away from a bound that is too close."""
    size, bounds = program.variable_scale[which], (program.lower[which], program.upper[which])
    for step in _BLIND_STEPS:
        places = [np.clip(point[which] + sign * step * size, *bounds) for sign in (1, -1)]
        first, second = (np.abs(place - point[which]) for place in places)
        moved = point.copy()
        moved[which] = np.where(first >= second, *places)
        yield program.evaluate(moved)


def _changes_blindly(here: Evaluation, there: Evaluation, which: np.ndarray) -> bool:
    """Whether the objective differs, although its slopes by what moved are zero at both ends."""
    size = max(abs(here.objective), abs(there.objective))
    differs = np.isfinite(there.objective) and abs(there.objective - here.objective) > _SAME * size
    return bool(differs and not there.gradient[which].any())


# A variable has moved if it differs by more than this part of its typical magnitude.
_STILL = 1e-9
# Distances of the points checked near the answer, in typical magnitudes, and further ones if nothing changes there.
_BESIDE, _BEYOND = (-0.05, 0.05), (-3.0, -1.0, 1.0, 3.0)
# A decrease by less than this part of the terms is rounding, or negligible curvature.
_LOWER = 1e-7
# How often an answer is left for a better one at most.
_MOST_MOVES = 8


class _Probe(NamedTuple):
    """A point near the answer, with one variable moved, and its evaluation."""

    point: np.ndarray
    found: Evaluation


def moved_on(
    program: NonlinearProgram, outcome: Outcome, start: np.ndarray, again: Callable[[np.ndarray], Outcome]
) -> Outcome:
    """The outcome, or a better one if it is no minimum with respect to variables that never moved.

    - `start`: the start of the outcome, shape (n,); `again`: solves from another start.

    The result's `idle` lists variables that change nothing, `blind` those that change something although its
    derivatives by them are zero.
    """
    for _ in range(_MOST_MOVES):
        if outcome.status is not Status.SOLVED:
            break
        outcome, lower = _examined(program, outcome, start)
        if lower is None:
            break
        before, outcome = outcome, _better(outcome, again(lower))
        if np.array_equal(before.point, outcome.point):
            break
    return _with_lost(program, outcome)


def _with_lost(program: NonlinearProgram, outcome: Outcome) -> Outcome:
    """The outcome, where also variables are blind by which the objective alone changes without a slope."""
    if outcome.status is not Status.SOLVED:
        return outcome
    lost = lost_variables(program, outcome.point, outcome.evaluation)
    return replace(outcome, blind=tuple(sorted({*outcome.blind, *lost})))


def _examined(program: NonlinearProgram, outcome: Outcome, start: np.ndarray) -> tuple[Outcome, np.ndarray | None]:
    """The outcome with its idle and blind variables, and a point from which to descend further, if any."""
    still = _still(program, outcome, start)[:_MOST]
    if not still.size:
        return replace(outcome, blind=(), idle=()), None
    steps = tangents(*_acting(program, outcome), program.variable_scale, still)
    probes = {int(one): _probes(program, outcome, int(one), step) for one, step in zip(still, steps, strict=True)}
    flat = [one for one in probes if _is_flat(outcome.evaluation, one)]
    changing = [one for one in flat if any(_differs(outcome.evaluation, each.found) for each in probes[one])]
    blind = tuple(one for one in changing if all(_is_flat(each.found, one) for each in probes[one]))
    idle = tuple(one for one in flat if one not in changing)
    outcome = replace(outcome, blind=blind, idle=idle)
    return outcome, None if blind else _lower(program, outcome, probes)


def _lower(program: NonlinearProgram, outcome: Outcome, probes: dict[int, list[_Probe]]) -> np.ndarray | None:
    """A point that lowers the Lagrangian: by all variables that lower it alone, if together they lower it further."""
    value, terms = _lagrangian(outcome, outcome.evaluation)

    def height(one: _Probe) -> float:
        return _lagrangian(outcome, one.found)[0]

    best = {which: min(several, key=height) for which, several in probes.items() if several}
    lower = {which: one for which, one in best.items() if height(one) < value - _LOWER * terms}
    if not lower:
        return None
    alone = min(lower.values(), key=height)
    steps = sum((one.point - outcome.point for one in lower.values()), np.zeros_like(outcome.point))
    point = np.clip(outcome.point + steps, program.lower, program.upper)
    together = _Probe(point, program.evaluate(point))
    # Not a number is not lower.
    return together.point if height(together) < height(alone) else alone.point


def _still(program: NonlinearProgram, outcome: Outcome, start: np.ndarray) -> np.ndarray:
    """The free variables that no descent has moved and that are not held by an active bound, or alone by a row."""
    still = np.abs(outcome.point - start) <= _STILL * program.variable_scale
    if outcome.searched is not None:
        still |= np.array([_is_flat(outcome.evaluation, one) for one in range(len(start))])
    still &= ~_is_bound(program, outcome)
    equal = program.constraint_lower == program.constraint_upper
    return np.flatnonzero(still & ~alone_in_a_row(outcome.evaluation.jacobian[np.flatnonzero(equal)]))


def _is_bound(program: NonlinearProgram, outcome: Outcome) -> np.ndarray:
    """Whether a variable is fixed, or presses against a bound."""
    pulls = np.abs(outcome.bound_multipliers) * program.variable_scale
    return (program.lower == program.upper) | (pulls > _LOWER * _terms(program, outcome))


def _acting(program: NonlinearProgram, outcome: Outcome) -> tuple[Matrix, np.ndarray]:
    """The rows that equations and pressing limits hold, and whether a variable is held."""
    equal = program.constraint_lower == program.constraint_upper
    presses = np.abs(outcome.multipliers) * outcome.sizes > _LOWER * _terms(program, outcome)
    return outcome.evaluation.jacobian[np.flatnonzero(equal | presses)], _is_bound(program, outcome)


def _terms(program: NonlinearProgram, outcome: Outcome) -> float:
    """The objective, or its change over a typical magnitude of a variable, whichever is larger."""
    evaluation = outcome.evaluation
    changes = np.abs(evaluation.gradient) * program.variable_scale
    return max(abs(evaluation.objective), float(np.max(changes, initial=0.0)))


def _probes(program: NonlinearProgram, outcome: Outcome, which: int, step: np.ndarray) -> list[_Probe]:
    """Points a part of a step away and, if all derivatives by the variable are zero, in its whole range."""
    here = outcome.point
    points = [np.clip(here + part * step, program.lower, program.upper) for part in _BESIDE]
    if _is_flat(outcome.evaluation, which):
        is_moved = np.arange(here.size) == which
        points += [np.where(is_moved, place, here) for place in _range(program, here, which)]
    found = []
    for point in points:
        evaluation = None if np.array_equal(point, here) else program.evaluate(point)
        if evaluation and np.isfinite(evaluation.objective) and np.isfinite(evaluation.constraints).all():
            found.append(_Probe(point, evaluation))
    return found


def _range(program: NonlinearProgram, here: np.ndarray, which: int) -> list[float]:
    """Places all over the range of a variable."""
    lower, upper = program.lower[which], program.upper[which]
    places = {float(np.clip(here[which] + step * program.variable_scale[which], lower, upper)) for step in _BEYOND}
    if np.isfinite(lower) and np.isfinite(upper):
        places |= set(np.linspace(lower, upper, 5).tolist())
    return sorted(places)


def _is_flat(evaluation: Evaluation, which: int) -> bool:
    return evaluation.gradient[which] == 0 and column_is_zero(evaluation.jacobian, which)


def _differs(one: Evaluation, other: Evaluation) -> bool:
    first, second = (np.append(each.constraints, each.objective) for each in (one, other))
    return bool(np.any(np.abs(first - second) > _SAME * np.maximum(np.abs(first), np.abs(second))))


def _lagrangian(outcome: Outcome, evaluation: Evaluation) -> tuple[float, float]:
    """The Lagrangian at a point, with the multipliers of the answer, and the size of the terms that it consists of."""
    terms = outcome.multipliers * (evaluation.constraints - outcome.evaluation.constraints)
    return evaluation.objective + float(terms.sum()), abs(evaluation.objective) + float(np.abs(terms).sum())


def _better(before: Outcome, after: Outcome) -> Outcome:
    """The later outcome if it is solved and lower, with the effort of both."""
    gain = before.evaluation.objective - after.evaluation.objective
    lower = after.status is Status.SOLVED and gain > _LOWER * abs(before.evaluation.objective)
    interrupted = after.status is Status.INTERRUPTED
    return after.with_effort_of(before) if lower or interrupted else before.with_effort_of(after)
