"""The constraints of a program: their rows and bounds, their magnitudes, and those that no decision can meet."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np
from jaxtyping import Bool, Float, Int

from aleator._core.errors import ProblemError
from aleator.design import (
    AbstractAtom,
    AbstractFunctional,
    Composed,
    Constraint,
    Peak,
    Problem,
    Rms,
    Statistic,
    instants_of,
    is_at_points,
    is_worst_case,
    statistics_in,
)
from aleator.nlp import HELD, UNBOUNDED, Evaluation, Matrix, Outcome, variable_range
from aleator.statistics import Mean, Probability, Std, Variance
from aleator.transcription._abstract import AbstractTranscribed
from aleator.transcription._discretised import Scenarios

Values: TypeAlias = Sequence[Float[np.ndarray, "..."]]
"""Rows of each constraint; their number differs between constraints."""

# How many points in the whole range of the decisions show whether a constraint depends on them.
_TRIED = 8
# The largest size over bounds, the largest divisor over sizes, and the largest size over values seen elsewhere.
_MOST_BOUNDS, _MOST_SIZES, _BEYOND = 1e3, 1e2, 10.0
# The largest size over the spread of what is limited.
_MOST_SPREADS = 1e4
# Ranges of more starts than this, and bounds of more than this ratio, do not tell how large a decision is.
_LOOSE, _RATIO = 1e3, 1e2
# The effect of rounding of the decisions on a constraint, in rounding errors of its own terms.
_ROUNDINGS = 4.0
NOISE = 1e-13
"""A constraint with zero bounds whose values are nowhere larger than this is zero up to rounding."""
OF_ROUNDING = NOISE / HELD
"""The size of a constraint of which all that is seen may be rounding: it holds."""
# A value at the start that is less than this part of its change does not show how large values are.
_LITTLE = 1e-6


def constraint_size(
    constraint: Constraint,
    values: Float[np.ndarray, " rows"],
    derivatives: Matrix,
    decisions: Float[np.ndarray, " n"],
    decision_scale: Float[np.ndarray, " n"],
    away: float,
    spread: float,
) -> float:
    """The size of a constraint at some decisions, in its own unit, from its bound and all its rows.

    Violations are relative to it, and solvers end in it.

    - Its size is its largest value, but at least its bound and at most a thousand times that, so that the tolerance is
      at most a thousandth of the bound. Of two bounds the smaller one counts, because a remote one is uninformative.
    - So is a bound of zero. Then the size is the largest value or, for values near zero too, the change over a typical
      change of the decisions, whichever is larger. As a derivative may be extreme, the change is limited to ten times
      `away`, the largest value seen elsewhere (at the start and near it).
    - It is at most ten thousand times the `spread` of what is limited, if one stands in the limit (else infinite), so
      that the tolerance is at most a hundredth of a standard deviation, though not below rounding.
    - Changes due to rounding of the decisions are no violation. For a bound of zero, neither are values that are
      nowhere more than 1e-13, such as a difference of two equal numbers.
    """
    slopes = np.abs(derivatives)
    with np.errstate(invalid="ignore", over="ignore"):  # What is not finite is no magnitude.
        change, rounding = (_finite(np.max(slopes @ one, initial=0.0)) for one in (decision_scale, np.abs(decisions)))
    largest, bound = _finite(np.max(np.abs(values), initial=0.0)), bound_size(constraint)
    if bound:
        size = float(np.clip(largest, bound, _MOST_BOUNDS * bound))
    else:
        size = max(largest, min(change, _BEYOND * away) if away > 0 else change)
        size = size if max(size, change, away) > NOISE else OF_ROUNDING
    size = min(size, max(_MOST_SPREADS * spread, _ROUNDINGS * np.finfo(float).eps / HELD * largest))
    rounded = _ROUNDINGS * np.finfo(float).eps / HELD * rounding
    # One extremely steep row must not loosen the tolerance of the others.
    return max(size, min(rounded, _MOST_BOUNDS * bound) if bound else rounded) or 1.0


@final
@dataclass(frozen=True)
class Sizing:
    """The magnitudes of a problem's constraints at any decisions.

    - `rows`: those of each constraint in the program's constraint vector;
    - `decision_scale`: see `decision_scales`, shape (n,);
    - `away`: the largest value of each constraint at some other decisions;
    - `spreads`: of each constraint at the start, see `spreads_of`.
    """

    constraints: tuple[Constraint, ...]
    rows: tuple[slice, ...]
    decision_scale: Float[np.ndarray, " n"]
    away: list[float]
    spreads: list[float]

    def each(self, decisions: Float[np.ndarray, " n"], values: Values, derivatives: Sequence[Matrix]) -> list[float]:
        """The size of each constraint, from its rows and their derivatives at some decisions."""
        parts = zip(self.constraints, values, derivatives, self.away, self.spreads, strict=True)
        return [
            constraint_size(one, value, slopes, decisions, self.decision_scale, away, spread)
            for one, value, slopes, away, spread in parts
        ]

    def first_divisors(self, sizes: Sequence[float], derivatives: Sequence[Matrix]) -> list[float]:
        """By what solvers divide each constraint at first: the change over a typical change of the decisions, or the
        bound if that is larger, but at most a hundred sizes.

        Steep limits divided by their sizes alone make a search creep along them. It ends in sizes.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            changes = [_finite(np.max(np.abs(slopes) @ self.decision_scale, initial=0.0)) for slopes in derivatives]
        return [
            min(max(bound_size(one) or size, change), _MOST_SIZES * size)
            for one, size, change in zip(self.constraints, sizes, changes, strict=True)
        ]

    def at(self, decisions: Float[np.ndarray, " n"], evaluation: Evaluation) -> Float[np.ndarray, " m"]:
        """The sizes of all rows of the program."""
        values, derivatives = (
            [part[where] for where in self.rows] for part in (evaluation.constraints, evaluation.jacobian)
        )
        return spread(self.rows, self.each(decisions, values, derivatives))


def spreads_of(
    constraints: Sequence[Constraint], std_of: Callable[[AbstractFunctional], Float[np.ndarray, "..."]]
) -> list[float]:
    """How much what is limited spreads, of each constraint in which a spread stands; infinite of others, and of none.

    `std_of`: gives the standard deviation of a functional.
    """
    return [
        min(
            (
                largest
                for factor, atom in zip(one.expression.factors, one.expression.atoms, strict=True)
                if isinstance(atom, Statistic) and not isinstance(atom.kind, Mean) and float(factor) != 0
                for functional in atom.functionals
                if (largest := float(np.max(std_of(functional)))) > 0
            ),
            default=np.inf,
        )
        for one in constraints
    ]


def spread(rows: tuple[slice, ...], numbers: list[float]) -> Float[np.ndarray, " m"]:
    """One number for each constraint, repeated over its rows."""
    return np.concatenate(
        [np.zeros(0), *(np.full(row.stop - row.start, x) for row, x in zip(rows, numbers, strict=True))]
    )


def bound_size(constraint: Constraint) -> float:
    """The smaller of a constraint's bounds that are not zero, in magnitude; zero if there is none."""
    bounds = (abs(float(bound)) for bound in (constraint.lower, constraint.upper))
    return min((bound for bound in bounds if np.isfinite(bound) and bound != 0), default=0.0)


def rows_by_name(transcribed: AbstractTranscribed) -> list[tuple[Int[np.ndarray, " rows"], float]]:
    """The rows of each name of constraints, in the order of `Problem.names`, and the largest of their magnitudes."""
    problem, rows = transcribed.problem, transcribed.rows
    every = list(zip(problem.constraints, rows, transcribed.scales, strict=True))
    of_name = [[part for part in every if part[0].name == name] for name in problem.names]
    return [
        (
            np.concatenate([np.arange(where.start, where.stop) for _, where, _ in parts]),
            max(bound_size(one) or scale for one, _, scale in parts),
        )
        for parts in of_name
    ]


def needs_more(
    constraints: Iterable[Constraint], values: Values, derivatives: Values, decision_scale: Float[np.ndarray, " n"]
) -> bool:
    """Whether the values at the start do not show how large some constraint is, being zero like its bound."""
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
    """A lower bound of the objective; minus infinity if none is known.

    Norms and standard deviations are never negative, and have a kink at zero. A quantity that is never negative on a
    realisation may still have a negative mean by an expansion, unless nothing is uncertain.
    """
    objective = problem.objective
    terms = zip(objective.factors, objective.atoms, strict=True)
    if all(float(factor) >= 0 and _is_never_negative(atom, not problem.placements.germs) for factor, atom in terms):
        return float(objective.constant)
    return -np.inf


def _is_never_negative(atom: AbstractAtom, certain: bool) -> bool:
    if isinstance(atom, Composed):
        return atom.rule.is_never_negative
    if not isinstance(atom, Statistic):
        return False
    if isinstance(atom.kind, Std | Variance):
        return True
    return certain and isinstance(atom.kind, Mean) and isinstance(atom.functionals[0], Rms | Peak)


def decision_scales(start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Float[np.ndarray, " n"]:
    """A typical magnitude of each decision: its start, or a tenth of its range if that is larger.

    Bounds that are far apart say little. A tenth of a range counts up to a thousand starts, unless these are zero; not
    at all between bounds of one sign of which one is more than a hundred times the other, such as 1e-3 and 1e6, nor if
    the range is 1e15.
    """
    span, size, ends = upper - lower, np.abs(start), np.abs([lower, upper])
    tenth = np.where(span < UNBOUNDED * np.maximum(1.0, size), 0.1 * span, 0.0)
    tenth = np.where(size > 0, np.minimum(tenth, _LOOSE * size), tenth)
    is_ratio = (np.sign(lower) == np.sign(upper)) & (ends.max(axis=0) > _RATIO * ends.min(axis=0))
    scale = np.maximum(size, np.where(is_ratio, 0.0, tenth))
    return np.where(scale > 0, scale, 1.0)


def elsewhere(start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> list[Float[np.ndarray, " n"]]:
    """Decisions near the start and in their whole range, to detect quantities that do not depend on them."""
    rng = np.random.default_rng(0)
    size = decision_scales(start, lower, upper)
    low, high = variable_range(start, lower, upper, size)
    near = np.clip(start + 1e-2 * rng.choice([-1.0, 1.0], start.shape), lower, upper)
    return [near, *rng.uniform(low, high, (_TRIED, len(start)))]


def rows_of(values: Values) -> tuple[slice, ...]:
    """The rows of each constraint in the vector of all."""
    ends = np.cumsum([0, *map(len, values)]).tolist()
    return tuple(slice(first, last) for first, last in itertools.pairwise(ends))


def row_bounds(
    constraints: Sequence[Constraint], rows: tuple[slice, ...], scenarios: Scenarios | None, sizes: Sequence[float]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """The lower and upper bounds of all rows, infinite for limits on realisations in slots that do not count.

    What may be rounding has bounds as wide as this: slopes of rounding would lead a search, and hold a design.
    """
    wider = [NOISE if size == OF_ROUNDING else 0.0 for size in sizes]
    lower = spread(rows, [float(one.lower) - more for one, more in zip(constraints, wider, strict=True)])
    upper = spread(rows, [float(one.upper) + more for one, more in zip(constraints, wider, strict=True)])
    for one, where in zip(constraints, rows, strict=True):
        if (used := _used(one, scenarios)) is not None:
            empty = ~np.resize(used, where.stop - where.start)
            lower[where][empty], upper[where][empty] = -np.inf, np.inf
    return lower, upper


def _used(constraint: Constraint, scenarios: Scenarios | None) -> Bool[np.ndarray, " slots"] | None:
    """The slots at which a constraint is imposed; None if it is not one on realisations."""
    if scenarios is None or not (is_worst_case(constraint) or is_at_points(constraint)):
        return None
    return scenarios.used if is_worst_case(constraint) else scenarios.fixed


def as_read(
    constraint: Constraint,
    scenarios: Scenarios | None,
    values: Float[np.ndarray, " rows"],
    multipliers: Float[np.ndarray, " rows"],
    active: Bool[np.ndarray, " rows"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A constraint's rows for reports: for a limit on realisations, the worst over its scenarios."""
    if (used := _used(constraint, scenarios)) is None:
        return values, multipliers, active
    values, multipliers, active = (one.reshape(-1, len(used))[:, used] for one in (values, multipliers, active))
    worst = values.max(axis=1) if np.isfinite(float(constraint.upper)) else values.min(axis=1)
    return worst, multipliers.sum(axis=1), np.asarray(active.any(axis=1))


def refuse_unsatisfiable(
    problem: Problem,
    values: Values,
    derivatives: Values,
    scales: list[float],
    times: Float[np.ndarray, " instants"],
    elsewhere: Callable[[], Sequence[Values]],
) -> None:
    """Raise `ProblemError` for a constraint that is violated whatever the decisions are.

    - `values`, `derivatives`: of the constraints at the initial decisions;
    - `elsewhere`: gives the values at some other decisions. It is called only for suspect
      constraints, because a derivative may vanish at one point by chance, or over a range. A probability is 0 or 1
      over whatever range, and proves nothing.
    """
    suspects = [
        (i, int(np.argmax(np.where(row, excess, -np.inf))))
        for i, (one, value, slope, scale) in enumerate(
            zip(problem.constraints, values, derivatives, scales, strict=True)
        )
        if not any(isinstance(atom.kind, Probability) for atom in statistics_in((one.expression,)))
        and (row := ((excess := excess_of(one, value)) > HELD * scale) & np.all(slope == 0, axis=1)).any()
    ]
    if not suspects:
        return
    others = elsewhere()
    for i, row in suspects:
        if all(other[i][row] == values[i][row] for other in others):
            one, value = problem.constraints[i], float(values[i][row])
            own = instants_of(one, problem.grid, lambda: times)
            when = f" at t = {own[row * len(own) // len(values[i])]:.4g} s" if one.is_path else ""
            raise ProblemError(
                f"Constraint '{one.name}' ({one}) is {value:.6g}{when} whatever the decisions are, so that no design "
                "can meet it. Move what is fixed there (a start inside an obstacle, an end beyond a limit), or change "
                "the bound."
            )


def refuse_blind(outcome: Outcome, transcribed: AbstractTranscribed) -> None:
    """Raise `ProblemError` for decisions that change values although all derivatives by them are zero."""
    names = blind_decisions(outcome, transcribed)
    if not names:
        return
    raise ProblemError(
        f"The objective or a constraint changes with {names}, but all its derivatives tried are zero, so that no "
        "solver by derivatives can choose: the model rounds, floors, casts to whole numbers, stops gradients, or is "
        "flat there as far as digits go. Start elsewhere, make the effect smooth, let a search compare values "
        "(al.solvers.DifferentialEvolution()), or fix the number and compare its values one by one."
    )


def blind_decisions(outcome: Outcome, transcribed: AbstractTranscribed) -> str:
    """The decisions that change values although all derivatives by them are zero, in words; empty if there is none."""
    names = dict(zip(transcribed.decided.tolist(), transcribed.places.entry_names(), strict=True))
    return " and ".join(f"'{names[i]}'" for i in outcome.blind if i in names)


def excess_of(constraint: Constraint, values: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """The excess of values over the nearer bound of a constraint, negative inside."""
    with np.errstate(invalid="ignore"):  # Infinite values of an infinite bound exceed nothing.
        return np.asarray(np.maximum(values - float(constraint.upper), float(constraint.lower) - values))
