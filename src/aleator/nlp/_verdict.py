"""What a solver claims of its answer, and the verdict on that: from the conditions at its point, with the reason."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from aleator.nlp._certificate import (
    Certificate,
    certify,
    complementary,
    fit_multipliers,
    is_least_violated,
    kinks_at,
)
from aleator.nlp._curvature import descent
from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import Multipliers, ScaledProgram, Scales
from aleator.nlp._slopes import line_of, slopes_at
from aleator.nlp._solver import Status

HELD = 1e-6
"""A constraint holds if it exceeds its bound by at most this part of its size: the magnitude of the bound and of the
values around the answer."""
# A slope by which nothing would change, over a typical magnitude, by more than so many rounding errors is none.
_FLAT = 8.0
# Rows of a sparse program whose multipliers are fitted where a solver's own do not certify it: of thousands of
# equalities that takes too long.
_MOST_FITTED = 2000
# How often an answer is left for a lower point close by before the solver is asked again.
_MOST_MOVES = 4


class Answer(NamedTuple):
    """What a solver claims, in scaled quantities.

    - `claim`: the status that the solver claims;
    - `point`: shape (n_free,);
    - `multipliers`: None if the solver gives none;
    - `iterations`: its count;
    - `message`: its message;
    - `unfinished`: why a point that meets the first-order conditions may be no answer, in words; left empty by solvers.
    """

    claim: Status
    point: np.ndarray
    multipliers: Multipliers | None = None
    iterations: int = 0
    message: str = ""
    unfinished: str = ""


class Verdict(NamedTuple):
    """An answer, whose claim is true in the end, its evaluation in user units, multipliers and their certificate.

    - `reason`: why the answer is no solution, and what to do; empty where nothing is known;
    - `strayed`: see `Outcome`.
    """

    answer: Answer
    user: Evaluation
    multipliers: Multipliers
    certificate: Certificate
    reason: str = ""
    strayed: bool = False


def settle(scaled: ScaledProgram, answer: Answer, tolerance: float) -> tuple[Answer, bool]:
    """Scale objective and constraints by their values at the answer, and say whether the answer is final in that scale:
    solved, infeasible, or no point to continue from.

    The start may be so steep that every slope near the answer is negligible compared with it. So the answer is judged
    by the terms that cancel in the gradient of its Lagrangian. If these are no larger than the remainder (at an optimum
    inside all bounds they vanish), it is judged by the change of that gradient over a typical magnitude of the
    variables, which takes one more evaluation close by. Neither depends on the start or on an offset.
    """
    if answer.claim in (Status.EVALUATION_FAILED, Status.INTERRUPTED):
        return answer, True
    moves = 0
    while True:
        user = scaled.user(answer.point)
        # Infeasibility is proven in the scales in which the solver ran: the weights of the violations in the sum that
        # no step lowers do not matter.
        is_outside = np.any(scaled.outside(user) > _held(tolerance) * scaled.sizes_at(answer.point, user))
        if is_outside and _is_least_violated(scaled, answer):
            answer = answer._replace(claim=Status.INFEASIBLE)
        elif answer.claim is Status.INFEASIBLE:
            answer = answer._replace(claim=Status.FAILED)
        verdict = _at(scaled, answer, user, tolerance)
        if verdict.certificate.violation <= _held(tolerance):
            if not verdict.certificate.within(np.inf, tolerance) and kinks_at(scaled, answer.point):
                return verdict.answer, True  # Slopes change at once there, so that their changes are no scale.
            size = _size_of_gradient(scaled, verdict, tolerance)
            verdict = _at(scaled, verdict.answer, user, tolerance, size)
        answer, status = verdict.answer, _status(scaled, verdict, tolerance)
        if status is not Status.SOLVED or verdict.user is not user:
            return answer, status in (Status.SOLVED, Status.INFEASIBLE)
        kept = complementary(scaled, answer.point, scaled.evaluate(answer.point), verdict.multipliers, tolerance)
        further = descent(scaled, answer.point, kept)
        if further is None:
            return answer, True
        if not further.holds or moves == _MOST_MOVES:
            break
        answer, moves = answer._replace(point=further.point), moves + 1
    said = (
        "it is on the floor of a steep valley, or beside larger slopes, and the objective would fall by about "
        f"{further.fall:.2g}"
    )
    # The next round needs a scale in which this slope is not small.
    scales = scaled.scales._replace(objective=scaled.scales.objective * further.slope)
    return _rescaled(scaled, answer._replace(unfinished=said), scales), False


def judge(scaled: ScaledProgram, answer: Answer, tolerance: float) -> Verdict:
    """Judge `answer`, which `settle` has processed. Scales are the sizes at the verdict's point from now on."""
    if scaled.best is None:
        unknown = Certificate(np.nan, np.nan, np.nan)
        return Verdict(answer, scaled.evaluations.last, scaled.no_multipliers, unknown)
    if scaled.evaluations.halt is not None or answer.claim is Status.INTERRUPTED:
        return _at_best(scaled, answer, tolerance)
    user = scaled.user(answer.point)
    if not user.is_finite:
        return _at_best(scaled, answer._replace(claim=Status.EVALUATION_FAILED), tolerance)
    verdict = _at(scaled, answer, user, tolerance)
    status = _status(scaled, verdict, tolerance)
    if status is Status.FAILED and scaled.evaluations.failed_recently:
        # A solver that gives up next to points that cannot be evaluated is presumed to do so because of them.
        status = Status.EVALUATION_FAILED
    verdict = verdict._replace(answer=verdict.answer._replace(claim=status))
    if status is Status.INFEASIBLE:
        frame = scaled.scales
        least = _at_best(scaled, verdict.answer, tolerance)
        # Where the terms of a constraint are large, its own size alone would let pass what is seen elsewhere.
        sizes = np.minimum(frame.constraints, scaled.scales.constraints)
        if np.all(scaled.outside(least.user) <= _held(tolerance) * sizes):
            failed = least.answer._replace(claim=Status.FAILED)
            return least._replace(answer=failed, reason=_STRAYED, strayed=True)
        if least.certificate.violation > _held(tolerance):
            verdict = least
        else:
            scaled.rescale(verdict.answer.point, frame)
    return verdict._replace(reason=_advice(scaled, verdict, tolerance))


def _held(tolerance: float) -> float:
    """The largest violation of a constraint that holds, over its size."""
    return min(HELD, tolerance)


def _status(scaled: ScaledProgram, verdict: Verdict, tolerance: float) -> Status:
    answer, certificate = verdict.answer, verdict.certificate
    if not has_run_away(scaled, answer.point, LOST):
        if certificate.within(_held(tolerance), tolerance):
            return Status.FAILED if answer.unfinished else Status.SOLVED
        infeasible = certificate.violation > _held(tolerance)
        if infeasible and (answer.claim is Status.INFEASIBLE or _is_least_violated(scaled, answer)):
            return Status.INFEASIBLE
    if answer.claim in (Status.ITERATION_LIMIT, Status.EVALUATION_FAILED):
        return answer.claim
    return Status.FAILED


def _is_least_violated(scaled: ScaledProgram, answer: Answer) -> bool:
    # A solver without iterations left was on its way.
    return answer.claim is not Status.ITERATION_LIMIT and is_least_violated(scaled, answer.point)


def _rescaled(scaled: ScaledProgram, answer: Answer, scales: Scales) -> Answer:
    before = scaled.scales
    scaled.rescale(answer.point, scales)
    return answer._replace(multipliers=before.converted(answer.multipliers, scales))


def _at_best(scaled: ScaledProgram, answer: Answer, tolerance: float) -> Verdict:
    """The answer's claim at the best point seen."""
    assert scaled.best is not None
    point, user = scaled.best
    return _at(scaled, answer._replace(point=point, multipliers=None), user, tolerance)


def _at(scaled: ScaledProgram, answer: Answer, user: Evaluation, tolerance: float, size: float = 1.0) -> Verdict:
    """The answer's claim at its point, with the multipliers of the smallest residuals: in the constraints' sizes there
    as scales, which `scaled` has from now on, and that of the objective times a size.
    """
    sizes = scaled.sizes_at(answer.point, user)
    answer = _rescaled(scaled, answer, Scales(scaled.scales.objective * size, sizes))
    z, evaluation, own, none = answer.point, scaled.scale(user), answer.multipliers, scaled.no_multipliers
    known = [] if own is None else [(certify(scaled, z, evaluation, own), own)]
    if not known or not known[0][0].within(np.inf, tolerance):
        # An objective may be flat at its minimum: multipliers would be nothing but rounding.
        flat = certify(scaled, z, evaluation, none)
        known.append((flat, none))
        if own is None or isinstance(scaled.sparsity, np.ndarray) or scaled.rows <= _MOST_FITTED:
            fitted = fit_multipliers(scaled, z, evaluation)
            least = Certificate(flat.violation, scaled.above_least(user), 0.0)
            known += [(certify(scaled, z, evaluation, fitted), fitted), (least, none)]
    certificate, multipliers = min(known, key=lambda pair: max(pair[0].stationarity, pair[0].complementarity))
    if certificate.violation <= _held(tolerance) and not certificate.within(np.inf, tolerance):
        kinks = kinks_at(scaled, z)
        if kinks is not None:
            evaluation = scaled.scale(kinks.evaluation)
            fitted = fit_multipliers(scaled, z, evaluation)
            if (mixed := certify(scaled, z, evaluation, fitted)).within(np.inf, tolerance):
                user, certificate, multipliers = kinks.evaluation, mixed, fitted
    return Verdict(answer, user, multipliers, certificate)


def _size_of_gradient(scaled: ScaledProgram, verdict: Verdict, tolerance: float) -> float:
    """The size with which the remaining gradient of the Lagrangian at a feasible point is compared."""
    z, evaluation = verdict.answer.point, scaled.scale(verdict.user)
    multipliers = complementary(scaled, z, evaluation, verdict.multipliers, tolerance)
    remainder = multipliers.slope(evaluation)
    if not remainder.any():
        return 1.0
    largest = float(np.abs(remainder).max())
    pushes = remainder - evaluation.gradient
    size = float(np.minimum(np.abs(evaluation.gradient), np.abs(pushes)).max())
    if largest <= tolerance * size:
        return size
    direction = max(1.0, float(np.abs(z).max())) * remainder / largest
    terms = scaled.terms(evaluation, multipliers)
    if abs(float(remainder @ direction)) <= _FLAT * np.finfo(float).eps * terms:
        return max(size, terms)
    # The change of the Lagrangian's gradient over a typical magnitude against the remainder.
    try:
        changes = scaled.curvature(z, multipliers, direction[:, None])
    except NotFiniteError:
        return size or largest
    return max(size, float(np.abs(changes).max())) or largest


# --- Why a point is no solution, and what to do ---------------------------------------------------------------------

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

# What to tell of a search that ended where the constraints do not hold, although it had seen a point where they do.
_STRAYED = (
    "The constraints hold at this design, which the search saw on its way, but it ended where they do not and no small "
    "step returns: they seem to jump. See what al.examine tells of jumps and make these smooth, search by values alone "
    "with al.solvers.DifferentialEvolution, or try other starts with al.multistart"
)


def _advice(scaled: ScaledProgram, verdict: Verdict, tolerance: float) -> str:
    """Why a point is no solution and what to do, in words; empty for a solution."""
    answer, certificate, remedy = verdict.answer, verdict.certificate, ""
    if answer.claim not in (Status.ITERATION_LIMIT, Status.FAILED):
        return _REMEDIES.get(answer.claim, "")
    if answer.unfinished:
        return f"{answer.unfinished}. Lower the largest weights of the objective, or start elsewhere"
    if certificate.violation > _held(tolerance):
        reason = (
            f"a constraint is missed by {certificate.violation:.1e} of its size, where {_held(tolerance):.0e} is "
            "asked, although small steps would still reduce it"
        )
    else:
        residual = max(certificate.stationarity, certificate.complementarity)
        known, remedy = _stall(scaled, answer.point, verdict.multipliers)
        reason = f"stationarity is {residual:.1e}, where {tolerance:.0e} is asked{known and ': '}{known}"
    if not remedy and has_run_away(scaled, answer.point):
        reason += ", and decisions are far out on a side without a bound, where there may be no optimum"
        remedy = "Give all decisions bounds, or allow the solver more iterations, by its max_iterations"
    return f"{reason}. {remedy or _REMEDIES[answer.claim]}"


def has_run_away(scaled: ScaledProgram, z: np.ndarray, far: float = _FAR) -> bool:
    """Whether a variable is more typical magnitudes away from zero than `far`, on a side on which it has no bound."""
    open_ended = np.where(z > 0, np.isposinf(scaled.upper), np.isneginf(scaled.lower))
    return bool(np.any(open_ended & (np.abs(z) > far)))


# Steps that tell whether a model is finite close by; a possible gain, over the longest of them, is seen if it is above
# so many rounding errors.
_STEPS, _ROUNDINGS = (1e-3, 1e-5, 1e-7), 1e3


def _stall(scaled: ScaledProgram, z: np.ndarray, multipliers: Multipliers) -> tuple[str, str]:
    """Why a solver may have got stuck at a point, in words that follow a colon, and the remedy; empty if unknown.

    The slopes of the Lagrangian are looked at along its own steepest descent. The result does not depend on the solver.
    """
    here, program = scaled.evaluate(z), scaled.program
    remainder = multipliers.slope(here)
    direction = -max(1.0, float(np.abs(z).max())) * remainder / (float(np.abs(remainder).max()) or 1.0)
    ends = np.where(direction > 0, scaled.upper, scaled.lower) - z
    direction[np.abs(ends) <= _STEPS[0] * np.abs(direction)] = 0.0
    if not direction.any():
        return "", ""
    rounding = np.finfo(float).eps * scaled.terms(here, multipliers)
    if _STEPS[0] * abs(float(remainder @ direction)) <= _ROUNDINGS * rounding:
        why = "the possible gain is below the rounding of the objective, so that no further progress is possible here"
        return why, "Accept it by a larger tolerance of the solver"
    along, rows = np.zeros(program.start.size), scaled.to_user(multipliers, scaled.user(z))[0]
    along[program.lower < program.upper] = direction
    along *= program.variable_scale
    line = line_of(replace(program, evaluate=scaled.evaluations.at), scaled.unscaled(z), along, rows)
    with np.errstate(invalid="ignore"):
        if not all(line.evaluate(line.start + step).is_finite for step in _STEPS):
            why = "the model is not finite close by, where it would be less"
            return why, "Exclude those points by the bounds of the decisions"
    slopes = slopes_at(line, line.start)
    if not np.any(slopes.kinks | slopes.jumps | slopes.wrong):
        return "", ""
    what = "jumps" if slopes.jumps.any() else "has a kink"
    why = (
        f"the objective or an active constraint {what} close by, so that it does not change as its derivative "
        "predicts, and no derivative-based solver gets further"
    )
    remedy = "Make it smooth there (al.examine names it), or replace a largest or absolute value by limits on its parts"
    return why, remedy
