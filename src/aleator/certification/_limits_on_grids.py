"""Whether limits hold on a finer grid, and whether a problem's own grid can tell."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.certification._probe import difference_shown
from aleator.certification._reference import OWN_ERROR, Reference, bound_size
from aleator.design import Constraint, Expression, Peak, Statistic, functionals_of, is_over_time
from aleator.statistics import Std, Variance
from aleator.transcription import AbstractTranscribed, Meaning

# An excess on a finer grid is an error of the grid if the grids differ by at least this part of it.
_OF_THE_GRID = 0.1
# A grid that differs from a finer one by more than these parts of a limit's size does not tell whether it holds: by
# the first if it is no further from its bound than that, by the second wherever it is.
_NEAR_BOUND, _ANYWHERE = 0.05, 0.25


class _Difference(NamedTuple):
    """By how much a limit's values differ from those of other grids, and how far they are from a bound there.

    `time`: when, in s; NaN for a limit that has no time.
    """

    away: float
    slack: float
    time: float


def broken(
    transcribed: AbstractTranscribed,
    own: list[Float[np.ndarray, " rows"]],
    finer: Reference,
    sizes: list[float],
    accuracy: float,
) -> str:
    """A sentence on the constraint, no limit over time, that is broken most on the finer grid; empty if all hold.

    A difference that is equal on both grids is no error of the grid, however small its tolerance.
    """
    problem = transcribed.problem
    worst, sentence = accuracy, ""
    for one, size, before, value in zip(problem.constraints, sizes, own, finer.values[1:], strict=True):
        if is_over_time(one):
            continue
        if not np.isfinite(value).all():
            return f"on a finer grid '{one.name}' ({one}) is not a number"
        excess = float(np.max(np.maximum(value - float(one.upper), float(one.lower) - value)))
        changed = float(np.max(np.abs(np.ravel(value) - before)))
        if excess > worst * size > 0 and changed > _OF_THE_GRID * excess:
            worst = excess / size
            sentence = f"on a finer grid '{one.name}' ({one}) exceeds its bound by {excess:.2g}"
    return sentence


def unresolved(transcribed: AbstractTranscribed, meaning: Meaning, finer: Reference, sizes: list[float]) -> str:
    """A sentence on the limit that differs most from a finer grid, so much that nothing is known of whether it holds,
    on whichever side of its bound it is there; empty if there is none.

    `meaning`: of the point on the problem's own grid; `sizes`: see `limit_sizes`.
    """
    worst, sentence = 0.0, ""
    for i, (one, size) in enumerate(zip(transcribed.problem.constraints, sizes, strict=True)):
        if not size > 0:
            continue
        own, value = np.ravel(meaning.constraints[i]), np.asarray(finer.values[1 + i])
        magnitude = max(size, float(np.abs(own).max()), float(np.abs(value).max()))
        for found in _differences(one, own, value, i, finer, meaning):
            is_near = found.away > _NEAR_BOUND * size and found.away > abs(found.slack)
            if (is_near or found.away > _ANYWHERE * magnitude) and found.away > worst * size:
                worst = found.away / size
                when = "" if np.isnan(found.time) else f" at t = {found.time:.4g} s"
                sentence = (
                    f"'{one.name}' ({one}) differs by {found.away:.2g}{when} on a finer grid, so that these steps do "
                    "not tell whether it holds"
                )
    return sentence


def _differences(
    one: Constraint, own: np.ndarray, value: np.ndarray, which: int, finer: Reference, meaning: Meaning
) -> Iterator[_Difference]:
    """The differences between a limit's values on its own grid, shape (rows,), and on others."""
    if one.is_path:
        yield from _on_paths(one, own, value, finer.factor, meaning.times)
        return
    changed = np.abs(np.ravel(value) - own)
    slacks = np.minimum(float(one.upper) - np.ravel(value), np.ravel(value) - float(one.lower))
    k = int(np.argmax(changed))
    # What a peak exceeds between the instants is held there by margins.
    is_peak = any(isinstance(part, Peak) for part in functionals_of((one.expression,)))
    yield _Difference(OWN_ERROR * float(changed[k]), np.inf if is_peak else float(slacks[k]), np.nan)
    if not is_over_time(one):
        alike, there = finer.alone.expressions[1 + which], finer.elsewhere.expressions[1 + which]
        yield _Difference(difference_shown(alike, there), float(slacks.min()), np.nan)


def _on_paths(
    one: Constraint, own: np.ndarray, value: np.ndarray, factor: int, times: Float[np.ndarray, " instants"]
) -> Iterator[_Difference]:
    """How far a path at the instants is outside what it reaches on the finer grid within a step of them.

    So a jump that lies on the other side of an instant there makes no difference.
    """
    rows, fine = own.reshape(len(times), -1), value.reshape(len(value), -1)
    windows = np.arange(len(times))[:, None] * factor + np.arange(-factor, factor + 1)[None, :]
    around = fine[np.clip(windows, 0, len(fine) - 1)]
    away = OWN_ERROR * np.maximum(rows - around.max(axis=1), around.min(axis=1) - rows)
    there = fine[::factor]
    slacks = np.minimum(float(one.upper) - there, there - float(one.lower))
    for worst in (away, np.where(away > np.abs(slacks), away, -np.inf)):
        i, entry = np.unravel_index(int(np.argmax(worst)), worst.shape)
        if away[i, entry] > 0:
            yield _Difference(float(away[i, entry]), float(slacks[i, entry]), float(times[i]))


def limit_sizes(
    transcribed: AbstractTranscribed, reaches: dict[Any, float], rows: Float[np.ndarray, " rows"]
) -> list[float]:
    """The size of each limit: its smaller bound or, where that is zero, how large its expression may be.

    `reaches`: how large each functional could be; `rows`: see `row_sizes`.
    """
    return [
        bound_size(one) or max(reach_of(one.expression, reaches), float(np.max(rows[own])))
        for one, own in zip(transcribed.problem.constraints, transcribed.rows, strict=True)
    ]


def reach_of(expression: Expression, reaches: dict[Any, float]) -> float:
    """The possible size of an expression, from that of its functionals; zero if unknown."""
    return sum(
        abs(float(factor)) * sum(_reach(part, reaches) for part in atom.parts)
        for factor, atom in zip(expression.factors, expression.atoms, strict=True)
    )


def _reach(atom: Any, reaches: dict[Any, float]) -> float:
    """The possible size of a statistic; a spread is no larger than the functional itself."""
    if not isinstance(atom, Statistic):
        return 0.0
    reach = reaches[atom.functionals[0]]
    if isinstance(atom.kind, Variance):
        return reach**2
    return reach if atom.kind.speaks_of_one_system or isinstance(atom.kind, Std) else 0.0
