"""A population that spreads over a front: designs from which lines lead to the front itself, and places on it."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator._core.heard import answering
from aleator.design import Problem
from aleator.nlp import NonlinearProgram, load_pymoo, population_front
from aleator.sweep._trade_off import efficient
from aleator.sweep._wishes import LEVEL, Design, Wishes, pressed, without_level
from aleator.transcription import DEFAULT, transcribe, valued_by

# Points that are nearer to one another, as a part of their range, are the same place.
_APART = 1e-3


class Gap(NamedTuple):
    """A gap of a front of two wishes: its places between the anchors, from 0 to 1, and the points at its ends."""

    first: float
    last: float
    before: Float[np.ndarray, " wishes"]
    after: Float[np.ndarray, " wishes"]

    @property
    def width(self) -> float:
        """Its part of the line between the anchors."""
        return self.last - self.first

    @property
    def ends(self) -> tuple[float, float]:
        """The first wish at its ends."""
        return float(self.before[0]), float(self.after[0])

    def size(self, scales: Float[np.ndarray, " wishes"]) -> float:
        """The largest difference of its ends, in scaled wishes; lines through a hole end at one of its ends."""
        return float(np.abs((self.after - self.before) * scales).max())


def simplex(size: int, count: int) -> list[Float[np.ndarray, " wishes"]]:
    """So many points spread evenly over the inside and the edges of a simplex, without its corners."""
    parts = 1
    while len(inner := _lattice(size, parts)) < count:
        parts += 1
    return inner if len(inner) == count else [inner[i] for i in sorted(far_apart(np.array(inner), count))]


def box(size: int, parts: int) -> list[Float[np.ndarray, " wishes"]]:
    """Starts of parallel lines that pass evenly through a unit box in the direction of its diagonal.

    They are the points of a lattice on the plane through the box's middle whose line meets it, for fronts of which no
    simplex between the best designs is known.
    """
    shifted = ((size - 1) * (one - 1 / size) + 0.5 for one in _lattice(size, parts))
    return [one for one in shifted if np.ptp(one) < 1.0]


def far_apart(values: Float[np.ndarray, "k wishes"], count: int, taken: int = 0) -> list[int]:
    """The indices of at most so many points, each as far as can be from those before and from the first few, which are
    taken already.
    """
    if len(values) <= taken:
        return []
    spread = np.ptp(values, axis=0)
    scaled = values / np.where(spread > 0, spread, 1.0)
    chosen = list(range(taken)) or [int(np.argmin(scaled[:, 0]))]
    while len(chosen) < min(count + taken, len(values)):
        away = np.abs(scaled[:, None] - scaled[chosen][None]).max(axis=2).min(axis=1)
        if not away.max() > _APART:
            break
        chosen.append(int(np.argmax(away)))
    return chosen[taken:]


def _lattice(size: int, parts: int) -> list[Float[np.ndarray, " wishes"]]:
    """All sums of multiples of `1 / parts` that make one, but for the corners (Das and Dennis 1998)."""
    bars = combinations(range(parts + size - 1), size - 1)
    every = (np.diff([-1, *one, parts + size - 1]) - 1 for one in bars)
    return [one / parts for one in every if one.max() < parts]


# Violations of at most this part of a constraint's magnitude count as none.
_HELD = 1e-6


class Budget(NamedTuple):
    """Simulations of a population, the seed of its random numbers, and the executor that simulates, if any."""

    evaluations: int
    seed: int
    executor: Executor | None


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
    wishes: Wishes, anchors: Sequence[Design], points: int, budget: Budget, heed: Callable[[int], None]
) -> tuple[list[Member], bool]:
    """Designs of a population spread over the front, at most `points`, as far from one another as can be; and whether
    Ctrl-C ended it, after which they are the best until then.

    - `anchors`: the best designs of the wishes, of its first generation; `heed`: called with the evaluations done.
    """
    transcribed = transcribe(wishes.unscaled().problem, DEFAULT)
    program, places = valued_by(budget.executor, transcribed.program, "trade_off"), transcribed.places
    is_level = np.array([name == LEVEL for name in places.entry_names()])
    known = np.array([one.values for one in anchors])
    constraints = [one.name for one in transcribed.problem.constraints]
    rows = np.array([transcribed.rows[constraints.index(pressed(name))].start for name in wishes.names])

    def whole(free: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "k all"]:
        every = np.repeat(program.start[None], len(free), axis=0)
        every[:, ~is_level] = free
        return every

    def values(free: Float[np.ndarray, "k n"]) -> tuple[np.ndarray, np.ndarray]:
        assert program.values is not None
        _, constraints = program.values(whole(free))
        return constraints[:, rows], _violations(program, constraints)

    every = np.array([places.moved(program.start, without_level(one.solution.decisions)) for one in anchors])
    bounds = program.lower[~is_level], program.upper[~is_level]
    found, reached, interrupted = _population(values, bounds, every[:, ~is_level], points, budget, heed)
    # The anchors are on the front already.
    reached = np.concatenate([known, reached])
    chosen = [i - len(known) for i in far_apart(reached, points, taken=len(known))]
    return [Member(reached[len(known) + i], places.named(whole(found[i : i + 1])[0])) for i in chosen], interrupted


def _population(
    values: Callable[[Float[np.ndarray, "k n"]], tuple[np.ndarray, np.ndarray]],
    bounds: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]],
    first: Float[np.ndarray, "some n"],
    points: int,
    budget: Budget,
    heed: Callable[[int], None],
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k wishes"], bool]:
    """The front of a population and its wishes; after Ctrl-C, the best of all designs until then, and True."""
    seen: list[tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k wishes"]]] = []

    def noted(free: Float[np.ndarray, "k n"]) -> tuple[np.ndarray, np.ndarray]:
        reached, violations = values(free)
        held = violations <= _HELD
        seen.append((free[held], reached[held]))
        return reached, violations

    try:
        with answering() as answer:

            def heeded(done: int) -> None:
                heed(done)
                answer()

            own = {"points": points, "evaluations": budget.evaluations, "seed": budget.seed, "heed": heeded}
            found = population_front(noted, *bounds, first, **own)
            return found, values(found)[0], False
    except KeyboardInterrupt:
        if not seen:
            raise
        found, reached = (np.concatenate(part) for part in zip(*seen, strict=True))
        kept = efficient(reached, np.zeros(reached.shape[1]))
        return found[kept], reached[kept], True


def _violations(program: NonlinearProgram, constraints: Float[np.ndarray, "k m"]) -> Float[np.ndarray, " k"]:
    """The largest violation of each design, over the magnitudes of the constraints."""
    beyond = np.fmax(constraints - program.constraint_upper, program.constraint_lower - constraints)
    worst = np.max(beyond / program.constraint_scale, axis=1, initial=0.0)
    return np.where(np.isfinite(constraints).all(axis=1), worst, np.inf)
