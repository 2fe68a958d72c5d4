"""One system at a few thousand instants that no grid of the problem has: what happens where nobody looked.

A grid and those with a whole multiple of its steps share their instants. A ripple whose period is a step is the same
number at all of them, and a shock between two of them was never there. Instants whose number is prime fall elsewhere.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled
from aleator.design import (
    Constraint,
    Problem,
    functionals_of,
    is_over_time,
    refuse_changed_code,
    responses,
)
from aleator.dynamics import Grid, System
from aleator.transcription._alone import Alone, alone, middle
from aleator.transcription._magnitudes import bound_size
from aleator.transcription._reference import Reference
from aleator.transcription._sequential import Sequential

# The number of steps is the first prime from here on, and from so many times those of the finer grid.
_STEPS, _BEYOND = 4099, 1.5
# What one system shows beside the instants of the finer grid counts from this part of a limit on: less is the error of
# its integration. Of an integral more, for a grid is better than this one where it has the instants of a jump.
_SHOWS, _SHOWS_OF_NUMBERS = 5e-3, 2e-2
# A grid is far off where it makes something so many times as large as it is.
_FAR_OFF = 10.0


class Probed(NamedTuple):
    """What one system shows between the instants of the finer grid.

    - `worst`: by how much it exceeds a limit over time, as the family does there, relative to its bound (to the
      constraint's scale where that is zero), or zero; `where`: its constraint; `when`: its time, s;
    - `numbers`: by how much functionals that are numbers differ, by their texts, and the objective, under "". Zero
      where that is no more than a grid errs.
    """

    worst: float
    where: str
    when: float
    numbers: dict[str, float]


def _probed(problem: Problem, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> tuple[Any, ...]:
    functionals = functionals_of(problem.expressions)
    found = responses(problem, functionals, germ[None], decisions)
    return alone(problem, dict(zip(functionals, (one[0] for one in found), strict=True)), decisions)


PROBE = Compiled(_probed, unchanged=refuse_changed_code)


def probed(transcription: Sequential, decisions: Float[np.ndarray, " n"], finer: Reference) -> Probed:
    """What one system of a problem shows beside the instants of its finer grid at some decisions."""
    problem = transcription.problem
    assert isinstance(problem.grid, Grid)
    steps = _prime_from(max(_STEPS, int(_BEYOND * finer.factor * problem.grid.steps)))
    seen = _seen(transcription, steps, decisions)
    times = transcription.times(decisions)
    worst = (0.0, "", np.nan)
    for beyond, name, fraction in _exceeded(transcription, finer, seen, np.linspace(0.0, 1.0, steps + 1)):
        if not beyond <= worst[0]:
            worst = beyond, name, float(times[0] + fraction * (times[-1] - times[0]))
    functionals = zip(functionals_of(problem.expressions), finer.alone.functionals, seen.functionals, strict=True)
    numbers = {one.text(): _shown(own, other) for one, own, other in functionals if not one.is_path}
    return Probed(*worst, numbers | {"": _shown(finer.alone.expressions[0], seen.expressions[0])})


def misled(transcription: Sequential, start: Float[np.ndarray, " n"]) -> str:
    """A sentence on a functional that a problem's grid is far off at the start of a search; empty if there is none.

    A step that is too long for a design makes it look unstable, and a search flees to one that does nothing: there the
    grid is found to be exact.
    """
    problem = transcription.problem
    if not (isinstance(problem.grid, Grid) and isinstance(problem.system, System) and problem.system.states):
        return ""
    seen = _seen(transcription, _prime_from(max(_STEPS, problem.grid.steps)), start)
    begun = transcription.begun
    if not np.array_equal(start, transcription.program.start):
        which = middle(transcription.collocation)
        begun = tuple(one[which] for one in transcription.evaluator(start).samples)
    for one, own, true in zip(functionals_of(problem.expressions), begun, seen.functionals, strict=True):
        own, true = float(np.max(np.abs(own))), float(np.max(np.abs(true)))
        if not own <= _FAR_OFF * true:
            return (
                f"at the start of the search {problem.grid.steps} steps give {one.text()} as {own:.3g}, where "
                f"{true:.3g} is right: a search may flee from good designs"
            )
    return ""


def _seen(transcription: Sequential, steps: int, decisions: np.ndarray) -> Alone:
    """The system in the middle of a problem's family, on another number of steps."""
    problem, collocation = transcription.problem, transcription.collocation
    assert isinstance(problem.grid, Grid)
    elsewhere = numbers_to_arrays(problem.on_grid(problem.grid.divided(steps)))
    point = collocation.points[middle(collocation)]
    return Alone(*jax.tree.map(np.asarray, PROBE(elsewhere, jnp.asarray(point), jnp.asarray(decisions))))


def _shown(own: np.ndarray, other: np.ndarray) -> float:
    """How far two numbers differ; zero where it is no more than grids may."""
    difference, size = float(np.max(np.abs(own - other))), float(np.max(np.maximum(np.abs(own), np.abs(other))))
    return 0.0 if difference <= _SHOWS_OF_NUMBERS * size else difference


def _exceeded(
    transcription: Sequential, finer: Reference, seen: Alone, fractions: Float[np.ndarray, " probe"]
) -> Iterator[tuple[float, str, float]]:
    """How far each limit over time is exceeded, relative to its bound; its name; and at what fraction of the time."""
    parts = zip(
        transcription.problem.constraints,
        transcription.scales,
        finer.values[1:],
        finer.alone.expressions[1:],
        seen.expressions[1:],
        strict=True,
    )
    for one, scale, family, own, other in parts:
        if not is_over_time(one):
            continue
        size = bound_size(one) or scale
        windows = _windows(len(own), fractions) if one.is_path else np.zeros((1, 1), dtype=int)
        for sign, bound in _sides(one):
            rows, alike, probe = (
                sign * (part.reshape(len(part) if one.is_path else 1, -1)) for part in (family, own, other)
            )
            more = (probe - alike[windows].max(axis=1)).max(axis=1)
            beyond = rows.max(axis=1)[windows].max(axis=1) - sign * bound + more
            # A number that is none is beyond all.
            beyond = np.where(np.isnan(beyond), np.inf, beyond)
            k = int(np.argmax(np.where(more <= _SHOWS * size, -np.inf, beyond)))
            if not (more[k] <= _SHOWS * size or beyond[k] <= _SHOWS * size):
                yield float(beyond[k]) / size, one.name, float(fractions[k]) if one.is_path else np.nan


def _sides(constraint: Constraint) -> list[tuple[float, float]]:
    sides = ((1.0, float(constraint.upper)), (-1.0, float(constraint.lower)))
    return [(sign, bound) for sign, bound in sides if np.isfinite(bound)]


def _windows(instants: int, fractions: Float[np.ndarray, " probe"]) -> Int[np.ndarray, "probe around"]:
    """The instants of a uniform grid around others: two on each side."""
    first = np.minimum(fractions * (instants - 1), instants - 2).astype(int)
    return np.clip(first[:, None] + np.arange(-1, 3)[None, :], 0, instants - 1)


def _prime_from(number: int) -> int:
    return next(one for one in range(number, 2 * number) if all(one % k for k in range(2, int(one**0.5) + 1)))
