"""`conflict`: the limits of a problem that cannot hold together, and what relaxing each would cost."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from aleator._core.border import Progress, one_of, silent
from aleator._core.errors import SimulationError
from aleator._core.leaves import Printed
from aleator.certification import diagnose
from aleator.design import Problem, in_quantiles, is_at_points, is_worst_case, path_of
from aleator.ensemble import inputs_at
from aleator.nlp import HELD, AbstractSolver, Excess, Ipopt, least_excess, variable_range
from aleator.solution import system_text
from aleator.sweep._runner import running
from aleator.transcription import DEFAULT, AbstractTranscribed, germ_box, rows_by_name, transcribe

# Added where a claim rests on searches that were stopped.
_NOT_SHOWN = "not shown: some searches were stopped, as where the model is not finite; a design may exist all the same"
# Points in the range of the decisions that are tried where the model is not finite at a start.
_TRIED = 64
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
        alone = f"relaxed alone, by {self.relaxed:.4g}" if np.isfinite(self.relaxed) else "not enough alone"
        alone = "whether it is enough alone is not known" if np.isnan(self.relaxed) else alone
        return f"{self.name}: {'; '.join(self.texts)}{when}: {alone}"


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
        several = "these limits together, though any of them can be left out"
        rows = [f"no design found that meets {several if len(self.limits) > 1 else 'this limit'}:"]
        rows += [f"  {one}" for one in self.limits]
        rows += [f"decisions at their bounds there: {', '.join(self.decisions)}"] if self.decisions else []
        return "\n".join([*rows, *([] if self.shown else [_NOT_SHOWN])])


def conflict(problem: Problem, *, solver: AbstractSolver | None = None, progress: Progress = silent) -> Conflict:
    """Find a smallest set of limits that cannot hold together, and by how much each would have to be relaxed.

    Limits are made elastic: each may be exceeded by a slack, and the sum of these is least. Where it is not zero, one
    limit after the other is left out as long as the others still contradict each other (the deletion filter, Chinneck
    and Dravnieks 1991). Nothing is compiled anew. Searches are local, from several starts: for a problem that is not
    convex, "cannot" means that none of them found a design. Limits on the worst case are imposed at the collocation
    points and at corners of the distributions' box, not searched for: that they can hold there is no proof. Integers
    and choices may be anywhere between their bounds: what conflicts there conflicts for their values too, but not the
    other way round. A limit on a probability, which is 0 or 1 nearly everywhere, is searched and shown as that on a
    quantile which says the same.

    - `problem`: as declared, states being simulated; `solver`: `al.solvers.Ipopt()` by default, since elastic programs
      are almost linear, where others know no length of a step.

    Where the model is not finite at a start, searches begin at points elsewhere at which it is. Raises `ProblemError`
    if a limit contradicts itself or cannot be met by any decision at all, `SimulationError` if the model is finite at
    none of these.
    """
    one_of("conflict: problem", problem, Problem)
    solver = Ipopt() if solver is None else one_of("conflict: solver", solver, AbstractSolver)
    transcribed = _with_corners(transcribe(in_quantiles(problem), DEFAULT))
    starts, names, constraints = _finite_starts(transcribed), problem.names, transcribed.problem.constraints
    # Groups are the constraints of one name; excesses are relative to the largest of their magnitudes.
    of_name = [[i for i, one in enumerate(constraints) if one.name == name] for name in names]
    groups = rows_by_name(transcribed)
    every, left, done = list(range(len(names))), list[int](), 0
    with running("conflict", lambda: False, progress) as run:

        def least(loose: Sequence[int], held: Sequence[int] = ()) -> Excess:
            """The least total excess of the `loose` groups while those `held` hold, without the others."""
            with run.step("limits", done, len(names), "least excess"):
                return least_excess(solver.local, transcribed.program, groups, held, loose, starts)

        searches = [least(every)]
        starts.insert(0, searches[0].point)
        if searches[0].total > HELD:
            pushing = [i for i in every if len(searches[0].pushing[i])]
            searches.append(least(pushing))
            left = pushing if searches[-1].total > HELD else every
            for done, which in enumerate(tuple(left)):  # noqa: B007 -- `least` tells it
                without = [other for other in left if other != which]
                searches.append(least(without))
                left = without if searches[-1].total > HELD else left
            searches.append(least(left))
        together, bounds = searches[-1], searches[-1].bounds[transcribed.decided]
        alone = [least((which,), [other for other in every if other != which]) for which in left]
    limits = [
        _limit(transcribed, names[which], of_name[which], together, excess, groups[which][1])
        for which, excess in zip(left, alone, strict=True)
    ]
    return Conflict(
        limits=tuple(limits),
        decisions=tuple(np.array(transcribed.places.entry_names())[bounds].tolist()) if left else (),
        least=searches[0].total if left else 0.0,
        nearest=transcribed.places.named(transcribed.decisions(searches[0].point)),
        shown=all(one.is_shown for one in searches),
    )


def _limit(
    transcribed: AbstractTranscribed, name: str, own: Sequence[int], together: Excess, alone: Excess, size: float
) -> Limit:
    """One limit of a conflict: where it is in the way, and what it would have to be relaxed by, `alone` among all."""
    in_the_way = {i: np.isin(_rows(transcribed, i), np.concatenate(together.pushing)) for i in own}
    pushing = [i for i in own if in_the_way[i].any()] or own
    scenarios, decisions = transcribed.scenarios, jnp.asarray(transcribed.decisions(together.point))
    times, systems = set[float](), list[Mapping[str, float]]()
    for i in pushing:
        constraint = transcribed.problem.constraints[i]
        if constraint.is_path:
            instants = transcribed.times_limited(together.point, path_of(constraint))
            times.update(instants[in_the_way[i].reshape(len(instants), -1).any(axis=1)].tolist())
        if scenarios is not None and (is_worst_case(constraint) or is_at_points(constraint)):
            slots = in_the_way[i].reshape(-1, len(scenarios.used)).any(axis=0)
            points = [scenarios.points[slot] for slot in np.flatnonzero(slots)]
            systems += [inputs_at(transcribed.places, point, decisions) for point in points]
    return Limit(
        name=name,
        texts=tuple(str(transcribed.problem.constraints[i]) for i in pushing),
        times=tuple(sorted(times)),
        relaxed=size * (alone.total if np.isfinite(alone.total) or alone.is_shown else np.nan),
        systems=tuple(systems),
    )


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


def _finite_starts(transcribed: AbstractTranscribed) -> list[Float[np.ndarray, " n"]]:
    """The start and the middle of the range; in the place of one at which the model is not finite, a random point."""
    program = transcribed.program
    lower, upper = variable_range(program.start, program.lower, program.upper, program.variable_scale)
    drawn = np.random.default_rng(0).uniform(lower, upper, (_TRIED, lower.size))
    points = (program.start, (lower + upper) / 2, *drawn)
    finite = list(itertools.islice((one for one in points if program.evaluate(one).is_finite), 2))
    if not finite:
        raise SimulationError(
            f"conflict: the model is finite neither at the start nor at {_TRIED} other designs, so that nothing can be "
            f"said of its limits. {diagnose(transcribed, transcribed.decisions(program.start))}"
        )
    return finite


def _rows(transcribed: AbstractTranscribed, constraint: int) -> Int[np.ndarray, " rows"]:
    where = transcribed.rows[constraint]
    return np.arange(where.start, where.stop)
