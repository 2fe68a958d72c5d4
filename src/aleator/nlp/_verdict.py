"""What a solver claims of its answer, and the verdict on that: from the conditions at its point, with the reason."""

from typing import NamedTuple

import numpy as np

from aleator.nlp._certificate import (
    Certificate,
    certify,
    complementary,
    descent,
    fit_multipliers,
    is_least_violated,
    kinks_at,
)
from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._program import Evaluation, NonlinearProgram
from aleator.nlp._scaling import Multipliers, ScaledProgram, Scales
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


def _held(tolerance: float) -> float:
    """The largest violation of a constraint that holds, over its size."""
    return min(HELD, tolerance)


# A slope by which nothing would change, over a typical magnitude, by more than so many rounding errors is none.
_FLAT = 8.0
# Rows of a sparse program whose multipliers are fitted where a solver's own do not certify it.
_MOST_FITTED = 2000
# How often an answer is left for a lower point close by before the solver is asked again.
_MOST_MOVES = 4


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
        answer = _framed(scaled, _examined(scaled, answer, user, tolerance), user)
        verdict = _at(scaled, answer, user, tolerance)
        if verdict.certificate.violation <= _held(tolerance):
            if not verdict.certificate.within(np.inf, tolerance) and kinks_at(scaled, answer.point):
                return answer, True  # Slopes change at once there, so that their changes are no scale.
            size = _size_of_gradient(scaled, answer.point, verdict.multipliers, tolerance)
            answer = _rescaled(scaled, answer, scaled.scales._replace(objective=scaled.scales.objective * size))
            verdict = _at(scaled, answer, user, tolerance)
        status = _status(scaled, answer, verdict.certificate, tolerance)
        if status is not Status.SOLVED:
            return answer, status is Status.INFEASIBLE
        kept = complementary(scaled, answer.point, scaled.evaluate(answer.point), verdict.multipliers, tolerance)
        further = descent(scaled, answer.point, kept)
        if further is None:
            return answer, True
        if further.point is None or not further.holds or moves == _MOST_MOVES:
            break
        answer, moves = answer._replace(point=further.point), moves + 1
    said = (
        "it is on the floor of a steep valley, or beside larger slopes, and the objective would fall by about "
        f"{further.fall:.2g}"
    )
    # The next round needs a scale in which this slope is not small.
    scales = scaled.scales._replace(objective=scaled.scales.objective * further.slope)
    return _rescaled(scaled, answer._replace(unfinished=said, is_doubtful=further.is_doubtful), scales), False


def judge(scaled: ScaledProgram, answer: Answer, tolerance: float) -> Verdict:
    """Judge `answer`, which `settle` has processed. Scales are the sizes at the verdict's point from now on."""
    if scaled.best is None:
        none, unknown = Multipliers(np.zeros(scaled.rows), np.zeros(scaled.size)), Certificate(np.nan, np.nan, np.nan)
        return Verdict(answer.claim, answer.point, scaled.evaluations.last, none, unknown, answer.message)
    if scaled.evaluations.halt is not None or answer.claim is Status.INTERRUPTED:
        return _at_best(scaled, answer, tolerance)
    user = scaled.user(answer.point)
    if not user.is_finite:
        return _at_best(scaled, answer._replace(claim=Status.EVALUATION_FAILED), tolerance)
    answer = _framed(scaled, answer, user)
    verdict = _at(scaled, answer, user, tolerance)
    status = _status(scaled, answer, verdict.certificate, tolerance)
    if status is Status.FAILED and scaled.evaluations.failed_recently:
        # A solver that gives up next to points that cannot be evaluated is presumed to do so because of them.
        status = Status.EVALUATION_FAILED
    answer, verdict = answer._replace(claim=status), verdict._replace(status=status)
    if status is Status.INFEASIBLE:
        frame = scaled.scales
        least = _at_best(scaled, answer, tolerance)
        # Where the terms of a constraint are large, its own size alone would let pass what is seen elsewhere.
        sizes = np.minimum(frame.constraints, scaled.scales.constraints)
        outside = scaled.limits.excess(scaled.scale(least.user).constraints) * scaled.scales.constraints
        if np.all(outside <= _held(tolerance) * sizes):
            said = f"{_STRAYED} (the solver said: {answer.message})"
            return least._replace(status=Status.FAILED, message=said, strayed=True)
        if least.certificate.violation > _held(tolerance):
            verdict = least
        else:
            scaled.rescale(answer.point, frame)
    said = _advice(scaled, verdict, answer.unfinished, tolerance)
    return verdict._replace(message=f"{said} (the solver said: {answer.message})") if said else verdict


def _status(scaled: ScaledProgram, answer: Answer, certificate: Certificate, tolerance: float) -> Status:
    if not has_run_away(scaled, answer.point, LOST):
        if certificate.within(_held(tolerance), tolerance):
            return Status.FAILED if answer.unfinished and not answer.is_doubtful else Status.SOLVED
        infeasible = certificate.violation > _held(tolerance)
        if infeasible and (answer.claim is Status.INFEASIBLE or _is_least_violated(scaled, answer)):
            return Status.INFEASIBLE
    if answer.claim in (Status.ITERATION_LIMIT, Status.EVALUATION_FAILED):
        return answer.claim
    return Status.FAILED


def _is_least_violated(scaled: ScaledProgram, answer: Answer) -> bool:
    # A solver without iterations left was on its way.
    is_final = answer.claim is not Status.ITERATION_LIMIT
    return is_final and is_least_violated(scaled, answer.point, scaled.evaluate(answer.point))


def _examined(scaled: ScaledProgram, answer: Answer, user: Evaluation, tolerance: float) -> Answer:
    """The answer, which claims infeasibility if and only if that is proven in the scales in which the solver ran.

    The weights of the violations in the sum or maximum that no step lowers do not matter.
    """
    outside = scaled.limits.excess(scaled.scale(user).constraints) * scaled.scales.constraints
    is_outside = np.any(outside > _held(tolerance) * scaled.sizes_at(answer.point, user))
    if is_outside and _is_least_violated(scaled, answer):
        return answer._replace(claim=Status.INFEASIBLE)
    return answer._replace(claim=Status.FAILED) if answer.claim is Status.INFEASIBLE else answer


def _framed(scaled: ScaledProgram, answer: Answer, user: Evaluation) -> Answer:
    """The answer in the constraints' sizes at its point as scales, which `scaled` has from now on."""
    return _rescaled(scaled, answer, scaled.scales._replace(constraints=scaled.sizes_at(answer.point, user)))


def _rescaled(scaled: ScaledProgram, answer: Answer, scales: Scales) -> Answer:
    before = scaled.scales
    scaled.rescale(answer.point, scales)
    return answer._replace(multipliers=before.converted(answer.multipliers, scales))


def _at_best(scaled: ScaledProgram, answer: Answer, tolerance: float) -> Verdict:
    """Report the answer's claim at the best point seen."""
    assert scaled.best is not None
    point, user = scaled.best
    return _at(scaled, _framed(scaled, answer._replace(point=point, multipliers=None), user), user, tolerance)


def _at(scaled: ScaledProgram, answer: Answer, user: Evaluation, tolerance: float) -> Verdict:
    """Report the answer's claim at its point, with the multipliers of the smallest residuals."""
    z, evaluation, own = answer.point, scaled.scale(user), answer.multipliers
    known = [] if own is None else [(certify(scaled, z, evaluation, own), own)]
    if not known or not known[0][0].within(np.inf, tolerance):
        # An objective may be flat at its minimum: multipliers would be nothing but rounding.
        none = Multipliers(np.zeros(scaled.rows), np.zeros(scaled.size))
        flat = certify(scaled, z, evaluation, none)
        known.append((flat, none))
        if own is None or not _is_large(scaled):
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
                scaled.keep(z, kinks.evaluation)
                user, certificate, multipliers = kinks.evaluation, mixed, fitted
    return Verdict(answer.claim, z, user, multipliers, certificate, answer.message)


def _is_large(scaled: ScaledProgram) -> bool:
    """Whether multipliers cannot be fitted in reasonable time: a sparse program has thousands of equalities."""
    return not isinstance(scaled.sparsity, np.ndarray) and scaled.rows > _MOST_FITTED


def _size_of_gradient(scaled: ScaledProgram, z: np.ndarray, multipliers: Multipliers, tolerance: float) -> float:
    """The size with which the remaining gradient of the Lagrangian at a feasible point is compared."""
    evaluation = scaled.evaluate(z)
    multipliers = complementary(scaled, z, evaluation, multipliers, tolerance)
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


def _advice(scaled: ScaledProgram, verdict: Verdict, unfinished: str, tolerance: float) -> str:
    """Why a point is no solution and what to do, in words; empty for a solution."""
    if verdict.status not in _REMEDIES:
        return ""
    if verdict.status not in (Status.ITERATION_LIMIT, Status.FAILED):
        return _REMEDIES[verdict.status]
    if unfinished:
        return f"{unfinished}. Lower the largest weights of the objective, or start elsewhere"
    certificate, remedy = verdict.certificate, ""
    if certificate.violation > _held(tolerance):
        reason = (
            f"a constraint is missed by {certificate.violation:.1e} of its size, where {_held(tolerance):.0e} is "
            "asked, although small steps would still reduce it"
        )
    else:
        residual = max(certificate.stationarity, certificate.complementarity)
        known, remedy = _stall(scaled, verdict.point, verdict.multipliers)
        reason = f"stationarity is {residual:.1e}, where {tolerance:.0e} is asked{known and ': '}{known}"
    if not remedy and has_run_away(scaled, verdict.point):
        reason += ", and decisions are far out on a side without a bound, where there may be no optimum"
        remedy = "Give all decisions bounds, or allow the solver more iterations, by its max_iterations"
    return f"{reason}. {remedy or _REMEDIES[verdict.status]}"


def has_run_away(scaled: ScaledProgram, z: np.ndarray, far: float = _FAR) -> bool:
    """Whether a variable is more typical magnitudes away from zero than `far`, on a side on which it has no bound."""
    open_ended = np.where(z > 0, np.isposinf(scaled.upper), np.isneginf(scaled.lower))
    return bool(np.any(open_ended & (np.abs(z) > far)))


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
