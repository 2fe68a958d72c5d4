"""`trade_off`: designs of which none is better in all wishes, and how their front is found."""

from collections.abc import Mapping
from concurrent.futures import Executor
from typing import get_args

from aleator._core.elsewhere import check_executor
from aleator._core.errors import ProblemError
from aleator._core.given import a_name, one_of, refusal, whole
from aleator._core.heard import heeding
from aleator._core.journalled import calling
from aleator._core.progress import Progress, check_progress, silent
from aleator.design import Expression, Problem
from aleator.nlp import AbstractSolver
from aleator.sweep._crowd import Budget, check_crowd
from aleator.sweep._fronting import FrontInTheMaking, Method
from aleator.sweep._seeking import Seeker
from aleator.sweep._trade_off import TradeOff
from aleator.sweep._wishes import Wishes, refuse_own_names
from aleator.transcription import DEFAULT, AbstractTranscription


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
    one that no decision changes, if the best design of some wish cannot be found, for a problem without decisions or
    with a limit whose price (`al.soft` with `exact=True`) would not count, and for decisions without bounds if a
    population is asked for.
    """
    one_of("trade_off: problem", problem, Problem)
    names = _names(wishes)
    points = whole("trade_off: points", points, least=len(names))
    starts = whole("trade_off: starts", starts)
    if method not in get_args(Method):
        raise refusal("trade_off: method", '"boundary", "limits", "weights" or "population"', method)
    budget = Budget(whole("trade_off: evaluations", evaluations), whole("trade_off: seed", seed, least=0), executor)
    check_executor("trade_off", executor)
    if executor is not None and method != "population" and starts == 1:
        raise ProblemError(
            'trade_off: executor: expected method="population" or starts= of at least 2, whose simulations or searches '
            f"can be shared; received method={method!r} with one start, where each design follows from those before."
        )
    if method == "population":
        check_crowd(problem)
    check_progress("trade_off", progress)
    one_of("trade_off: transcription", transcription, AbstractTranscription, "al.Sequential()")
    _check_problem(problem, wishes)
    front = FrontInTheMaking(Wishes(problem, wishes), Seeker(transcription, solver, starts, executor), points)
    interrupted = True
    try:
        with heeding() as heed:
            with calling("best of each wish"):
                front.anchors.find(lambda done: progress("best of each wish", done, len(names)), heed)
            stopped = method == "population" and front.spread(
                budget, lambda done: progress("population", done, evaluations)
            )
            for one in front.problems(method):
                progress("trade-off", front.done, points)
                with calling(f"trade-off, point {front.done + 1}"):
                    front.add(one)
                heed()
        interrupted = stopped
    except KeyboardInterrupt:
        if not front.anchors.designs:
            raise
    return front.told(interrupted)


def _names(wishes: Mapping[str, Expression]) -> tuple[str, ...]:
    if not isinstance(wishes, Mapping) or len(wishes) < 2:
        raise refusal(
            "trade_off: wishes", "two expressions or more by name, such as {'ride': ..., 'cost': ...}", wishes
        )
    for name, one in wishes.items():
        if not a_name("trade_off: the name of a wish", name).isprintable():
            raise refusal("trade_off: the name of a wish", "a name of one line", name)
        one_of(f"trade_off: wish '{name}'", one, Expression)
    return tuple(wishes)


def _check_problem(problem: Problem, wishes: Mapping[str, Expression]) -> None:
    """Refuse problems without decisions, with names that are needed here, or with prices that would not count."""
    decisions = problem.placements.decisions
    if not decisions:
        raise ProblemError(
            "trade_off: the problem has no decisions: put al.Decision(initial, lower, upper) in the place of a number."
        )
    refuse_own_names(problem)
    for name in problem.names:
        excess = f"{name}.excess"
        if excess in decisions and not any(excess in str(one) for one in wishes.values()):
            raise ProblemError(
                f"trade_off: problem: the price of the soft limit '{name}' is in the objective, which does not count "
                f"here, so that nothing would hold it: add al.value('{excess}') to a wish, or give the problem before "
                "al.soft."
            )
