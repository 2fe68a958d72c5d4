"""`examine`: how a problem looks to a solver at one design: its slopes, its scales, and whether it is smooth there."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float

from aleator._core.border import refusal
from aleator._core.errors import SimulationError
from aleator._core.leaves import Printed
from aleator.design import Problem, statistics_in
from aleator.nlp import Searched, Slopes, lost_variables, slopes_at
from aleator.solution import Solution
from aleator.statistics import AbstractTail
from aleator.transcription import DEFAULT, AbstractTranscribed, bound_size, transcribe

# A row or a decision whose largest effect is beyond these factors of the others' middle one is badly scaled.
_WEAK, _STRONG = 1e-6, 1e6
# Effects, and instants, that are named at most.
_NAMED = 3

_SWITCH = (
    "Make it smooth, or use a solver without derivatives. A switching time that the equations compare with t is one: "
    "blend both sides over a step, as jax.nn.sigmoid((t - T) / width) does"
)
_ROUND = "Round it (smoothing=...), or limit each part of a largest or absolute value"
_TAILS = (
    "Tails are found along lines that end where bounded numbers do: limit cornish_fisher(level), or mean and spread "
    "(sigmas=...), which are smooth"
)


@final
@dataclass(frozen=True)
class Examination(Printed):
    """What a solver meets at one design. `print(examination)` says it.

    - `rows`: the objective, then each constraint, as mathematics; `decisions`: their names, entry by entry;
    - `tails`: those rows that hold probabilities, quantiles or means of tails;
    - `effects`: by how much each row changes, relative to its own magnitude, over a typical magnitude of each decision:
      shape (rows, decisions), of a path the largest over time. Near a bound of zero, where a row has no magnitude, its
      largest change takes the place;
    - `kinks`, `jumps`, `wrong`: pairs of a row and a decision, in words, at which slopes to both sides differ, values
      jump, and the exact derivative is not the slope that is seen;
    - `endless`: pairs, in words, at which the derivative is infinite or not a number, so that no solver can go on;
    - `unfit`: rows and decisions whose scale is far from that of the others, in words;
    - `violations`: of the constraints that do not hold, in words;
    - `history`: what the solver evaluated on its way; None for a problem that was not solved.
    """

    rows: tuple[str, ...]
    decisions: tuple[str, ...]
    tails: tuple[str, ...]
    effects: Float[np.ndarray, "rows decisions"]
    kinks: tuple[str, ...]
    jumps: tuple[str, ...]
    wrong: tuple[str, ...]
    endless: tuple[str, ...]
    unfit: tuple[str, ...]
    violations: tuple[str, ...]
    history: Searched | None

    @property
    def ok(self) -> bool:
        """Whether nothing was found that stops a gradient solver."""
        return not (self.kinks or self.jumps or self.wrong or self.endless or self.unfit)

    def __str__(self) -> str:
        found = [
            *(f"kink: {one}. {_TAILS if one.startswith(self.tails) else _ROUND}" for one in self.kinks),
            *(f"jump: {one}. {_SWITCH}" for one in self.jumps),
            *(
                f"wrong derivative: {one}. Look for stop_gradient, rounding, a custom rule or a switching time there"
                for one in self.wrong
            ),
            *(
                f"no finite derivative: {one}. Keep the design away from there by a bound, or square the root"
                for one in self.endless
            ),
            *(f"scale: {one}" for one in self.unfit),
        ]
        return "\n".join(
            [
                "change of each row, relative to its magnitude, over a typical magnitude of each decision:",
                *self._strongest(),
                *([f"does not hold: {one}" for one in self.violations]),
                *(found or ["smooth here, derivatives agree with differences, and scales are alike"]),
                *([str(self.history)] if self.history else []),
            ]
        )

    def _strongest(self) -> Iterator[str]:
        for row, effects in zip(self.rows, self.effects, strict=True):
            order = np.argsort(-np.nan_to_num(effects), kind="stable")[:_NAMED]
            shown = ", ".join(f"{effects[i]:.2g} by {self.decisions[i]}" for i in order)
            more = f" and {len(effects) - _NAMED} others" if len(effects) > _NAMED else ""
            yield f"  {row}: {shown}{more}"


def examine(subject: Problem | Solution) -> Examination:
    """Look at a problem around one design as a gradient solver does: before a solve, or after one that failed.

    Exact derivatives are compared with the slopes seen over steps of three lengths to both sides of each decision
    (eight evaluations a decision), which tells kinks, jumps and wrong derivatives; where one is suspected, smaller
    steps (up to 32 more evaluations) tell it from a function that is merely steep. Effects tell what is badly scaled.

    - `subject`: a problem, at its initial decisions, or a solution, at its own, even one that failed
      (`error.solution`). States are simulated.

    Raises `ProblemError` for anything else, and `SimulationError` if the objective or a constraint is not finite there.
    """
    if not isinstance(subject, Problem | Solution):
        raise refusal("examine", "a problem, or a solution such as that of al.solve(problem, throw=False)", subject)
    solution = subject if isinstance(subject, Solution) else None
    problem = subject.problem if isinstance(subject, Solution) else subject
    transcribed = transcribe(problem, DEFAULT)
    point = transcribed.program.start if solution is None else np.asarray(solution.vector)
    rows, decisions, blocks = _rows(transcribed), tuple(transcribed.places.entry_names()), _blocks(transcribed)
    _refuse_unknown(transcribed, point)
    slopes = slopes_at(transcribed.program, point)
    effects = _effects(transcribed, point, slopes)
    hidden = np.array([slopes.endless[own].any(axis=0) for own in blocks])
    named = tuple(zip(rows, blocks, strict=True))
    told = {
        name: tuple(_pairs(named, decisions, slopes, getattr(slopes, name)))
        for name in ("kinks", "jumps", "wrong", "endless")
    }
    told["wrong"] = told["wrong"] or tuple(_lost(transcribed, point, rows[0], decisions))
    return Examination(
        rows=rows,
        decisions=decisions,
        tails=tuple(row for row, has_tail in zip(rows, _tails(transcribed.problem), strict=True) if has_tail),
        effects=effects,
        **told,
        unfit=(*_unfit("", rows, effects, hidden), *_unfit("the decision ", decisions, effects.T, hidden.T)),
        violations=() if solution is None else tuple(one.sentence() for one in solution.violated),
        history=None if solution is None else solution.effort.visited,
    )


def _rows(transcribed: AbstractTranscribed) -> tuple[str, ...]:
    """The objective and each constraint, as mathematics."""
    return (f"objective {transcribed.problem.objective}", *map(str, transcribed.problem.constraints))


def _tails(problem: Problem) -> Iterator[bool]:
    """Whether the objective, and each constraint, holds a statistic of a tail."""
    for one in (problem.objective, *(limit.expression for limit in problem.constraints)):
        yield any(isinstance(each.kind, AbstractTail) for each in statistics_in((one,)))


def _lost(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " n"], objective: str, decisions: tuple[str, ...]
) -> Iterator[str]:
    """Where the objective changes without a slope, too coarsely for the steps that tell slopes."""
    program = transcribed.program
    lost = set(lost_variables(program, point, program.evaluate(point)))
    for name, i in zip(decisions, transcribed.decided.tolist(), strict=True):
        if i in lost:
            yield f"{objective}, by {name}: it changes further away, although its derivative is zero there and here"


def _refuse_unknown(transcribed: AbstractTranscribed, point: Float[np.ndarray, " n"]) -> None:
    """Raise `SimulationError` if a row is not finite at a point, where nothing can be said of its slopes."""
    found = transcribed.program.evaluate(point)
    finite = np.isfinite(np.append(found.objective, found.constraints))
    unknown = [row for row, own in zip(_rows(transcribed), _blocks(transcribed), strict=True) if not finite[own].all()]
    if unknown:
        more = f" and {len(unknown) - _NAMED} others" if len(unknown) > _NAMED else ""
        where = transcribed.decisions(point)
        decided = ", ".join(
            f"{name} = {one:.6g}" for name, one in zip(transcribed.places.entry_names(), where, strict=True)
        )
        raise SimulationError(
            f"examine: expected a design at which all rows are finite; not finite here: {'; '.join(unknown[:_NAMED])}"
            f"{more}. Look for a root or logarithm of zero, or a division by zero, and start elsewhere. The decisions "
            f"are {decided}."
        )


def _blocks(transcribed: AbstractTranscribed) -> list[slice]:
    """The rows of the objective and of each constraint among all rows."""
    return [slice(0, 1), *(slice(1 + one.start, 1 + one.stop) for one in transcribed.rows)]


def _effects(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " n"], slopes: Slopes
) -> Float[np.ndarray, "rows decisions"]:
    """The largest slope of each row, relative to its magnitude there, as `Examination.effects` says."""
    problem, meaning = transcribed.problem, transcribed.at(point)
    values = [np.array([meaning.objective]), *meaning.constraints]
    bounds = [0.0, *(bound_size(one) for one in problem.constraints)]
    found = []
    for where, value, bound in zip(_blocks(transcribed), values, bounds, strict=True):
        changes = slopes.effects[where].max(axis=0, initial=0.0)
        largest = float(np.abs(value).max(initial=0.0))
        size = max(bound, largest) if bound else max(largest, float(changes.max(initial=0.0)))
        found.append(changes / (size or 1.0))
    return np.array(found)


def _unfit(
    what: str,
    names: tuple[str, ...],
    effects: Float[np.ndarray, "names others"],
    hidden: Bool[np.ndarray, "names others"],
) -> Iterator[str]:
    """Rows, or decisions, whose largest effect is far from the middle of all, unless a slope `hidden` is unknown."""
    largest = effects.max(axis=1, initial=0.0)
    known = largest[largest > 0]
    middle = float(np.median(known)) if known.size else 0.0
    for name, one, is_unknown in zip(names, largest, np.atleast_1d(hidden.any(axis=1)), strict=True):
        if is_unknown:
            continue
        if one == 0:
            yield f"{what}{name} has no effect here" if what else f"{name} is changed by no decision here"
        elif not _WEAK * middle <= one <= _STRONG * middle:
            yield f"{what}{name} {'changes things' if what else 'changes'} by {one:.1e}, others by about {middle:.1e}"


def _pairs(
    rows: Sequence[tuple[str, slice]], decisions: tuple[str, ...], slopes: Slopes, flags: np.ndarray
) -> Iterator[str]:
    """The rows, by their blocks among all, and decisions that are flagged, with the slopes that were seen."""
    for row, where in rows:
        for i in np.flatnonzero(flags[where].any(axis=0)):
            k = where.start + int(np.argmax(flags[where][:, i]))
            seen = f"{slopes.left[k, i]:.3g} below, {slopes.right[k, i]:.3g} above"
            instants = int(flags[where][:, i].sum())
            more = f" at {instants} of its {where.stop - where.start} rows" if where.stop - where.start > 1 else ""
            yield (
                f"{row}, by {decisions[i]}{more}: over a typical magnitude of it, {seen}, "
                f"{slopes.exact[k, i]:.3g} by the derivative"
            )
