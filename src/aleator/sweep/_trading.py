"""`trade_off`: designs of which none is better in one wish without being worse in another."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from typing import get_args

import numpy as np
from jaxtyping import Float

from aleator._core.border import Progress, a_name, one_of, refusal, silent, whole
from aleator._core.errors import ProblemError
from aleator._core.parallel import heeding
from aleator.design import Expression, Problem
from aleator.nlp import AbstractSolver, load_pymoo, population_front
from aleator.sweep._runner import Runner, running
from aleator.sweep._seeking import Member, Method, Search
from aleator.sweep._trade_off import TradeOff, efficient, far_apart
from aleator.sweep._wishes import LEVEL, Design, Wishes, without_level
from aleator.transcription import DEFAULT, AbstractTranscription, transcribe, valued_by
from aleator.uncertainty import refuse_choices

# Violations of at most this part of a constraint's magnitude count as none.
_HELD = 1e-6


def trade_off(
    problem: Problem,
    wishes: Mapping[str, Expression],
    points: int = 15,
    *,
    method: Method = "boundary",
    starts: int = 1,
    evaluations: int = 5000,
    seed: int = 0,
    solver: AbstractSolver | None = None,
    transcription: AbstractTranscription = DEFAULT,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> TradeOff:
    """Find designs of which none is better in one wish without being worse in another.

    - `problem`: its model and its constraints; its own objective does not count, nor penalties in it (`al.soft`);
    - `wishes`: expressions to be small, by name, two or more (use `-x` for a large one); `points`: designs to look for,
      the best ones of the wishes included. There are fewer where some turn out to be the same, as `print` tells, and
      about so many by `"limits"` with three wishes or more, whose values form a grid;
    - `method`: how points are chosen. `"boundary"`: along parallel lines from between the best designs of each wish
      towards better ones (normal boundary intersection, Das and Dennis 1998, in the form of Pascoletti and Serafini
      1984), where fronts may be concave; for two wishes the largest gaps are filled, until they are proven holes. For
      three or more, parts of the front that lie beyond the best designs are not reached, unless these coincide: lines
      then cross the whole box between best and worst.
      `"limits"`: the first wish, with limits on the others (Haimes et al. 1971), two wishes or more. `"weights"`:
      weighted sums, which find convex parts of a front alone. `"population"`: a population spreads over the whole front
      (NSGA-II, Deb et al. 2002, of the extra `fronts`), for fronts in parts and designs in many basins; its designs are
      starts of lines through them, which lead to the front itself. A small share of all wishes in every objective keeps
      designs away at which a wish could be better at no cost (Mavrotas 2009);
    - `solver`, `transcription`: those of `al.solve`, which certifies every point. Each point starts from its nearest
      neighbour, from the problem's own start where that fails, and then by `al.solvers.Slsqp()` unless a solver is
      given. One that ends at a known design is sought again from between its neighbours;
    - `starts`: local searches for each point, all but one from random starts, for problems with several optima, whose
      fronts may be in parts; the best designs of the wishes are then searched for globally (see `al.portfolio`);
    - `evaluations`, `seed`: of a population: simulated designs, and its random numbers;
    - `executor`: simulates the generations of a population, and does the local searches of `starts` at once (see
      `al.pareto`), with the same front.

    At the best design of a wish, the others are improved as far as they can be without making it worse (lexicographic
    order). Everything is compiled once. Ctrl-C returns the points found so far; in a population it ends that, whose
    designs until then lead to points, and a second one ends these. Raises `ProblemError` for fewer than two wishes, for
    one that no decision changes, if the best design of some wish cannot be found, for a limit whose price (`al.soft`
    with `exact=True`) would not count, and for decisions without bounds if a population is asked for. Names of
    constraints that begin with `trade-off` are its own.
    """
    refuse_choices("trade_off", one_of("trade_off: problem", problem, Problem).placements)
    _check_wishes(problem, wishes)
    points = whole("trade_off: points", points, least=len(wishes))
    starts = whole("trade_off: starts", starts)
    if method not in get_args(Method):
        raise refusal("trade_off: method", '"boundary", "limits", "weights" or "population"', method)
    evaluations, seed = whole("trade_off: evaluations", evaluations), whole("trade_off: seed", seed, least=0)
    if method == "population":
        _check_population(problem)
    elif executor is not None and starts == 1:
        raise ProblemError(
            'trade_off: executor: expected method="population" or starts= of at least 2, whose simulations or searches '
            f"can be shared; received method={method!r} with one start, where each design follows from those before."
        )
    one_of("trade_off: transcription", transcription, AbstractTranscription, "al.Sequential()")
    search = Search(Wishes(problem, wishes), points, transcription, solver, starts, executor)
    with running("trade_off", lambda: search.designs, progress, executor) as run:
        search.find_anchors(run)
        if method == "population":
            further = points - len(wishes)
            search.crowd = _crowd(search.wishes, search.designs, further, evaluations, seed, run)
        search.find_further(run, method)
    return search.result(run.interrupted)


def _check_wishes(problem: Problem, wishes: Mapping[str, Expression]) -> None:
    """Refuse what are no wishes by name, and prices in the problem's objective, which would not count."""
    if not isinstance(wishes, Mapping) or len(wishes) < 2:
        raise refusal(
            "trade_off: wishes", "two expressions or more by name, such as {'ride': ..., 'cost': ...}", wishes
        )
    for name, one in wishes.items():
        one_of(f"trade_off: wish '{a_name('trade_off: the name of a wish', name)}'", one, Expression)
    for name in problem.names:
        excess = f"{name}.excess"
        if excess in problem.placements.decisions and not any(excess in str(one) for one in wishes.values()):
            raise ProblemError(
                f"trade_off: problem: the price of the soft limit '{name}' is in the objective, which does not count "
                f"here, so that nothing would hold it: add al.value('{excess}') to a wish, or give the problem before "
                "al.soft."
            )


def _check_population(problem: Problem) -> None:
    """Raise `ProblemError` for decisions without finite bounds, `MissingExtraError` without the library."""
    load_pymoo('trade_off: method="population"')
    places = problem.placements
    is_open = ~np.isfinite(places.vector("upper") - places.vector("lower"))
    if is_open.any():
        name = places.entry_names()[int(np.argmax(is_open))]
        raise ProblemError(
            f"trade_off: method=\"population\" draws designs between the bounds of decisions, of which '{name}' has "
            'none: give it lower= and upper=, or use method="boundary".'
        )


def _crowd(
    wishes: Wishes, anchors: Sequence[Design], points: int, evaluations: int, seed: int, run: Runner
) -> list[Member]:
    """Designs of a population spread over the front, at most `points`, as far from one another as can be.

    Ctrl-C only ends the population. `anchors`: the best designs of the wishes, of its first generation.
    """
    transcribed = transcribe(wishes.compromise(np.ones(len(wishes.names))).problem, DEFAULT)
    program, places = valued_by(run.executor, transcribed.program, "trade_off"), transcribed.places
    is_free = np.array([name != LEVEL for name in places.entry_names()])
    rows = wishes.rows(transcribed)
    seen: list[tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k wishes"]]] = []

    def values(free: Float[np.ndarray, "k n"]) -> tuple[np.ndarray, np.ndarray]:
        """The wishes, and the largest violations over the magnitudes of the constraints."""
        assert program.values is not None
        every = np.repeat(program.start[None], len(free), axis=0)
        every[:, is_free] = free
        _, constraints = program.values(every)
        beyond = np.fmax(constraints - program.constraint_upper, program.constraint_lower - constraints)
        worst = np.max(beyond / program.constraint_scale, axis=1, initial=0.0)
        violations = np.where(np.isfinite(constraints).all(axis=1), worst, np.inf)
        held = violations <= _HELD
        seen.append((every[held], constraints[held][:, rows]))
        return constraints[:, rows], violations

    first = np.array([places.moved(program.start, without_level(one.solution.decisions)) for one in anchors])
    try:
        with heeding(alone=True) as answer:

            def heed(done: int) -> None:
                run.progress("population", done, evaluations)
                answer()

            bounds = program.lower[is_free], program.upper[is_free]
            how = {"points": points, "evaluations": evaluations, "seed": seed, "heed": heed}
            population_front(values, *bounds, first[:, is_free], **how)
    except KeyboardInterrupt:
        if not seen:
            raise
        run.interrupted = True
    every, reached = (np.concatenate(part) for part in zip(*seen, strict=True))
    is_best = efficient(reached, np.zeros(len(wishes.names)))
    every, reached = every[is_best], reached[is_best]
    # The anchors are on the front already.
    known = np.array([one.values for one in anchors])
    chosen = far_apart(np.concatenate([known, reached]), points, taken=len(known))
    return [Member(reached[i - len(known)], places.named(every[i - len(known)])) for i in chosen]
