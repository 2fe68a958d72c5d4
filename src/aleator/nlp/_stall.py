"""Why a solver got stuck: whether objective and constraints change as their derivatives say."""

import itertools

import numpy as np

from aleator.nlp._certificate import lagrangian_gradient
from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._scales import Multipliers
from aleator.nlp._scaling import ScaledProgram

# Lengths of the probing steps, in typical magnitudes of the variables.
_STEPS = (1e-3, 1e-5, 1e-7)
# A change below this many rounding errors cannot be distinguished from none.
_ROUNDINGS = 1e3
# The error of a first-order prediction falls with the square of the step. Below the first of these powers the function
# is not differentiable; below the second it jumps.
_SMOOTH, _JUMP = 1.5, 0.5
_EXCLUDE = "Exclude those points by the bounds of the decisions"


def stall(scaled: ScaledProgram, z: np.ndarray, multipliers: Multipliers) -> tuple[str, str]:
    """Why a solver may have got stuck at a point, in words that follow a colon, and the remedy; empty if unknown.

    The Lagrangian is evaluated along its own steepest descent, over steps of different lengths. If it is smooth, the
    error of the first-order prediction falls with the square of the step; at a kink it falls with the step, at a jump
    not at all. The result does not depend on the solver.
    """
    start = scaled.evaluate(z)
    remainder = lagrangian_gradient(start, multipliers)
    largest = float(np.abs(remainder).max(initial=0.0))
    if largest == 0:
        return "", ""
    typical = max(1.0, float(np.abs(z).max()))
    rounding = _ROUNDINGS * np.finfo(float).eps * scaled.terms(start, multipliers)
    missed: list[tuple[float, float]] = []
    seen = False
    for step in _STEPS:
        moved = np.clip(z - step * typical * remainder / largest, scaled.lower, scaled.upper)
        try:
            there = scaled.evaluate(moved)
        except NotFiniteError:
            return "the model is not finite close by, where it would be less", _EXCLUDE
        predicted = float(remainder @ (moved - z))
        seen = seen or abs(predicted) > rounding
        rows = float(multipliers.rows @ (there.constraints - start.constraints))
        actual = there.objective - start.objective + rows + float(multipliers.bounds @ (moved - z))
        error = abs(actual - predicted)
        if error > max(rounding, abs(predicted) / 2):
            missed.append((step, error))
    if not seen:
        why = "the possible gain is below the rounding of the objective, so that no further progress is possible here"
        return why, "Accept it by a larger tolerance of the solver"
    if len(missed) < 2:
        return "", ""
    power = min(
        np.log(error / finer) / np.log(step / smaller) for (step, error), (smaller, finer) in itertools.pairwise(missed)
    )
    if power > _SMOOTH:
        return "", ""
    what = "jumps" if power < _JUMP else "has a kink"
    why = (
        f"the objective or an active constraint {what} close by, so that it does not change as its derivative "
        "predicts, and no derivative-based solver gets further"
    )
    remedy = "Make it smooth there (al.examine names it), or replace a largest or absolute value by limits on its parts"
    return why, remedy
