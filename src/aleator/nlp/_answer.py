"""`Answer`: what a solver claims; `Verdict`: what is reported of it."""

from numbers import Integral
from typing import Any, NamedTuple

import numpy as np

from aleator._core.errors import ProblemError
from aleator._core.given import real_array
from aleator.nlp._certificate import Certificate
from aleator.nlp._outcome import Status
from aleator.nlp._program import Evaluation
from aleator.nlp._scales import Multipliers
from aleator.nlp._scaling import ScaledProgram


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
    multipliers: Multipliers | None
    iterations: int
    message: str
    unfinished: str = ""
    is_doubtful: bool = False


def checked_answer(who: str, answer: Any, scaled: ScaledProgram) -> Answer:
    """A checked answer to a program. Raises `ProblemError` in the name of `who` for anything else."""
    if not isinstance(answer, Answer):
        raise ProblemError(f"{who}: expected an Answer; received {type(answer).__name__} {answer!r}.")
    point = real_array(f"{who}: point", answer.point)
    if point.shape != scaled.start.shape:
        raise ProblemError(
            f"{who}: expected a point of shape {scaled.start.shape}, that of `scaled.start`; "
            f"received shape {point.shape}."
        )
    expected: tuple[tuple[str, Any, type], ...] = (
        ("claim", answer.claim, Status),
        ("multipliers", answer.multipliers, Multipliers | None),  # type: ignore[arg-type]
        ("iterations", answer.iterations, Integral),
    )
    for name, value, kind in expected:
        if not isinstance(value, kind):
            what = getattr(kind, "__name__", "Multipliers, or None")
            raise ProblemError(f"{who}: expected `{name}` as {what}; received {value!r}.")
    return answer._replace(point=point)


class Verdict(NamedTuple):
    """The result to report: a point with its evaluation in user units, scaled multipliers and their certificate.

    `sizes`: of the useful constraints at the point, in user units, shape (m_useful,); `strayed`: see `Outcome`.
    """

    status: Status
    point: np.ndarray
    user: Evaluation
    multipliers: Multipliers
    certificate: Certificate
    message: str
    sizes: np.ndarray
    strayed: bool = False
