"""A population that spreads over a front: designs from which lines lead to the front itself."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator.design import Problem
from aleator.nlp import NonlinearProgram, load_pymoo, population_front
from aleator.solution import Solution
from aleator.sweep._wishes import LEVEL, Wishes, pressed
from aleator.transcription import DEFAULT, AbstractTranscribed, transcribe


class Budget(NamedTuple):
    """Simulations of a population, and the seed of its random numbers."""

    evaluations: int
    seed: int


class Member(NamedTuple):
    """A design of a population: its wishes, in their own units, and its decisions by name."""

    values: Float[np.ndarray, " wishes"]
    decisions: Mapping[str, Any]


def check_crowd(problem: Problem) -> None:
    """Raise `ProblemError` for decisions without finite bounds, `MissingExtraError` without the library."""
    load_pymoo('trade_off: method="population"')
    places = problem.placements
    open_ended = ~np.isfinite(places.vector("upper") - places.vector("lower"))
    if open_ended.any():
        names = [name for name, is_open in zip(places.entry_names(), open_ended, strict=True) if is_open]
        raise ProblemError(
            f'trade_off: method="population" draws designs between the bounds of decisions, of which {names[:5]} have '
            'none: give them lower= and upper=, or use method="boundary".'
        )


def crowd(
    wishes: Wishes, anchors: Sequence[Solution], points: int, budget: Budget, heed: Callable[[int], None]
) -> list[Member]:
    """Designs of a population spread over the front, at most `points`, as far from one another as can be.

    - `anchors`: the best designs of the wishes, of its first generation; `heed`: called with the evaluations done.
    """
    transcribed = transcribe(wishes.unscaled().problem, DEFAULT)
    program, places = transcribed.program, transcribed.places
    is_level = np.array([name == LEVEL for name in places.entry_names()])
    rows = np.array([_row(transcribed, pressed(name)) for name in wishes.names])

    def whole(free: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "k all"]:
        every = np.repeat(program.start[None], len(free), axis=0)
        every[:, ~is_level] = free
        return every

    def values(free: Float[np.ndarray, "k n"]) -> tuple[np.ndarray, np.ndarray]:
        assert program.values is not None
        _, constraints = program.values(whole(free))
        return constraints[:, rows], _violations(program, constraints)

    first = np.array([places.moved(program.start, _own(one)) for one in anchors])[:, ~is_level]
    lower, upper = program.lower[~is_level], program.upper[~is_level]
    given = {"points": points, "evaluations": budget.evaluations, "seed": budget.seed, "heed": heed}
    found = population_front(values, lower, upper, first, **given)
    reached = values(found)[0]
    return [Member(reached[i], places.named(whole(found[i : i + 1])[0])) for i in _far_apart(reached, points)]


def _own(solution: Solution) -> dict[str, Any]:
    return {name: one for name, one in solution.decisions.items() if name != LEVEL}


def _row(transcribed: AbstractTranscribed, name: str) -> int:
    names = [one.name for one in transcribed.problem.constraints]
    return transcribed.rows[names.index(name)].start


def _violations(program: NonlinearProgram, constraints: Float[np.ndarray, "k m"]) -> Float[np.ndarray, " k"]:
    """The largest violation of each design, over the magnitudes of the constraints."""
    beyond = np.fmax(constraints - program.constraint_upper, program.constraint_lower - constraints)
    worst = np.max(beyond / program.constraint_scale, axis=1, initial=0.0)
    return np.where(np.isfinite(constraints).all(axis=1), worst, np.inf)


def _far_apart(values: Float[np.ndarray, "k wishes"], count: int) -> list[int]:
    """The indices of at most so many points, each as far as can be from those before."""
    spread = np.ptp(values, axis=0)
    scaled = values / np.where(spread > 0, spread, 1.0)
    chosen = [int(np.argmin(scaled[:, 0]))]
    while len(chosen) < min(count, len(values)):
        away = np.abs(scaled[:, None] - scaled[chosen][None]).max(axis=2).min(axis=1)
        if not away.max() > 0:
            break
        chosen.append(int(np.argmax(away)))
    return chosen
