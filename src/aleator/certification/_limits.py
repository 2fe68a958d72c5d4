"""What a point of a program means for the limits of its problem, as these were declared."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from aleator.design import (
    AbstractFunctional,
    Constraint,
    as_declared,
    functionals_of,
    limited_probability,
    path_of,
    statistics_in,
)
from aleator.nlp import Outcome
from aleator.solution import ConstraintResult
from aleator.statistics import Sloped, sloped
from aleator.transcription import AbstractTranscribed, as_read, bound_size


def constraint_results(transcribed: AbstractTranscribed, outcome: Outcome) -> Iterator[ConstraintResult]:
    """Those of all limits, in their order."""
    each = transcribed.problem.constraints, transcribed.rows, transcribed.at(outcome.point).constraints
    for one, rows, own in zip(*each, strict=True):
        times = transcribed.times_limited(outcome.point, path_of(one)) if one.is_path else None
        parts = as_read(one, transcribed.scenarios, own, outcome.multipliers[rows], outcome.active[rows])
        if times is not None:  # rows by instant, if there are several at each
            parts = (part if len(part) == len(times) else part.reshape(len(times), -1) for part in parts)
        values, multipliers, active = parts
        bounds, size = (float(one.lower), float(one.upper)), float(outcome.sizes[rows].max())
        result = ConstraintResult(one.name, str(one), *bounds, values, times, multipliers, active, size)
        yield result if one.declared is None else _of_a_probability(transcribed, outcome.point, one.declared, result)


def _of_a_probability(
    transcribed: AbstractTranscribed,
    point: Float[np.ndarray, " variables"],
    limit: Constraint,
    result: ConstraintResult,
) -> ConstraintResult:
    """The result of a limit on a probability, from that of the limit on a quantile as which it was searched."""
    one = limited_probability(limit)
    assert one is not None
    chance, quantile = (_tail(transcribed, point, one.functional, kind) for kind in (one.kind, one.quantile))
    # The quantile moves by this much with its level: the density's reciprocal, zero where many systems are equal.
    by_level = float(quantile.by_numbers[0])
    size = result.scale / by_level if by_level > 0 else 0.0
    return replace(
        result,
        text=str(limit),
        lower=float(limit.lower),
        upper=float(limit.upper),
        values=np.full(1, one.constant + one.factor * float(chance.values)),
        multipliers=-result.multipliers * by_level * one.level_by_bound,
        scale=max(bound_size(limit), abs(one.factor) * size),
    )


def statistics_at(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"]
) -> dict[str, Float[np.ndarray, "..."]]:
    """Every statistic of the declared problem at a point, by its text."""
    searched = transcribed.statistics(point)
    return {
        text: searched[text] if text in searched else _tail(transcribed, point, one.functionals[0], one.kind).values
        for one in statistics_in(as_declared(transcribed.problem).expressions)
        for text in [one.text()]
    }


def _tail(
    transcribed: AbstractTranscribed,
    point: Float[np.ndarray, " variables"],
    functional: AbstractFunctional,
    kind: Any,
) -> Sloped:
    """A statistic of a functional's tail at a point, which the program does not evaluate."""
    each = zip(functionals_of(transcribed.problem.expressions), transcribed.at(point).samples, strict=True)
    coefficients = transcribed.collocation.coefficients(dict(each)[functional])
    return sloped(kind, np.asarray(coefficients), transcribed.constants.of(kind))
