"""Where to search next: beside an answer that may be a maximum or a saddle, and elsewhere where nothing feasible was
found. And the variables that a model does not depend on, or only without a slope.

First-order conditions hold at maxima, at saddles, and wherever a model is flat. Solvers descend, so that they end there
only if a symmetry keeps them there: directions along which nothing has moved are checked, those of variables that have
stayed, and of differences of variables that have moved by as much. A search by values may end anywhere that is flat, so
that all flat variables of its answer are checked.

Where a solver proves that no small step meets all constraints there may still be a feasible point elsewhere: if a model
saturates, or if a variable must change by many orders of magnitude from a poor start.
"""

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from aleator.nlp._curvature import descent
from aleator.nlp._program import Evaluation, NonlinearProgram
from aleator.nlp._scaling import MOST_DIFFERENCED, Multipliers, ScaledProgram, Scales
from aleator.nlp._solver import Outcome, Status
from aleator.nlp._verdict import HELD

# At most this many variables are checked, and named: the first ones.
_MOST = 12
# A variable has moved if it differs by more than this part of its typical magnitude.
_STILL = 1e-9
# A decrease by less than this part of the objective is rounding, or negligible.
_LOWER = 1e-7
# Values that differ by less than this part count as equal.
_SAME = 1e-12
# Where a flat variable is moved to, in typical magnitudes; parts of its range; and sets of random sides of several.
_ACROSS, _PARTS, _TOGETHER = (-1.0, -0.05, 0.05, 1.0), (0.0, 0.25, 0.5, 0.75, 1.0), 3
# Steps in typical magnitudes of all suspects together, and then of each alone: a short one, so that the model is likely
# to be finite, and a long one, across a coarse rounding.
_BLIND_STEPS = (0.05, -0.4)
# How many points in the whole range of the variables are evaluated, and how far from the start an unbounded range
# extends, in typical magnitudes.
_POINTS, _FAR = 8, 3.0
UNBOUNDED = 1e15
"""Bounds that are so many typical magnitudes, or units, away stand for none."""
# A violation is lower if it is so by more than this part.
_LESS = 1e-2


class Restart(NamedTuple):
    """What was found around an outcome, and from where to search next.

    - `program`, `start`: the program to be solved from `start`, shape (n,), which is None if there is no reason to;
    - `holds`: whether all constraints hold there, though the outcome says that they cannot;
    - `idle`, `blind`: variables that change nothing, and those by which values change without a slope.
    """

    program: NonlinearProgram
    start: np.ndarray | None = None
    holds: bool = False
    idle: tuple[int, ...] = ()
    blind: tuple[int, ...] = ()

    def is_better(self, outcome: Outcome, further: Outcome) -> bool:
        """Whether the outcome from this start takes the place of the outcome before."""
        if further.status is Status.INTERRUPTED:
            return True
        gain = outcome.evaluation.objective - further.evaluation.objective
        if outcome.status is Status.SOLVED:
            return further.status is Status.SOLVED and gain > _LOWER * abs(outcome.evaluation.objective)
        if further.status is Status.SOLVED:
            return True
        if outcome.strayed:
            return further.violation <= HELD and gain > 0
        return self.holds and further.status is not Status.INFEASIBLE


def restart_of(program: NonlinearProgram, outcome: Outcome, begun: np.ndarray) -> Restart:
    """Where to search next after an outcome of a search that began at `begun`, shape (n,).

    From a solved one: where the Lagrangian is lower nearby, in variables that never moved. From one that is infeasible:
    from the least violated of some points elsewhere, if it violates less, with variables scaled by their values there.
    A search that strayed from points that meet all constraints starts from the best of these.
    """
    if outcome.status is Status.SOLVED:
        return _around(program, outcome, begun)
    if outcome.strayed:
        start, violation = outcome.point, 0.0
    elif outcome.status is Status.INFEASIBLE:
        # The corners of least and of greatest values, the middle between them, and points in the whole range.
        lower, upper = variable_range(begun, program.lower, program.upper, program.variable_scale)
        drawn = np.random.default_rng(0).uniform(lower, upper, (_POINTS, len(begun)))
        points = [begun, program.start, lower, upper, (lower + upper) / 2, *drawn]
        rows = np.array([program.evaluate(point).constraints for point in points])
        violations = np.max(program.limits.excess(rows) / outcome.sizes, axis=1, initial=0.0)
        violations[~np.isfinite(rows).all(axis=1)] = np.inf
        start, violation = points[np.argmin(violations)], violations.min()
        if not violation < (1 - _LESS) * outcome.violation:
            return Restart(program)
    else:
        return Restart(program)
    scale = np.max(np.abs([program.variable_scale, outcome.point, start]), axis=0)
    return Restart(replace(program, variable_scale=scale), start, holds=bool(violation <= HELD))


def variable_range(
    start: np.ndarray, lower: np.ndarray, upper: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The least and greatest values of the variables, or three typical magnitudes from the start if unbounded."""
    far, bounded = _FAR * scale, UNBOUNDED * np.maximum(scale, 1.0)
    return np.where(lower > -bounded, lower, start - far), np.where(upper < bounded, upper, start + far)


# --- Beside an answer -------------------------------------------------------------------------------------------------


def _around(program: NonlinearProgram, outcome: Outcome, begun: np.ndarray) -> Restart:
    here, point = outcome.evaluation, outcome.point
    flat, is_least = _is_flat(here), program.is_least(here.objective, _LOWER)
    still = np.abs(point - begun) <= _STILL * program.variable_scale
    if outcome.searched is not None:
        still |= flat
    still &= program.lower < program.upper
    places = np.flatnonzero(still & flat)[:_MOST]

    def height(there: Evaluation) -> float:
        """The Lagrangian with the multipliers of the outcome, beside which it is the objective."""
        return there.objective + float(outcome.multipliers @ (there.constraints - here.constraints))

    def lower_of(others: list[tuple[np.ndarray, Evaluation]]) -> list[np.ndarray]:
        most = -np.inf if is_least else here.objective - _LOWER * abs(here.objective)
        return [point for point, there in others if height(there) < most]

    idle, blind = [], []
    lower = [] if is_least else _descended(program, outcome, _unmoved(program, point - begun, still))
    for i in places.tolist():
        others = _across(program, point, np.arange(point.size) == i)
        if not any(_differs(here, there) for _, there in others):
            idle.append(i)
        elif all(_is_flat(there)[i] for _, there in others):
            blind.append(i)
        else:
            lower += lower_of(others)
    if len(places) > 1 and not lower:
        # Of a product of three numbers that begin at zero, all slopes of all slopes are zero too.
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (_TOGETHER, places.size))
        for side in (np.ones(places.size), *signs):
            sides = np.zeros(point.size)
            sides[places] = side
            lower += lower_of(_across(program, point, sides))
    if lower and not blind:
        start = min(lower, key=lambda point: height(program.evaluate(point)))
        return Restart(program, start, idle=tuple(idle))
    lost = lost_variables(program, point, here)
    return Restart(program, idle=tuple(idle), blind=tuple(sorted({*blind, *lost})))


def _unmoved(
    program: NonlinearProgram, moved: np.ndarray, still: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "n directions"]:
    """Directions along which a search has moved nothing: the first variables that are `still`, and sums or differences
    of those that have moved by as much, unless there are many variables: a symmetry keeps them together.
    """
    single = 1.0 * (np.arange(moved.size) == np.flatnonzero(still)[:MOST_DIFFERENCED, None])
    if moved.size > MOST_DIFFERENCED:
        return single.T
    lengths = np.abs(moved) / program.variable_scale
    others = np.flatnonzero(~still & (lengths > _STILL))
    others = others[np.argsort(lengths[others])]
    sides = np.eye(moved.size) * np.sign(moved)
    together = [
        sides[i] - sides[j]
        for i, j in itertools.pairwise(others.tolist())
        if lengths[j] - lengths[i] <= _STILL * max(1.0, lengths[j])
    ]
    return np.array([*single, *together]).reshape(-1, moved.size).T


def _descended(
    program: NonlinearProgram, outcome: Outcome, unmoved: Float[np.ndarray, "n directions"]
) -> list[np.ndarray]:
    """A lower point along directions in which this may be a maximum or a saddle, if there is one."""
    if not unmoved.size:
        return []
    scaled = ScaledProgram(program, outcome.point)
    z, free = scaled.start, program.lower < program.upper
    changes = np.abs(outcome.evaluation.gradient) * program.variable_scale
    objective = max(abs(outcome.evaluation.objective), float(changes.max())) or 1.0
    scaled.rescale(z, Scales(objective, outcome.sizes[scaled.useful]))
    bounds = (outcome.bound_multipliers * program.variable_scale)[free] / objective
    further = descent(scaled, z, Multipliers(scaled.to_scaled(outcome.multipliers), bounds), unmoved[free])
    return [] if further is None else [scaled.unscaled(further.point)]


def _is_flat(there: Evaluation) -> np.ndarray:
    """By which variables all slopes are zero, shape (n,)."""
    return (there.gradient == 0) & (abs(there.jacobian).sum(axis=0) == 0)


def _differs(one: Evaluation, other: Evaluation) -> bool:
    first, second = (np.append(each.constraints, each.objective) for each in (one, other))
    return bool(np.any(np.abs(first - second) > _SAME * np.maximum(np.abs(first), np.abs(second))))


def _across(program: NonlinearProgram, here: np.ndarray, sides: np.ndarray) -> list[tuple[np.ndarray, Evaluation]]:
    """Points at which the program is finite with some variables moved, each to its side: a little, much, and all over
    their ranges.
    """
    lower, upper = variable_range(here, program.lower, program.upper, program.variable_scale)
    moved = [here + step * sides * program.variable_scale for step in _ACROSS]
    moved += [np.where(sides > 0, lower + part * (upper - lower), upper - part * (upper - lower)) for part in _PARTS]
    points = [np.clip(np.where(sides == 0, here, one), program.lower, program.upper) for one in moved]
    every = [(point, program.evaluate(point)) for point in points if np.any(point != here)]
    return [(point, there) for point, there in every if np.isfinite([there.objective, *there.constraints]).all()]


def lost_variables(program: NonlinearProgram, point: np.ndarray, here: Evaluation) -> tuple[int, ...]:
    """Variables by which the slope of the objective is zero at a point and wherever else it is tried, although it
    changes with them.

    Two evaluations if some slope is exactly zero, two more for each of several suspects if the objective changes. In
    sparse programs, where an objective depends on few variables by construction, none is looked for.
    """

    def are_lost(which: list[int]) -> bool:
        for step in _BLIND_STEPS:
            # Away from a bound that is too close.
            ends = [point[which] + sign * step * program.variable_scale[which] for sign in (1, -1)]
            first, second = (np.clip(end, program.lower[which], program.upper[which]) for end in ends)
            moved = point.copy()
            moved[which] = np.where(np.abs(first - point[which]) >= np.abs(second - point[which]), first, second)
            there = program.evaluate(moved)
            change, size = abs(there.objective - here.objective), max(abs(here.objective), abs(there.objective))
            if change > _SAME * size and np.isfinite(change) and not there.gradient[which].any():
                return True
        return False

    flat = np.flatnonzero((here.gradient == 0) & (program.lower < program.upper)).tolist()
    if not flat or not isinstance(here.jacobian, np.ndarray) or not np.isfinite(here.objective) or not are_lost(flat):
        return ()
    return tuple(i for i in flat[:_MOST] if len(flat) == 1 or are_lost([i]))
