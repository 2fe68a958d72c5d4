"""Check one system at other instants than those of a problem's grids."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from aleator.certification._reference import Alone, Reference, alone_elsewhere, middle, rounding_of, row_sizes
from aleator.design import Constraint, Problem, functionals_of, is_over_time
from aleator.dynamics import Grid
from aleator.transcription import AbstractTranscribed, bound_size

# A difference at the other instants counts from this part of a limit on; less is integration error. For integrals it
# is more, because a grid with an instant at a jump is more accurate than this one.
_SHOWS, _SHOWS_OF_NUMBERS = 5e-3, 2e-2
# A grid is far off if it makes a quantity this many times too large.
_FAR_OFF = 10.0


class Probed(NamedTuple):
    """The behaviour of one system between the instants of the finer grid.

    - `worst`: the largest excess over a limit over time, transferred to the family there, relative to its bound (to the
      constraint's scale if that is zero), or zero; `where`: its constraint; `when`: its time, s;
    - `numbers`: the differences of functionals that are numbers, by their texts, and of the objective, under "". Zero
      if no more than the error of a grid.
    """

    worst: float
    where: str
    when: float
    numbers: dict[str, float]


def probed(transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], finer: Reference) -> Probed:
    """Compare one system of a problem with its finer grid at a point."""
    problem = transcribed.problem
    seen = finer.elsewhere
    times = transcribed.at(point).times
    worst = (0.0, "", np.nan)
    for beyond, name, fraction in _exceeded(transcribed, finer):
        if not beyond <= worst[0]:
            worst = beyond, name, float(times[0] + fraction * (times[-1] - times[0]))
    functionals = zip(functionals_of(problem.expressions), finer.alone.functionals, seen.functionals, strict=True)
    numbers = {one.text(): difference_shown(own, other) for one, own, other in functionals if not one.is_path}
    return Probed(*worst, numbers | {"": difference_shown(finer.alone.expressions[0], seen.expressions[0])})


def whether_misled(
    transcribed: AbstractTranscribed, start: Float[np.ndarray, " variables"], factor: int
) -> Callable[[], str]:
    """A sentence on a functional for which the grid is far off at the start of a search; empty if there is none.

    It runs in parallel with the search; the function returned waits for the result.

    `factor`: how many times as many steps the finer grid for judging the answer has.

    A step that is too long for a design makes it appear unstable. The search may then avoid it for a design at rest,
    where the grid appears exact.
    """
    problem = transcribed.problem
    if not problem.is_integrated:
        return lambda: ""
    meaning, which = transcribed.at(start), middle(transcribed.collocation)
    begun = tuple(np.array(one[which]) for one in meaning.samples)
    seen = alone_elsewhere(problem, transcribed.collocation, meaning.decisions, factor)
    return lambda: _misled(problem, begun, seen(), lambda: rounding_of(transcribed, row_sizes(transcribed, start)))


def _misled(
    problem: Problem, begun: tuple[np.ndarray, ...], seen: Alone, rounding: Callable[[], dict[Any, float]]
) -> str:
    assert isinstance(problem.grid, Grid)
    for one, own, true in zip(functionals_of(problem.expressions), begun, seen.functionals, strict=True):
        own, true = float(np.max(np.abs(own))), float(np.max(np.abs(true)))
        if not (own <= _FAR_OFF * true or own <= rounding().get(one, 0.0)):
            return (
                f"at the start of the search {problem.grid.steps} steps give {one.text()} as {own:.3g}, where "
                f"{true:.3g} is right: the search may have avoided good designs"
            )
    return ""


def difference_shown(own: np.ndarray, other: np.ndarray) -> float:
    """How far two numbers differ; zero if no more than grids may."""
    if not np.isfinite(own).all():
        return 0.0  # A ratio to a spread, which tells nothing.
    difference, size = float(np.max(np.abs(own - other))), float(np.max(np.maximum(np.abs(own), np.abs(other))))
    return 0.0 if difference <= _SHOWS_OF_NUMBERS * size else difference


def _exceeded(transcribed: AbstractTranscribed, finer: Reference) -> Iterator[tuple[float, str, float]]:
    """For each limit over time: its excess relative to its bound, its name, and the fraction of the time."""
    parts = zip(
        transcribed.problem.constraints,
        transcribed.scales,
        finer.values[1:],
        finer.alone.expressions[1:],
        finer.elsewhere.expressions[1:],
        strict=True,
    )
    for one, scale, family, own, other in parts:
        if not is_over_time(one):
            continue
        size = bound_size(one) or scale
        fractions = np.linspace(0.0, 1.0, len(other)) if one.is_path else np.full(1, np.nan)
        windows = _windows(len(own), fractions) if one.is_path else np.zeros((1, 1), dtype=int)
        for sign, bound in _sides(one):
            rows, alike, probe = (
                sign * (part.reshape(len(part) if one.is_path else 1, -1)) for part in (family, own, other)
            )
            # A ratio to a spread is not finite for any one system, which then tells nothing of the family.
            known: Any = np.isfinite(alike[windows]).all(axis=(1, 2))
            more = np.where(known[:, None], probe, 0.0) - np.where(known[:, None], alike[windows].max(axis=1), 0.0)
            more = more.max(axis=1)
            beyond = rows.max(axis=1)[windows].max(axis=1) - sign * bound + more
            # NaN counts as the largest excess.
            beyond = np.where(np.isnan(beyond), np.inf, beyond)
            k = int(np.argmax(np.where(more <= _SHOWS * size, -np.inf, beyond)))
            if not (more[k] <= _SHOWS * size or beyond[k] <= _SHOWS * size):
                yield float(beyond[k]) / size, one.name, float(fractions[k])


def _sides(constraint: Constraint) -> list[tuple[float, float]]:
    sides = ((1.0, float(constraint.upper)), (-1.0, float(constraint.lower)))
    return [(sign, bound) for sign, bound in sides if np.isfinite(bound)]


def _windows(instants: int, fractions: Float[np.ndarray, " probe"]) -> Int[np.ndarray, "probe around"]:
    """The instants of a uniform grid around given fractions of time: two on each side."""
    first = np.minimum(fractions * (instants - 1), instants - 2).astype(int)
    return np.clip(first[:, None] + np.arange(-1, 3)[None, :], 0, instants - 1)
