"""The verdict on a solver's answer, from the conditions at its point rather than from the solver's claim."""

import numpy as np

from aleator.nlp._answer import LOST, STRAYED, Answer, Verdict, advice, has_run_away, held
from aleator.nlp._certificate import Certificate, certify, complementary, fit_multipliers, is_least_violated
from aleator.nlp._curvature import descent
from aleator.nlp._evaluations import NotFiniteError, changes_of
from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import Multipliers, ScaledProgram, Scales
from aleator.nlp._solver import Status

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
        if verdict.certificate.violation <= held(tolerance):
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
        if np.all(outside <= held(tolerance) * sizes):
            said = f"{STRAYED} (the solver said: {answer.message})"
            return least._replace(status=Status.FAILED, message=said, strayed=True)
        if least.certificate.violation > held(tolerance):
            verdict = least
        else:
            scaled.rescale(answer.point, frame)
    said = advice(scaled, verdict, answer.unfinished, tolerance)
    return verdict._replace(message=f"{said} (the solver said: {answer.message})") if said else verdict


def _status(scaled: ScaledProgram, answer: Answer, certificate: Certificate, tolerance: float) -> Status:
    if not has_run_away(scaled, answer.point, LOST):
        if certificate.within(held(tolerance), tolerance):
            return Status.FAILED if answer.unfinished and not answer.is_doubtful else Status.SOLVED
        infeasible = certificate.violation > held(tolerance)
        if infeasible and (answer.claim is Status.INFEASIBLE or _is_least_violated(scaled, answer)):
            return Status.INFEASIBLE
    if answer.claim in (Status.ITERATION_LIMIT, Status.EVALUATION_FAILED):
        return answer.claim
    return Status.FAILED


def _is_least_violated(scaled: ScaledProgram, answer: Answer) -> bool:
    # A solver without iterations left was on its way, and for a large program the proof takes its time.
    if answer.claim is Status.ITERATION_LIMIT and _is_large(scaled):
        return False
    return is_least_violated(scaled, answer.point, scaled.evaluate(answer.point))


def _examined(scaled: ScaledProgram, answer: Answer, user: Evaluation, tolerance: float) -> Answer:
    """The answer, which claims infeasibility if and only if that is proven in the scales in which the solver ran.

    The weights of the violations in the sum or maximum that no step lowers do not matter.
    """
    outside = scaled.limits.excess(scaled.scale(user).constraints) * scaled.scales.constraints
    is_outside = np.any(outside > held(tolerance) * scaled.sizes_at(answer.point, user))
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
    # The change of the Lagrangian's gradient over a typical magnitude against the remainder.
    direction = max(1.0, float(np.abs(z).max())) * remainder / largest
    try:
        changes = changes_of(
            lambda point: multipliers.slope(scaled.evaluate(point)), z, (scaled.lower, scaled.upper), direction[:, None]
        )
    except NotFiniteError:
        return size or largest
    return max(size, float(np.abs(changes).max())) or largest
