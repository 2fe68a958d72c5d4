"""A population that spreads over a front of several wishes, by NSGA-II, for starts in all its parts."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from aleator._core.parallel import heeding
from aleator.nlp import population_front
from aleator.sweep._runner import Runner
from aleator.sweep._trade_off import Line, efficient
from aleator.sweep._wishes import LEVEL, Design, Wishes, without_level
from aleator.transcription import DEFAULT, valued_by

# Violations of at most this part of a constraint's magnitude count as none.
_HELD = 1e-6


def crowd(
    wishes: Wishes, anchors: Sequence[Design], points: int, evaluations: int, seed: int, run: Runner
) -> list[Line]:
    """Lines through the efficient designs of a population that spreads over the front.

    - `anchors`: the best designs of the wishes, of its first generation; `points`: of the front that are asked for.

    Ctrl-C only ends the population.
    """
    transcribed = wishes.transcribed(DEFAULT)
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
    best = np.flatnonzero(efficient(reached, np.zeros(len(wishes.names))))
    return [Line(reached[i], without_level(places.named(every[i]))) for i in best]
