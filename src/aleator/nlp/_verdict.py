"""The verdict on a solver's answer: from what the point proves rather than from what the solver claims."""

from typing import NamedTuple

import numpy as np

from aleator.nlp._certificate import (
    Certificate,
    Multipliers,
    certify,
    complementary,
    fit_multipliers,
    is_least_violated,
    lagrangian_gradient,
)
from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._outcome import Status
from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import ScaledProgram

# A solver's word that it converged is believed up to these residuals.
_BELIEVED_VIOLATION = 1e-6
_BELIEVED_OPTIMALITY = 1e-4
# Up to these, a point is a solution even if the solver says that it gave up (small step, acceptable level).
_PROVEN_VIOLATION = 1e-7
_PROVEN_OPTIMALITY = 1e-5
# A solver that was still under way must have arrived beyond doubt.
_UNCLAIMED_OPTIMALITY = 1e-6
# Size of a probing step, in typical magnitudes: the change of the gradient must stand out from its rounding.
_PROBE = 1e-4
# Scales this close make no difference to a solver.
_SAME_SCALE = 10.0


class Answer(NamedTuple):
    """What a solver claims, in scaled quantities.

    - `claim`: the solver's own word;
    - `point`: shape (n_free,);
    - `multipliers`: None where the solver gives none;
    - `iterations`: its count;
    - `message`: what it said.
    """

    claim: Status
    point: np.ndarray
    multipliers: Multipliers | None
    iterations: int
    message: str


class Verdict(NamedTuple):
    """What is reported: a point with its evaluation in user units, scaled multipliers and their certificate."""

    status: Status
    point: np.ndarray
    user: Evaluation
    multipliers: Multipliers
    certificate: Certificate
    message: str


def judge(scaled: ScaledProgram, answer: Answer) -> Verdict:
    """Judge `answer`."""
    if scaled.best is None:
        return _unknown(scaled, answer)
    if scaled.evaluations.halt is not None or answer.claim is Status.INTERRUPTED:
        return _at(scaled, scaled.best, answer)
    try:
        evaluation = scaled.evaluate(answer.point)
    except NotFiniteError:
        return _at(scaled, scaled.best, answer._replace(claim=Status.EVALUATION_FAILED, multipliers=None))
    user = scaled.evaluations.at(scaled.decisions(answer.point))
    verdict = _at(scaled, (answer.point, user), answer)
    status = _status(scaled, answer, evaluation, verdict.certificate)
    if status is not answer.claim:
        verdict = verdict._replace(status=status, message=f"{answer.message}; judged: {_reason(verdict.certificate)}")
    if status is Status.EVALUATION_FAILED:
        verdict = verdict._replace(
            message=f"stuck beside points where the model is not finite; the solver said: {answer.message}"
        )
    if status is Status.INFEASIBLE:
        return _at(scaled, scaled.best, Answer(status, answer.point, None, 0, verdict.message))
    return verdict


def _status(scaled: ScaledProgram, answer: Answer, evaluation: Evaluation, certificate: Certificate) -> Status:
    claim = answer.claim
    proven = _UNCLAIMED_OPTIMALITY if claim is Status.ITERATION_LIMIT else _PROVEN_OPTIMALITY
    if certificate.within(_PROVEN_VIOLATION, proven):
        return Status.SOLVED
    if claim is Status.SOLVED and certificate.within(_BELIEVED_VIOLATION, _BELIEVED_OPTIMALITY):
        return Status.SOLVED
    if certificate.violation > _BELIEVED_VIOLATION and is_least_violated(scaled, answer.point, evaluation):
        return Status.INFEASIBLE
    if claim in (Status.ITERATION_LIMIT, Status.EVALUATION_FAILED):
        return claim
    # A solver that gives up beside points that cannot be evaluated gave up because of them.
    return Status.EVALUATION_FAILED if scaled.evaluations.failed_recently else Status.FAILED


def _at(scaled: ScaledProgram, point: tuple[np.ndarray, Evaluation], answer: Answer) -> Verdict:
    """Report the answer's claim at `point`, with the multipliers that prove most."""
    z, user = point
    evaluation = scaled.scale(user)
    candidates = []
    if answer.multipliers is not None:
        own = certify(scaled, z, evaluation, answer.multipliers)
        candidates.append((own, answer.multipliers))
    if not candidates or not candidates[0][0].within(np.inf, _PROVEN_OPTIMALITY):
        fitted = fit_multipliers(scaled, z, evaluation)
        candidates.append((certify(scaled, z, evaluation, fitted), fitted))
    certificate, multipliers = min(candidates, key=lambda pair: max(pair[0].stationarity, pair[0].complementarity))
    return Verdict(answer.claim, z, user, multipliers, certificate, answer.message)


def converted(multipliers: Multipliers | None, factor: float) -> Multipliers | None:
    """Multipliers of the objective times `factor`."""
    return None if multipliers is None else Multipliers(multipliers.rows * factor, multipliers.bounds * factor)


def settle(scaled: ScaledProgram, answer: Answer) -> tuple[Answer, bool]:
    """Scale the objective by what it does at the answer, and say whether the answer stands in that scale.

    The start may be so steep that every slope near the answer is negligible beside it. So the answer is judged by
    the terms that cancel in the gradient of its Lagrangian and, where these are no larger than the remainder (at an
    optimum inside all bounds they vanish), by the change of that gradient over a typical magnitude of the decisions,
    for which the model is evaluated once more, close by. Neither depends on the start or on an offset.

    The answer also stands where nothing is to be gained by another scale: infeasible, not finite, or scaled much the
    same already. One that is still under way stands only if it has arrived.
    """
    if answer.claim not in (Status.SOLVED, Status.FAILED, Status.ITERATION_LIMIT):
        return answer, True
    evaluation = scaled.evaluate(answer.point)
    user = scaled.evaluations.at(scaled.decisions(answer.point))
    multipliers = complementary(
        scaled, answer.point, evaluation, _at(scaled, (answer.point, user), answer).multipliers, _PROVEN_OPTIMALITY
    )
    remainder = lagrangian_gradient(evaluation, multipliers)
    under_way = answer.claim is Status.ITERATION_LIMIT
    if scaled.violation(evaluation.constraints).max(initial=0.0) > _BELIEVED_VIOLATION or not remainder.any():
        return answer, not under_way
    largest = float(np.abs(remainder).max())
    pushes = remainder - evaluation.gradient
    size = float(np.minimum(np.abs(evaluation.gradient), np.abs(pushes)).max())
    if largest > _PROVEN_OPTIMALITY * size:
        size = max(size, _change_of_gradient(scaled, answer.point, multipliers, remainder)) or largest
    before, after = scaled.objective_scale, scaled.objective_scale * size
    scaled.rescale(answer.point, after)
    answer = answer._replace(multipliers=converted(answer.multipliers, before / after))
    if under_way:
        return answer, largest <= _UNCLAIMED_OPTIMALITY * size
    return answer, largest <= _PROVEN_OPTIMALITY * size or 1 / _SAME_SCALE <= size <= _SAME_SCALE


def _change_of_gradient(scaled: ScaledProgram, z: np.ndarray, multipliers: Multipliers, remainder: np.ndarray) -> float:
    """Change of the Lagrangian's gradient over a typical magnitude against `remainder`; 0 if not known."""
    typical = max(1.0, float(np.abs(z).max()))
    direction = -_PROBE * typical * remainder / np.abs(remainder).max()
    for sign in (1, -1):
        moved = np.clip(z + sign * direction, scaled.lower, scaled.upper)
        distance = float(np.abs(moved - z).max())
        if distance < _PROBE * typical / 2:
            continue
        try:
            there = lagrangian_gradient(scaled.evaluate(moved), multipliers)
        except NotFiniteError:
            continue
        return float(np.abs(there - remainder).max()) * typical / distance
    return 0.0


def _unknown(scaled: ScaledProgram, answer: Answer) -> Verdict:
    """No point could be evaluated: nothing is known."""
    nowhere = Certificate(np.nan, np.nan, np.nan)
    zero = Multipliers(np.zeros(scaled.rows), np.zeros(scaled.size))
    return Verdict(answer.claim, answer.point, scaled.evaluations.last, zero, nowhere, answer.message)


def _reason(certificate: Certificate) -> str:
    return (
        f"violation {certificate.violation:.1e}, stationarity {certificate.stationarity:.1e}, "
        f"complementarity {certificate.complementarity:.1e}, all scaled"
    )
