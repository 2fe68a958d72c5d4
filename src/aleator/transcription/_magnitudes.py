"""Typical magnitudes of decisions and constraints, and other decisions of such magnitudes."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias, final

import numpy as np
from jaxtyping import Float

from aleator.design import AbstractAtom, Constraint, Norm, Peak, Problem, Rms, Statistic
from aleator.nlp import HELD, Evaluation, Magnitudes, variable_range
from aleator.statistics import Mean, Std, Variance

Values: TypeAlias = Sequence[Float[np.ndarray, "..."]]
"""Rows of each constraint, whose number differs from one to the next."""

# How many decisions all over their range tell whether a constraint depends on them.
_TRIED = 8
# The largest size in bounds, the largest scale in sizes, and the largest size in values seen elsewhere.
_MOST_BOUNDS, _MOST_SIZES, _BEYOND = 1e3, 1e2, 10.0
# What rounding of the decisions makes of a constraint, in roundings of its own terms.
_ROUNDINGS = 4.0
# A constraint without a bound other than zero whose values are nowhere larger than this is zero but for rounding.
_NOISE = 1e-13
# A value at the start that is less than this part of its change says nothing of how large values are.
_LITTLE = 1e-6


class Size(NamedTuple):
    """How large a constraint is: `size`, to which a violation is relative, and `scale`, for solvers to divide by."""

    size: float
    scale: float


def constraint_size(
    constraint: Constraint,
    values: Float[np.ndarray, " rows"],
    derivatives: Float[np.ndarray, "rows n"],
    decisions: Float[np.ndarray, " n"],
    decision_scale: Float[np.ndarray, " n"],
    away: float,
) -> Size:
    """How large a constraint is at some decisions, in its own unit: the bound and the values there, all rows of them.

    - Its size is that of its largest value, but no less than its bound and no more than a thousand times that, so that
      what counts as rounding is at most a thousandth of the bound. Of two bounds the smaller one counts: a remote one
      says nothing.
    - A bound of zero says nothing either. There the size is that of the largest value or, where the only value has
      come to be zero too, that of the values around: the change over a typical change of the decisions, but no more
      than ten times `away`, the largest value seen elsewhere (at the start and beside it), since a derivative may be
      wild.
    - What rounding of the decisions alone changes is no violation; nor is, where the bound is zero, what is nowhere
      more than 1e-13, as a difference of two numbers that are equal.

    A solver's scale is the change over a typical change of the decisions, or the bound where that is larger, but at
    most a hundred sizes: what a solver then takes for zero, 1e-8 of its scale, is a millionth of the size.
    """
    slopes = np.abs(derivatives)
    change, rounding = (_finite(np.max(slopes @ one, initial=0.0)) for one in (decision_scale, np.abs(decisions)))
    largest, bound = _finite(np.max(np.abs(values), initial=0.0)), bound_size(constraint)
    if bound:
        size = float(np.clip(largest, bound, _MOST_BOUNDS * bound))
    else:
        size = max(largest, min(change, _BEYOND * away) if away > 0 else change)
        size = size if max(size, change, away) > _NOISE else _NOISE / HELD
    rounded = _ROUNDINGS * np.finfo(float).eps / HELD * rounding
    # One row that is steep beyond reason excuses no other.
    size = max(size, min(rounded, _MOST_BOUNDS * bound) if bound else rounded) or 1.0
    return Size(size, min(max(bound or size, change), _MOST_SIZES * size))


@final
@dataclass(frozen=True)
class Sizing:
    """How large the constraints of a problem are at any decisions.

    - `rows`: those of each constraint in the program's constraint vector;
    - `decision_scale`: see `decision_scales`, shape (n,);
    - `away`: the largest value of each constraint at some other decisions.
    """

    constraints: tuple[Constraint, ...]
    rows: tuple[slice, ...]
    decision_scale: Float[np.ndarray, " n"]
    away: list[float]

    def each(self, decisions: Float[np.ndarray, " n"], values: Values, derivatives: Values) -> list[Size]:
        """The size of each constraint, from its rows and their derivatives at some decisions."""
        parts = zip(self.constraints, values, derivatives, self.away, strict=True)
        return [
            constraint_size(one, value, slopes, decisions, self.decision_scale, away)
            for one, value, slopes, away in parts
        ]

    def at(self, decisions: Float[np.ndarray, " n"], evaluation: Evaluation) -> Magnitudes:
        """The same for each row of the program."""
        values, derivatives = (
            [part[where] for where in self.rows] for part in (evaluation.constraints, evaluation.jacobian)
        )
        sizes = self.each(decisions, values, derivatives)
        size, scale = (spread(self.rows, [one[i] for one in sizes]) for i in (0, 1))
        return Magnitudes(size, scale)


def spread(rows: tuple[slice, ...], numbers: list[float]) -> Float[np.ndarray, " m"]:
    """One number for each constraint, repeated over its rows."""
    return np.concatenate(
        [np.zeros(0), *(np.full(row.stop - row.start, x) for row, x in zip(rows, numbers, strict=True))]
    )


def bound_size(constraint: Constraint) -> float:
    """The smaller of a constraint's bounds that are not zero, in magnitude; zero if there is none."""
    bounds = (abs(float(bound)) for bound in (constraint.lower, constraint.upper))
    return min((bound for bound in bounds if np.isfinite(bound) and bound != 0), default=0.0)


def needs_more(
    constraints: Iterable[Constraint], values: Values, derivatives: Values, decision_scale: Float[np.ndarray, " n"]
) -> bool:
    """Whether the values at the start do not tell how large some constraint is: zero, like its bound."""
    return any(
        not bound_size(one) and float(np.max(np.abs(value))) <= _LITTLE * float(np.max(np.abs(slopes) @ decision_scale))
        for one, value, slopes in zip(constraints, values, derivatives, strict=True)
        if np.isfinite(value).all()
    )


def largest_of(values: Iterable[Values]) -> list[float]:
    """The largest finite magnitude of each constraint at several decisions."""
    return [max(_finite(np.max(np.abs(rows), initial=0.0)) for rows in one) for one in zip(*values, strict=True)]


def _finite(number: float) -> float:
    return float(number) if np.isfinite(number) else 0.0


def least_objective(problem: Problem) -> float:
    """A value below which the objective cannot fall, minus infinity where none is known.

    Norms and standard deviations are never negative, and have a kink where they are zero. What is never negative on a
    realisation has no such mean by an expansion, but it has where nothing is uncertain.
    """
    objective = problem.objective
    terms = zip(objective.factors, objective.atoms, strict=True)
    if all(float(factor) >= 0 and _is_never_negative(atom, not problem.placements.germs) for factor, atom in terms):
        return float(objective.constant)
    return -np.inf


def _is_never_negative(atom: AbstractAtom, certain: bool) -> bool:
    if isinstance(atom, Norm):
        return True
    if not isinstance(atom, Statistic):
        return False
    if isinstance(atom.kind, Std | Variance):
        return True
    return certain and isinstance(atom.kind, Mean) and isinstance(atom.functionals[0], Rms | Peak)


def decision_scales(start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Float[np.ndarray, " n"]:
    """A typical magnitude of each decision: its start, or a tenth of its range if that is larger."""
    span = upper - lower
    scale = np.maximum(np.abs(start), np.where(np.isfinite(span), 0.1 * span, 0.0))
    return np.where(scale > 0, scale, 1.0)


def elsewhere(start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> list[Float[np.ndarray, " n"]]:
    """Decisions near the start and all over their range: what is the same at all of them is moved by none."""
    rng = np.random.default_rng(0)
    size = decision_scales(start, lower, upper)
    low, high = variable_range(start, lower, upper, size)
    near = np.clip(start + 1e-2 * rng.choice([-1.0, 1.0], start.shape), lower, upper)
    return [near, *rng.uniform(low, high, (_TRIED, len(start)))]
