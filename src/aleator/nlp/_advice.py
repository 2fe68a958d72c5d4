"""Why a point is no solution, and what to do, in words."""

import numpy as np

from aleator.nlp._answer import Verdict
from aleator.nlp._outcome import Status
from aleator.nlp._scaling import ScaledProgram
from aleator.nlp._stall import stall

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
    known, remedy = stall(scaled, verdict.point, verdict.multipliers)
    return f"stationarity is {residual:.1e}, where {tolerance:.0e} is asked{known and ': '}{known}", remedy
