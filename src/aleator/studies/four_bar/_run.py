"""The four-bar study, run: designs, evidence, counts by elimination, a second way, and what a narrower zone costs."""

from dataclasses import dataclass, field
from functools import partial
from typing import final

import numpy as np

import aleator as al
from aleator._core.border import Progress
from aleator.journalling import kept
from aleator.studies._shared import SECOND_WAY, found_both_ways
from aleator.studies._study import Stage, stop_if_interrupted
from aleator.studies.four_bar import LENGTHS, WIDTHS, allocation_problem, mean_problem, nominal_problem, robust_problem
from aleator.studies.four_bar._counts import Counts, count_linkages, lengths_of, widths_of

NOMINAL, ROBUST, ALLOCATED = "dOpt", "uOpt", "aOpt"
DESIGNS = (NOMINAL, ROBUST, ALLOCATED)
PUBLISHED = "Hoeken"
MEAN = "dOpt at the means"
TARGET = 0.01
"""The share of linkages that may break any limit."""

DRAWN = 60


@final
@dataclass(frozen=True)
class Effort:
    """How much is computed: linkages simulated for each design, linkages counted by elimination, points on the front,
    which is left out together with the second way if there are none.
    """

    samples: int = 20_000
    counted: int = 1_000_000
    front_points: int = 7


FULL = Effort()
QUICK = Effort(samples=1_500, counted=100_000, front_points=0)


@final
@dataclass
class FourBarResults:
    """Everything that the study has finished so far; missing results are empty.

    - `designs`, `evidence`: dOpt, uOpt and aOpt, and linkages simulated with their forces;
    - `counts`: the same designs and Hoeken's linkage, their paths counted by elimination;
    - `second_way`: the mean linkage by shooting and by direct collocation;
    - `front`: the cost of the tolerances over the zone allowed.
    """

    effort: Effort
    designs: dict[str, al.Solution] = field(default_factory=dict)
    evidence: dict[str, al.results.Evidence] = field(default_factory=dict)
    counts: dict[str, Counts] = field(default_factory=dict)
    second_way: al.results.CrossChecked | None = None
    front: al.results.Front | None = None


def problems() -> dict[str, al.Problem]:
    """The problems of the three designs."""
    return {NOMINAL: nominal_problem(), ROBUST: robust_problem(), ALLOCATED: allocation_problem()}


def solve_designs(results: FourBarResults, progress: Progress) -> None:
    """The three designs."""
    for i, (name, problem) in enumerate(problems().items()):
        progress(f"design {name}", i, len(DESIGNS))
        results.designs[name] = al.solve(problem)


def sample_designs(results: FourBarResults, progress: Progress) -> None:
    """Each design simulated, with its forces."""
    for name, solution in results.designs.items():
        results.evidence[name] = al.validate(solution, results.effort.samples, seed=1, keep=DRAWN, progress=progress)


def count_designs(results: FourBarResults, progress: Progress) -> None:
    """The path of each design, and of the published linkage with the given tolerances."""
    for name, (lengths, widths) in dimensions(results).items():
        samples = results.effort.counted
        counted = kept(f"linkages, {name}", count_linkages, lengths, widths, samples, progress=progress)
        results.counts[name] = counted


def dimensions(results: FourBarResults) -> dict[str, tuple[dict[str, float], dict[str, float]]]:
    """Lengths and widths (mm) of the published linkage and of each design, by name."""
    found = {name: (lengths_of(one), widths_of(one)) for name, one in results.designs.items()}
    return {PUBLISHED: (LENGTHS, WIDTHS), **found}


def solve_by_collocation(results: FourBarResults, progress: Progress) -> None:
    """The mean linkage, its closed loop with multipliers: the coordinates that follow the crank are variables too."""
    results.second_way = found_both_ways(MEAN, mean_problem(), progress)


def sweep_zone(results: FourBarResults, progress: Progress) -> None:
    """The least cost against the zone allowed, from the widest down."""
    values = np.linspace(0.8, 0.3, results.effort.front_points)
    results.front = al.pareto(allocation_problem(), "zone", values, progress=progress)
    stop_if_interrupted(results.front)


def stages(results: FourBarResults) -> dict[str, Stage]:
    """All stages, the most useful first; a quick run has neither the second way nor the front."""
    longer = {
        SECOND_WAY: Stage(partial(solve_by_collocation, results), 0.1),
        "front": Stage(partial(sweep_zone, results), 0.3),
    }
    return {
        "designs": Stage(partial(solve_designs, results), 0.4),
        "evidence": Stage(partial(sample_designs, results), 0.2),
        "counts": Stage(partial(count_designs, results), 0.1),
        **(longer if results.effort.front_points else {}),
    }
