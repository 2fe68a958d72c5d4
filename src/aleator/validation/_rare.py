"""`rare_violation`: the probability of violations too rare to be counted, by importance sampling."""

from collections.abc import Sequence
from typing import final

import numpy as np
import scipy
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator._core.given import refusal
from aleator._core.journalled import journalled, parts_so_far
from aleator._core.part_by_part import call_by_call
from aleator._core.progress import Progress, check_progress, silent
from aleator.ensemble import Part, at_levels, each, fill, parts
from aleator.solution import Solution
from aleator.validation._counted import is_counted, tolerances
from aleator.validation._proposal import adapted, weighted
from aleator.validation._systems import Systems
from aleator.validation._validate import validate
from aleator.validation._weighted import Share

# With a smaller effective sample size an estimate is no better than a count, and its interval is unreliable.
_ENOUGH = 100
# The search for violations starts at this many standard deviations; one system in ten thousand lies beyond.
_REACH = 3.7


def rare_violation(
    solution: Solution,
    names: str | Sequence[str] | None = None,
    samples: int = 20_000,
    *,
    seed: int = 0,
    batch: int = 250,
    progress: Progress = silent,
) -> Share:
    """Estimate how often systems of a design break any of the limits called `names` (default: all), if rarely.

    First, separate simulations search level by level for systems that break each limit (the cross-entropy method). Then
    `samples` fresh systems are drawn where these were found, and weighted by their likelihood ratios. The estimate is
    unbiased whatever was found. It needs some thousand samples where a count needs a hundred divided by the
    probability. It works for any distributions, correlated ones too; beyond some twenty uncertain numbers the weights
    degenerate.

    Where the effective sample size is below a hundred, the result is a plain count of `samples` systems instead: a
    `Proportion`. No sampling method can account for a way of breaking a limit that it never met; the fewer uncertain
    numbers, the less likely that is. Where much depends on it, count with `al.validate`.

    Within `al.journal(folder)` what takes long is kept part by part, every few seconds: after a crash the same call
    goes on from there.

    Raises `ProblemError` as `al.validate` does, and for names against which no system is counted.
    """
    if not isinstance(solution, Solution):
        raise ProblemError(f"rare_violation: expected a Solution, from al.solve; received {type(solution).__name__}.")
    for name, number, least in (("samples", samples, 2), ("batch", batch, 1), ("seed", seed, 0)):
        if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < least:
            raise ProblemError(
                f"rare_violation: expected {name} as a whole number of at least {least}; received {number!r}."
            )
    check_progress("rare_violation", progress)
    limits = _Limits(solution, names, min(batch, samples))
    given = {"solution": solution, "how": (limits.names, samples, seed, batch)}
    return journalled("rare_violation", given, lambda: _estimated(solution, limits, samples, seed, progress))


def _estimated(solution: Solution, limits: "_Limits", samples: int, seed: int, progress: Progress) -> Share:
    """The estimate: see `rare_violation`."""
    generator = np.random.default_rng(seed)

    def tell(done: int) -> None:
        progress("rare violations", done, samples)

    tell(0)
    level = max(1000, samples // 10)
    beyond = call_by_call(limits.beyond, parts_so_far())
    proposal = adapted(beyond, len(limits.systems.germs), _REACH, level, generator)
    found = weighted(beyond, proposal, samples, limits.batch, generator, tell)
    tell(samples)
    if found.effective >= _ENOUGH:
        return found
    # A separate random stream, so that the count is independent of the search.
    fresh = int(np.random.SeedSequence([seed, 1]).generate_state(1)[0])
    return validate(solution, samples, seed=fresh, batch=limits.batch, keep=0).violation(*limits.names)


@final
class _Limits:
    """The excess of systems over each of some limits, as a function of standard normal numbers."""

    def __init__(self, solution: Solution, names: str | Sequence[str] | None, batch: int):
        self.systems, self.batch = Systems(solution, "rare_violation"), batch
        constraints = self.systems.problem.constraints
        if not isinstance(names, str | Sequence | None):
            raise refusal("rare_violation: names", "names of constraints", names)
        counted = dict.fromkeys(one.name for one in constraints if is_counted(one))
        self.names = tuple(counted) if names is None else (names,) if isinstance(names, str) else tuple(names)
        unknown = [name for name in self.names if name not in counted]
        if unknown or not self.names:
            raise ProblemError(
                f"rare_violation: expected names of constraints against which systems are counted, {list(counted)}; "
                f"received {unknown}."
            )
        self._rows = [i for i, one in enumerate(constraints) if one.name in self.names and is_counted(one)]
        self._tolerances = tolerances(solution)[self._rows]
        self.systems.prepare(batch)

    def beyond(self, normals: Float[np.ndarray, "systems variables"]) -> Float[np.ndarray, "limits systems"]:
        """The excess over each limit, positive where it is broken; in batches of one size, compiled once."""
        levels = np.clip(scipy.special.ndtr(normals), np.finfo(float).tiny, 1 - np.finfo(float).epsneg)
        germ = at_levels(self.systems.germs, levels)

        def excess(part: Part) -> Float[np.ndarray, "limits some"]:
            batch = self.systems.simulate(fill(part.points, self.batch), len(part.points))
            return np.asarray(batch.excess)[self._rows, : len(part.points)]

        found = [some for _, some in each(excess, parts(germ, self.batch))]
        return np.concatenate(found, axis=1) - self._tolerances[:, None]
