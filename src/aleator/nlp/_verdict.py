"""The verdict on a solver's answer: from what the point proves rather than from what the solver claims."""

from typing import NamedTuple

import numpy as np

from aleator.nlp._certificate import Certificate, Multipliers, certify, fit_multipliers, is_least_violated
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


class Answer(NamedTuple):
    """What a solver claims, in scaled quantities.

    Attributes:
        claim: the solver's own word.
        point: shape (n_free,).
        multipliers: None where the solver gives none.
        iterations: its count.
        message: what it said.

    """

    claim: Status
    point: np.ndarray
    multipliers: Multipliers | None
    iterations: int
    message: str


class Verdict(NamedTuple):
    """What is reported: a point with its evaluation in user units, scaled multipliers and their
    certificate.
    """

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
    if status is Status.INFEASIBLE:
        return _at(scaled, scaled.best, Answer(status, answer.point, None, 0, verdict.message))
    return verdict


def _status(scaled: ScaledProgram, answer: Answer, evaluation: Evaluation, certificate: Certificate) -> Status:
    claim = answer.claim
    if certificate.within(_PROVEN_VIOLATION, _PROVEN_OPTIMALITY):
        return Status.SOLVED
    if claim is Status.SOLVED and certificate.within(_BELIEVED_VIOLATION, _BELIEVED_OPTIMALITY):
        return Status.SOLVED
    if certificate.violation > _BELIEVED_VIOLATION and is_least_violated(scaled, answer.point, evaluation):
        return Status.INFEASIBLE
    return Status.FAILED if claim in (Status.SOLVED, Status.INFEASIBLE) else claim


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
