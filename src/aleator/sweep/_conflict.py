"""`conflict`: the limits of a problem that cannot hold together, and what relaxing each would cost."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from aleator._core.border import Progress, check_progress, one_of, silent
from aleator._core.errors import SimulationError
from aleator._core.interruption import heeding
from aleator._core.leaves import Printed
from aleator.certification import diagnose
from aleator.design import Problem, is_at_points, is_worst_case
from aleator.ensemble import inputs_at
from aleator.nlp import HELD, AbstractSolver, Excess, Ipopt, NonlinearProgram, least_excess, variable_range
from aleator.solution import system_text
from aleator.transcription import DEFAULT, AbstractTranscribed, bound_size, germ_box, transcribe

# Added where a claim rests on searches that were stopped.
_NOT_SHOWN = "not shown: some searches were stopped, as where the model is not finite; a design may exist all the same"
# Points in the range of the decisions that are tried where the model is not finite at a start, and how many of those at
# which it is are starts.
_TRIED, _KEPT = 64, 4
# Instants that are named at most.
_NAMED = 3
# Corners of the germ's box at which limits on the worst case are imposed at most.
_CORNERS = 64


@final
@dataclass(frozen=True)
class Limit(Printed):
    """A limit in a conflict: all constraints of one name.

    - `name`, `texts`: of its constraints that are in the way of the others;
    - `times`: the instants (s) at which they are; empty for one that has none;
    - `systems`: the realisations at which they are, by the values of their uncertain numbers; empty for limits on
      statistics;
    - `relaxed`: by how much its bounds alone would have to move, in their unit, for all limits of the problem to hold;
      infinite if that does not suffice, NaN if that is not known, because the search could not go on.
    """

    name: str
    texts: tuple[str, ...]
    times: tuple[float, ...]
    relaxed: float
    systems: tuple[Mapping[str, float], ...] = ()

    def __str__(self) -> str:
        shown = ", ".join(f"{time:.4g}" for time in self.times[:_NAMED])
        more = f" and {len(self.times) - _NAMED} other instants" if len(self.times) > _NAMED else ""
        when = f" at t = {shown} s{more}" if self.times else ""
        others = f" and {len(self.systems) - 1} other systems" if len(self.systems) > 1 else ""
        when += f" with {system_text(self.systems[0])}{others}" if self.systems else ""
        return f"{self.name}: {'; '.join(self.texts)}{when}: {self._alone()}"

    def _alone(self) -> str:
        if np.isnan(self.relaxed):
            return "whether it is enough alone is not known"
        return f"relaxed alone, by {self.relaxed:.4g}" if np.isfinite(self.relaxed) else "not enough alone"


@final
@dataclass(frozen=True)
class Conflict(Printed):
    """Why a problem has no design. `print(conflict)` says it.

    - `limits`: a smallest set of limits that cannot hold together: without any one of them, the others can. Empty if
      all limits of the problem can hold;
    - `decisions`: decisions whose bounds keep the least violated design from being better;
    - `least`: the least sum of the limits' excesses, each relative to its magnitude; `nearest`: the decisions there;
    - `shown`: whether every search ended at a least excess. If not, the model stopped one where it is not finite, or it
      did not end, and there may be a design all the same.
    """

    limits: tuple[Limit, ...]
    decisions: tuple[str, ...]
    least: float
    nearest: dict[str, float | Float[np.ndarray, "..."]]
    shown: bool = True

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the limits that cannot hold together."""
        return tuple(one.name for one in self.limits)

    def __str__(self) -> str:
        if not self.limits:
            return "All limits can hold together, as at: " + ", ".join(f"{k} = {v}" for k, v in self.nearest.items())
        one = len(self.limits) == 1
        heading = "this limit:" if one else "these limits together, though any of them can be left out:"
        bounds = f"decisions at their bounds there: {', '.join(self.decisions)}" if self.decisions else ""
        return "\n".join(
            [
                f"no design found that meets {heading}",
                *(f"  {one}" for one in self.limits),
                *([bounds] if bounds else []),
                *([] if self.shown else [_NOT_SHOWN]),
            ]
        )


def conflict(problem: Problem, *, solver: AbstractSolver | None = None, progress: Progress = silent) -> Conflict:
    """Find a smallest set of limits that cannot hold together, and by how much each would have to be relaxed.

    Limits are made elastic: each may be exceeded by a slack, and the sum of these is least. Where it is not zero, one
    limit after the other is left out as long as the others still contradict each other (the deletion filter, Chinneck
    and Dravnieks 1991). Nothing is compiled anew. Searches are local, from several starts: for a problem that is not
    convex, "cannot" means that none of them found a design. Limits on the worst case are imposed at the collocation
    points and at corners of the distributions' box, not searched for: that they can hold there is no proof.

    - `problem`: as declared, states being simulated; `solver`: `al.solvers.Ipopt()` by default, since elastic programs
      are almost linear, where others know no length of a step.

    Where the model is not finite at a start, searches begin at points elsewhere at which it is. Raises `ProblemError`
    if a limit contradicts itself or cannot be met by any decision at all, `SimulationError` if the model is finite at
    none of these.
    """
    one_of("conflict: problem", problem, Problem)
    check_progress("conflict", progress)
    solver = Ipopt() if solver is None else one_of("conflict: solver", solver, AbstractSolver)
    transcribed = _with_corners(transcribe(problem, DEFAULT))
    with heeding() as heed:
        return _Search(transcribed, solver.local, progress, heed).conflict()


@final
class _Search:
    """A search for a conflict; groups are the names of a problem's constraints, in order."""

    def __init__(
        self,
        transcribed: AbstractTranscribed,
        solver: AbstractSolver,
        progress: Progress,
        heed: Callable[[], None],
    ):
        self._transcribed, self._solver, self._progress, self._heed = transcribed, solver, progress, heed
        problem, program = transcribed.problem, transcribed.program
        self._names = problem.names
        self._of_name = [[i for i, one in enumerate(problem.constraints) if one.name == name] for name in self._names]
        self._sizes = [self._size(own) for own in self._of_name]
        self._groups = [
            (np.concatenate([np.arange(program.start.size)[:0], *(_rows(transcribed, i) for i in own)]), size)
            for own, size in zip(self._of_name, self._sizes, strict=True)
        ]
        self._starts = _finite_starts(program)
        if not self._starts:
            raise SimulationError(
                f"conflict: the model is finite neither at the start nor at {_TRIED} other designs, so that nothing "
                f"can be said of its limits. {diagnose(transcribed, transcribed.decisions(program.start))}"
            )
        self._shown = True

    def conflict(self) -> Conflict:
        """The conflict of the problem's limits."""
        every = list(range(len(self._names)))
        least = self._least(every)
        self._starts.insert(0, least.point)
        if least.total <= HELD:
            return self._told((), least)
        pushing = [i for i in every if len(least.pushing[i])]
        left = pushing if self._least(pushing).total > HELD else every
        for done, one in enumerate(tuple(left)):
            self._progress("limits", done, len(every))
            without = [other for other in left if other != one]
            if self._least(without).total > HELD:
                left = without
        return self._told(tuple(left), least)

    def _told(self, members: Sequence[int], least: Excess) -> Conflict:
        names = np.array(self._transcribed.places.entry_names())
        together = self._least(members) if members else least
        return Conflict(
            tuple(self._limit(one, together) for one in members),
            tuple(names[together.bounds[self._transcribed.decided]].tolist()) if members else (),
            least.total if members else 0.0,
            self._transcribed.places.named(self._transcribed.decisions(least.point)),
            self._shown,
        )

    def _least(self, elastic: Sequence[int], held: Sequence[int] = ()) -> Excess:
        least = self._least_excess(elastic, held)
        self._shown = self._shown and least.is_shown
        return least

    def _least_excess(self, loose: Sequence[int], held: Sequence[int]) -> Excess:
        """The least total excess of the `loose` groups while those `held` hold, whether shown or not."""
        self._heed()
        return least_excess(self._solver, self._transcribed.program, self._groups, held, loose, self._starts)

    def _limit(self, which: int, together: Excess) -> Limit:
        """One limit of the conflict, with what it would have to be relaxed by, alone among all."""
        transcribed, rows = self._transcribed, set(together.pushing[which].tolist())
        own = self._of_name[which]
        pushing = [i for i in own if rows & set(_rows(transcribed, i).tolist())] or own
        others = [one for one in range(len(self._names)) if one != which]
        alone = self._least_excess((which,), others)
        relaxed = alone.total if np.isfinite(alone.total) or alone.is_shown else np.nan
        times = sorted({time for i in pushing for time in self._times(i, together)})
        texts = tuple(transcribed.texts.constraints[i] for i in pushing)
        systems = [one for i in pushing for one in self._systems(i, together)]
        return Limit(self._names[which], texts, tuple(times), relaxed * self._sizes[which], tuple(systems))

    def _times(self, constraint: int, together: Excess) -> list[float]:
        """The instants at which a limit over time is in the way."""
        transcribed = self._transcribed
        if not transcribed.problem.constraints[constraint].is_path:
            return []
        rows, times = _rows(transcribed, constraint), transcribed.at(together.point).times
        every = np.concatenate(together.pushing)
        held = np.isin(rows, every).reshape(len(times), -1).any(axis=1)
        return times[held].tolist()

    def _systems(self, constraint: int, together: Excess) -> list[Mapping[str, float]]:
        """The realisations at which a limit on these is in the way."""
        transcribed = self._transcribed
        own, scenarios = transcribed.problem.constraints[constraint], transcribed.scenarios
        if scenarios is None or not (is_worst_case(own) or is_at_points(own)):
            return []
        held = np.isin(_rows(transcribed, constraint), np.concatenate(together.pushing))
        slots = np.flatnonzero(held.reshape(-1, len(scenarios.used)).any(axis=0))
        decisions = transcribed.decisions(together.point)
        return [inputs_at(transcribed.places, scenarios.points[i], jnp.asarray(decisions)) for i in slots]

    def _size(self, own: Sequence[int]) -> float:
        """The magnitude to which excesses of some constraints are relative."""
        constraints, scales = self._transcribed.problem.constraints, self._transcribed.scales
        return max(bound_size(constraints[i]) or scales[i] for i in own)


def _with_corners(transcribed: AbstractTranscribed) -> AbstractTranscribed:
    """Limits on the worst case imposed at the collocation points and at some corners of the germ's box too."""
    problem, scenarios = transcribed.problem, transcribed.scenarios
    if scenarios is None or not any(map(is_worst_case, problem.constraints)) or not problem.placements.germs:
        return transcribed
    box = germ_box(problem)
    signs = itertools.islice(itertools.product((0, 1), repeat=len(box)), _CORNERS)
    corners = np.array([box[np.arange(len(box)), list(one)] for one in signs])
    points = np.concatenate([corners, np.asarray(transcribed.collocation.points)])
    return transcribed.at_scenarios(scenarios.joined(points, np.zeros(len(scenarios.used), dtype=bool)))


def _finite_starts(program: NonlinearProgram) -> list[Float[np.ndarray, " n"]]:
    """The start and the middle of the range; where the model is not finite at one, points of the range where it is."""
    lower, upper = variable_range(program.start, program.lower, program.upper, program.variable_scale)
    usual = [program.start, (lower + upper) / 2]
    starts = [one for one in usual if program.evaluate(one).is_finite]
    if len(starts) < len(usual):
        drawn = np.random.default_rng(0).uniform(lower, upper, (_TRIED, lower.size))
        starts += itertools.islice((one for one in drawn if program.evaluate(one).is_finite), _KEPT)
    return starts


def _rows(transcribed: AbstractTranscribed, constraint: int) -> Int[np.ndarray, " rows"]:
    where = transcribed.rows[constraint]
    return np.arange(where.start, where.stop)
