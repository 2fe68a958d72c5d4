"""What a point of a program means for the limits of its problem, as these were declared."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from aleator.design import (
    AbstractFunctional,
    Constraint,
    Expression,
    Statistic,
    Value,
    as_declared,
    functionals_of,
    limited_probability,
    path_of,
    statistics_in,
    variances_by_noise,
)
from aleator.nlp import Outcome
from aleator.solution import ConstraintResult, Solution
from aleator.statistics import Sloped, Std, sloped
from aleator.transcription import AbstractTranscribed, as_read, bound_size

# A limit that is so many times as far inside of its bound as the errors of its statistics does not hang on them.
_FAR_INSIDE = 100.0


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
        yield result if one.declared is None else _as_declared(transcribed, outcome.point, one.declared, result)


def _as_declared(
    transcribed: AbstractTranscribed,
    point: Float[np.ndarray, " variables"],
    limit: Constraint,
    result: ConstraintResult,
) -> ConstraintResult:
    """The result of a limit on a probability, from that of the limit on a quantile as which it was searched."""
    one, bounds = limited_probability(limit), (float(limit.lower), float(limit.upper))
    assert one is not None
    result = replace(result, text=str(limit), lower=bounds[0], upper=bounds[1])
    if one.excludes_nothing:
        return result
    chance, quantile = (_tail(transcribed, point, one.functional, kind) for kind in (one.kind, one.quantile))
    # The quantile moves by this much with its level: the density's reciprocal, zero where many systems are equal.
    by_level = np.ravel(quantile.by_numbers[0])
    sizes = np.divide(result.scale, by_level, out=np.zeros(by_level.shape), where=by_level > 0)
    return replace(
        result,
        values=one.constant + one.factor * np.ravel(chance.values),
        multipliers=-result.multipliers * by_level * one.level_by_bound,
        scale=max(bound_size(limit), abs(one.factor) * float(sizes.max())),
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


def within_reach_of_errors(solution: Solution) -> Iterator[Expression]:
    """The limits that errors of expansions may decide: not those that are many times as far from their bounds."""
    errors, noise = solution.certificate.expansion.leave_one_out, variances_by_noise(solution.problem.expressions)

    def missed(one: AbstractFunctional, *more: AbstractFunctional) -> float:
        by_noise = solution.moments[noise[one].text()].mean if one in noise else 0.0
        spread = float(np.sqrt(np.max(solution.moments[one.text()].std ** 2 + by_noise)))
        # Others are variances that noise adds to a spread.
        each = errors.get(one.text(), 0.0) * spread, *(missed(other) / (2 * spread) for other in more if spread)
        return sum(each)

    for limit, result in zip(solution.problem.constraints, solution.constraints, strict=True):
        if _is_rare_by_moments(limit, solution):
            continue
        reach = 0.0
        for factor, atom in zip(limit.expression.factors, limit.expression.atoms, strict=True):
            if isinstance(atom, Statistic) and (atom.kind.speaks_of_one_system or isinstance(atom.kind, Std)):
                reach += abs(float(factor)) * missed(*atom.functionals)
            elif not isinstance(atom, Value):
                reach = np.inf
        if not float(np.max(result.excess)) < -_FAR_INSIDE * reach:
            yield limit.expression


def _is_rare_by_moments(limit: Constraint, solution: Solution) -> bool:
    """Whether an event is rarer than its limit for every distribution of this mean and a spread that includes what the
    expansion misses (Cantelli's inequality).
    """
    one = limited_probability(limit)
    if one is None or one.is_least:
        return False
    text = one.functional.text()
    moments, error = solution.moments[text], solution.certificate.expansion.leave_one_out.get(text, 0.0)
    gap = (moments.mean - float(one.threshold)) * (1 if one.is_below else -1)
    variance = (moments.std * (1 + error)) ** 2
    return bool(np.all((gap > 0) & (variance <= one.chance * (variance + gap**2))))
