"""What a solver claims of its answer, what is reported of it, and why it is no solution."""

from typing import NamedTuple

import numpy as np

from aleator.nlp._certificate import Certificate
from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._program import Evaluation, NonlinearProgram
from aleator.nlp._scaling import Multipliers, ScaledProgram
from aleator.nlp._slopes import slopes_at
from aleator.nlp._solver import Status


class Answer(NamedTuple):
    """What a solver claims, in scaled quantities.

    - `claim`: the status that the solver claims;
    - `point`: shape (n_free,);
    - `multipliers`: None if the solver gives none;
    - `iterations`: its count;
    - `message`: its message;
    - `unfinished`: why a point that meets the first-order conditions may be no answer, in words; left empty by solvers;
    - `is_doubtful`: whether no point shows that, so that this one is judged by first-order conditions after all.
    """

    claim: Status
    point: np.ndarray
    multipliers: Multipliers | None = None
    iterations: int = 0
    message: str = ""
    unfinished: str = ""
    is_doubtful: bool = False


class Verdict(NamedTuple):
    """The result to report: a point with its evaluation in user units, scaled multipliers and their certificate.

    `strayed`: see `Outcome`.
    """

    status: Status
    point: np.ndarray
    user: Evaluation
    multipliers: Multipliers
    certificate: Certificate
    message: str
    strayed: bool = False


HELD = 1e-6
"""A constraint holds if it exceeds its bound by at most this part of its size: the magnitude of the bound and of the
values around the answer."""

# A variable without a bound that is so many typical magnitudes away from zero may have no optimum.
_FAR = 100.0
# One that is so many away has none: beside such magnitudes every slope and every violation is nothing.
LOST = 1e12
# What to do where nothing more is known.
_REMEDIES = {
    Status.EVALUATION_FAILED: (
        "Stuck next to points where the model is not finite: exclude these by the bounds of the decisions"
    ),
    Status.INFEASIBLE: (
        "Relax a limit (al.conflict names those that cannot hold together), widen the bounds of the decisions, or try "
        "other starts with al.multistart"
    ),
    Status.ITERATION_LIMIT: (
        "Allow the solver more iterations, by its max_iterations, start closer to the solution, or see what "
        "al.examine tells of scales and derivatives"
    ),
    Status.FAILED: (
        "See what al.examine tells of scales and derivatives, try another solver (al.solvers.FilterSQP, Ipopt or "
        "Slsqp), or other starts with al.multistart"
    ),
}

STRAYED = (
    "The constraints hold at this design, which the search saw on its way, but it ended where they do not and no small "
    "step returns: they seem to jump. See what al.examine tells of jumps and make these smooth, search by values alone "
    "with al.solvers.DifferentialEvolution, or try other starts with al.multistart"
)
"""What to tell of a search that ended where the constraints do not hold, although it had seen a point where they do."""


def held(tolerance: float) -> float:
    """The largest violation of a constraint that holds, over its size."""
    return min(HELD, tolerance)


def advice(scaled: ScaledProgram, verdict: Verdict, unfinished: str, tolerance: float) -> str:
    """Why a point is no solution and what to do, in words; empty for a solution."""
    if verdict.status not in _REMEDIES:
        return ""
    if verdict.status not in (Status.ITERATION_LIMIT, Status.FAILED):
        return _REMEDIES[verdict.status]
    if unfinished:
        return f"{unfinished}. Lower the largest weights of the objective, or start elsewhere"
    reason, remedy = _reason(scaled, verdict, tolerance)
    if not remedy and has_run_away(scaled, verdict.point):
        reason += ", and decisions are far out on a side without a bound, where there may be no optimum"
        remedy = "Give all decisions bounds, or allow the solver more iterations, by its max_iterations"
    return f"{reason}. {remedy or _REMEDIES[verdict.status]}"


def has_run_away(scaled: ScaledProgram, z: np.ndarray, far: float = _FAR) -> bool:
    """Whether a variable is more typical magnitudes away from zero than `far`, on a side on which it has no bound."""
    open_ended = np.where(z > 0, np.isposinf(scaled.upper), np.isneginf(scaled.lower))
    return bool(np.any(open_ended & (np.abs(z) > far)))


def _reason(scaled: ScaledProgram, verdict: Verdict, tolerance: float) -> tuple[str, str]:
    """Why a point is no solution: the condition that is not met with, if known, the reason; and the remedy for that."""
    certificate = verdict.certificate
    if certificate.violation > held(tolerance):
        return (
            f"a constraint is missed by {certificate.violation:.1e} of its size, where {held(tolerance):.0e} is "
            "asked, although small steps would still reduce it"
        ), ""
    residual = max(certificate.stationarity, certificate.complementarity)
    known, remedy = _stall(scaled, verdict.point, verdict.multipliers)
    return f"stationarity is {residual:.1e}, where {tolerance:.0e} is asked{known and ': '}{known}", remedy


# A possible gain, over the longest of the steps that tell slopes, is seen if it is above so many rounding errors.
_LONGEST, _ROUNDINGS = 1e-3, 1e3


def _stall(scaled: ScaledProgram, z: np.ndarray, multipliers: Multipliers) -> tuple[str, str]:
    """Why a solver may have got stuck at a point, in words that follow a colon, and the remedy; empty if unknown.

    The slopes of the Lagrangian are looked at along its own steepest descent. The result does not depend on the solver.
    """
    here = scaled.evaluate(z)
    remainder = multipliers.slope(here)
    direction = -max(1.0, float(np.abs(z).max())) * remainder / (float(np.abs(remainder).max()) or 1.0)
    ends = np.where(direction > 0, scaled.upper, scaled.lower) - z
    direction[np.abs(ends) <= _LONGEST * np.abs(direction)] = 0.0
    terms = scaled.terms(here, multipliers)
    if not direction.any():
        return "", ""
    if _LONGEST * abs(float(remainder @ direction)) <= _ROUNDINGS * np.finfo(float).eps * terms:
        why = "the possible gain is below the rounding of the objective, so that no further progress is possible here"
        return why, "Accept it by a larger tolerance of the solver"
    is_finite = True

    def along(step: np.ndarray) -> Evaluation:
        nonlocal is_finite
        try:
            there = scaled.evaluate(np.clip(z + step * direction, scaled.lower, scaled.upper))
        except NotFiniteError:
            is_finite = is_finite and not 0 < step[0] <= _LONGEST
            return Evaluation(np.nan, np.full(1, np.nan), np.zeros(0), np.zeros((0, 1)))
        change = there.objective - here.objective + float(multipliers.rows @ (there.constraints - here.constraints))
        change += float(multipliers.bounds @ direction) * step[0]
        return Evaluation(terms + change, multipliers.slope(there)[None] @ direction, np.zeros(0), np.zeros((0, 1)))

    start, nothing = np.zeros(1), np.zeros(0)
    line = NonlinearProgram(along, start, start - np.inf, start + np.inf, nothing, nothing, nothing, start + 1)
    slopes = slopes_at(line, start)
    if not is_finite:
        return (
            "the model is not finite close by, where it would be less"
        ), "Exclude those points by the bounds of the decisions"
    if not np.any(slopes.kinks | slopes.jumps | slopes.wrong):
        return "", ""
    what = "jumps" if slopes.jumps.any() else "has a kink"
    why = (
        f"the objective or an active constraint {what} close by, so that it does not change as its derivative "
        "predicts, and no derivative-based solver gets further"
    )
    remedy = "Make it smooth there (al.examine names it), or replace a largest or absolute value by limits on its parts"
    return why, remedy
