"""Interior points for many realisations (Wächter and Biegler 2006, algorithm A): what ties determine is eliminated in
every iteration.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from typing_extensions import override

from aleator.nlp._answer import Answer
from aleator.nlp._barrier import Filter, Iterate, Newton, Slacked, first_multipliers
from aleator.nlp._elimination import Elimination, IllConditionedError, SingularTiesError
from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._ipopt import Ipopt
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import Multipliers, ScaledProgram
from aleator.nlp._solver import Status

# Names of the source in brackets.
_FIRST_WEIGHT, _WARM_WEIGHT = 0.1, 1e-6  # μ at a cold and at a warm start
_LESS_WEIGHT, _WEIGHT_POWER, _SOLVED_FOR = 0.2, 1.5, 10.0  # κ_μ, θ_μ, κ_ε
_LEAST_FRACTION = 0.99  # τ_min
_PUSH, _WARM_PUSH = 1e-2, 1e-8  # κ_1 and κ_2
_MOST_CORRECTIONS, _CORRECTED = 4, 0.99  # p_max, κ_soc
# Steps below this part of the values are rounding.
_TINY = 10 * float(np.finfo(float).eps)


@final
class StuckError(ArithmeticError):
    """No step along the direction is acceptable."""


@final
class Search:
    """The search from `scaled.start`; `aim` is the error at which it ends.

    `iterations`: how many were made so far.
    """

    def __init__(self, scaled: ScaledProgram, elimination: Elimination, aim: float):
        self._scaled, self._elimination, self._aim = scaled, elimination, aim
        self._slacked = Slacked.of(scaled)
        self._weight, self._last_shift = _FIRST_WEIGHT, 0.0
        self.iterations = 0

    def run(self, multipliers: np.ndarray | None, most: int, tolerance: float) -> Answer:
        """Iterate to the end.

        - `multipliers`: of the rows, for a warm start; `most`: iterations; `tolerance`: the error up to which a point
          at which no step is acceptable is an answer.

        Raises `SingularTiesError`, `IllConditionedError`, `StuckError`, `NotFiniteError`, `HaltedError`.
        """
        slacked = self._slacked
        at = self._first() if multipliers is None else self._warm(multipliers)
        evaluation = self._scaled.evaluate(at.values[: slacked.size])
        filter_ = Filter(_violation(slacked.residual(at.values, evaluation)))
        while slacked.error(at, evaluation, 0.0) > self._aim:
            if self.iterations == most:
                return self._answer(Status.ITERATION_LIMIT, at, "iteration limit")
            self._lower_weight(at, evaluation, filter_)
            try:
                at = self._next(at, evaluation, filter_)
            except (StuckError, IllConditionedError):
                if slacked.error(at, evaluation, 0.0) > tolerance:
                    raise
                return self._answer(Status.FAILED, at, "stopped at rounding errors")
            self.iterations += 1
            evaluation = self._scaled.evaluate(at.values[: slacked.size])
        return self._answer(Status.SOLVED, at, "solved")

    @property
    def _fraction(self) -> float:
        """How much of a gap a step may use up."""
        return max(_LEAST_FRACTION, 1 - self._weight)

    def _lower_weight(self, at: Iterate, evaluation: Evaluation, filter_: Filter) -> None:
        """Lower the weight of the barrier as often as the iterate solves its problem."""
        least = self._aim / _SOLVED_FOR
        while self._weight > least and self._slacked.error(at, evaluation, self._weight) <= _SOLVED_FOR * self._weight:
            self._weight = max(least, min(_LESS_WEIGHT * self._weight, self._weight**_WEIGHT_POWER))
            filter_.clear()

    def _inside(self, push: float) -> np.ndarray:
        """The start with its slacks, inside all bounds."""
        start = self._scaled.start
        rows = self._scaled.evaluate(start).constraints[self._slacked.unequal]
        return self._slacked.pushed(np.append(start, rows), push)

    def _first(self) -> Iterate:
        """A cold start."""
        slacked, scaled = self._slacked, self._scaled
        values = self._inside(_PUSH)
        below, above = (np.isfinite(gap).astype(float) for gap in slacked.gaps(values))
        at = Iterate(values, np.zeros(scaled.rows), below, above)
        evaluation = scaled.evaluate(values[: slacked.size])
        return at._replace(rows=first_multipliers(scaled, self._elimination, slacked, at, evaluation))

    def _warm(self, multipliers: np.ndarray) -> Iterate:
        """A start with multipliers; those of the bounds make it stationary, as far as they can."""
        slacked = self._slacked
        self._weight = _WARM_WEIGHT
        values = self._inside(_WARM_PUSH)
        none = np.zeros(values.size)
        evaluation = self._scaled.evaluate(values[: slacked.size])
        slope = slacked.slope(Iterate(values, multipliers, none, none), evaluation)
        below, above = (
            np.where(np.isfinite(gap), np.maximum(pull, self._weight / np.maximum(gap, 1.0)), 0.0)
            for gap, pull in zip(slacked.gaps(values), (slope, -slope), strict=True)
        )
        return Iterate(values, multipliers, below, above)

    def _next(self, at: Iterate, evaluation: Evaluation, filter_: Filter) -> Iterate:
        """The next iterate, by a line search. Raises `StuckError` if no step is acceptable."""
        slacked, scaled, weight = self._slacked, self._scaled, self._weight
        newton = Newton.of(scaled, self._elimination, slacked, at, evaluation, weight, self._last_shift)
        self._last_shift = newton.shift or self._last_shift
        missed = newton.missed
        step = newton.step(missed)
        longest = length = slacked.longest(at.values, step.values, self._fraction)
        if np.all(np.abs(step.values) <= _TINY * np.maximum(1.0, np.abs(at.values))):
            return slacked.moved(at, step, length, weight, self._fraction)
        before = _violation(missed), slacked.barrier(at.values, evaluation, weight)
        descent = float(newton.barred @ step.values)
        while length >= filter_.shortest(before[0], descent):
            after = self._pair(at.values + length * step.values)
            if after is not None and filter_.accepts(before, after, descent, length):
                return slacked.moved(at, step, length, weight, self._fraction)
            if length == longest and after is not None and after[0] >= before[0]:
                corrected = self._corrected(newton, step, longest, before, descent, filter_)
                if corrected is not None:
                    return corrected
            length /= 2
        raise StuckError

    def _corrected(
        self,
        newton: Newton,
        step: Iterate,
        longest: float,
        before: tuple[float, float],
        descent: float,
        filter_: Filter,
    ) -> Iterate | None:
        """The next iterate by second-order corrections of a step that worsens rows; None if none is accepted."""
        slacked, at = self._slacked, newton.at
        missed, last, length = newton.missed, np.inf, longest
        for _ in range(_MOST_CORRECTIONS):
            trial = at.values + length * step.values
            there = self._scaled.evaluate(trial[: slacked.size])
            missed = length * missed + slacked.residual(trial, there)
            step = newton.step(missed)
            length = slacked.longest(at.values, step.values, self._fraction)
            after = self._pair(at.values + length * step.values)
            if after is None or after[0] > _CORRECTED * last:
                return None
            if filter_.accepts(before, after, descent, longest):
                return slacked.moved(at, step, length, self._weight, self._fraction)
            last = after[0]
        return None

    def _pair(self, values: np.ndarray) -> tuple[float, float] | None:
        """The violation and the objective with its barrier at a point; None if it cannot be evaluated."""
        try:
            there = self._scaled.evaluate(values[: self._slacked.size])
        except NotFiniteError:
            return None
        return _violation(self._slacked.residual(values, there)), self._slacked.barrier(values, there, self._weight)

    def _answer(self, claim: Status, at: Iterate, message: str) -> Answer:
        size = self._slacked.size
        multipliers = Multipliers(at.rows, (at.above - at.below)[:size])
        return Answer(claim, at.values[:size], multipliers, self.iterations, message)


def _violation(missed: np.ndarray) -> float:
    """What the filter compares: the largest violation, since a sum would grow with the number of realisations."""
    return float(np.abs(missed).max(initial=0.0))


# Most numbers of how tied variables follow the others: 2 GB.
_MOST_MOVES = 250_000_000


@final
@dataclass(frozen=True)
class Condensing(AbstractLocalSolver):
    """The primal-dual interior-point method with a filter line search, for programs with ties.

    The iterations are those of IPOPT (Wächter and Biegler 2006) with second-order corrections. In each, the variables
    that ties determine are eliminated: by levels, in which all realisations are solved at once, so that time grows in
    proportion to the number of realisations. A small dense system is left, in the other variables, whose eigenvalues
    say whether the curvature must be regularised.

    For programs with few variables that no tie determines (say up to a hundred), and a Hessian. IPOPT solves the
    others, and those where a tie does not determine its variable, where the system is too ill-conditioned (unstable
    realisations over a long time), or where no step is acceptable; the message then says why.

    - `tolerance`, `max_iterations`: see `AbstractLocalSolver`.
    """

    @property
    @override
    def name(self) -> str:
        return "condensing interior points"

    @override
    def minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        why, search = _unfit(scaled), None
        if not why:
            try:
                assert scaled.ties is not None
                search = Search(scaled, Elimination(scaled.ties, scaled.sparsity), self.aim)
                return search.run(multipliers, self.max_iterations, self.tolerance)
            except SingularTiesError as singular:
                why = str(singular)
            except IllConditionedError:
                why = "the condensed system is too ill-conditioned"
            except StuckError:
                why = "no step was acceptable"
        spent = 0 if search is None else search.iterations
        answer = Ipopt(self.tolerance, max(1, self.max_iterations - spent)).minimise(scaled, multipliers)
        return answer._replace(
            iterations=spent + answer.iterations, message=f"{answer.message} (by IPOPT, because {why})"
        )


def _unfit(scaled: ScaledProgram) -> str:
    """Why a program cannot be condensed; empty if it can."""
    if scaled.ties is None or not scaled.ties.rows.size:
        return "the program declares no ties"
    if scaled.curved is None or isinstance(scaled.sparsity, np.ndarray):
        return "the program declares no sparse Jacobian and Hessian"
    decided = scaled.size - scaled.ties.rows.size
    if decided * scaled.size > _MOST_MOVES:
        return f"{decided} variables that no tie determines are too many"
    return ""
