"""The four-bar study, run: designs, evidence and the front; and linkages counted by elimination.

The counts know the loop as a triangle alone: they are independent of the constraints, multipliers and expansions that
they verify.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

import aleator as al
from aleator._core.border import Progress, silent
from aleator.journalling import kept
from aleator.studies._shared import SECOND_WAY, found_both_ways
from aleator.studies._staged import Stage, stop_if_interrupted
from aleator.studies.four_bar import (
    ANGLES,
    HEIGHT,
    LENGTHS,
    SIGMAS,
    TRANSMISSION,
    WIDTHS,
    ZONE,
    allocation_problem,
    mean_problem,
    nominal_problem,
    robust_problem,
)

ALONG_STROKE = 81
AT_ONCE = 20_000
LEVELS = (0.5, 0.95, 0.99)
NOMINAL, ROBUST, ALLOCATED = "dOpt", "uOpt", "aOpt"
DESIGNS = (NOMINAL, ROBUST, ALLOCATED)
PUBLISHED = "Hoeken"
MEAN = "dOpt at the means"
TARGET = 0.01
"""The share of linkages that may break any limit."""
DRAWN = 60


class Posture(NamedTuple):
    """Pins and tool of linkages at some crank angles, mm, shape (..., 2), and the angle of transmission, degrees."""

    crank_pin: np.ndarray
    rocker_pin: np.ndarray
    tool: np.ndarray
    transmission: np.ndarray


@final
@dataclass(frozen=True)
class Counts:
    """What was counted of a design.

    - `outside`: linkages whose tool leaves the given zone somewhere on the stroke; `flat`: those whose angle of
      transmission is too small somewhere;
    - `zone`: half the width of the zone in which `SIGMAS` standard deviations stay at each place of the stroke, mm;
    - `largest`: the largest deviation of the tool on the stroke that half, 95 %, and 99 % of the linkages keep, mm.
    """

    outside: al.results.Proportion
    flat: al.results.Proportion
    zone: float
    largest: tuple[float, float, float]


def posture(
    angle: Float[np.ndarray, "..."],
    lengths: Mapping[str, Float[np.ndarray, "..."]],
    crank_offset: Float[np.ndarray, "... 2"],
    rocker_offset: Float[np.ndarray, "... 2"],
) -> Posture:
    """A linkage at a crank angle, from the triangle of coupler, rocker and the line that joins their other ends.

    The offsets are the places of both pins in their clearances, mm; everything broadcasts.
    """
    pin = lengths["crank"][..., None] * _unit(angle) + crank_offset
    ground = np.stack([lengths["ground"], np.zeros_like(lengths["ground"])], axis=-1)
    line = ground - pin - rocker_offset
    reach, b, c = np.hypot(line[..., 0], line[..., 1]), lengths["coupler"], lengths["rocker"]
    coupler = np.arctan2(line[..., 1], line[..., 0]) + np.arccos((b**2 + reach**2 - c**2) / (2 * b * reach))
    tool = (
        pin + lengths["along"][..., None] * _unit(coupler) + lengths["across"][..., None] * _unit(coupler + np.pi / 2)
    )
    end = pin + rocker_offset + b[..., None] * _unit(coupler)
    transmission = np.rad2deg(np.arccos((b**2 + c**2 - reach**2) / (2 * b * c)))
    return Posture(pin, end, tool, transmission)


def drawn_postures(
    lengths: Mapping[str, float], widths: Mapping[str, float], count: int, *, seed: int, instants: np.ndarray
) -> Posture:
    """Random linkages of some lengths and widths (mm), at some crank angles: shapes (linkages, angles)."""
    generator = np.random.default_rng(seed)
    parts = {
        name: (lengths[name] + widths[f"{name}.tolerance"] / 3 * generator.standard_normal(count))[:, None]
        for name in LENGTHS
    }
    seats = [widths[play] / 3 * generator.standard_normal((count, 1, 2)) for play in ("crank_play", "rocker_play")]
    return posture(instants, parts, *seats)


def crank_angles(count: int = ALONG_STROKE) -> Float[np.ndarray, " angles"]:
    """Angles of the crank from one end of the stroke to the other, rad."""
    return np.linspace(*ANGLES, count)


def count_linkages(
    lengths: Mapping[str, float],
    widths: Mapping[str, float],
    samples: int,
    *,
    seed: int = 3,
    progress: Progress = silent,
) -> Counts:
    """Assemble `samples` linkages of normal dimensions, and count those that leave the zone or transmit badly."""
    largest, smallest, sums = [], [], np.zeros((2, ALONG_STROKE))
    for done in range(0, samples, AT_ONCE):
        progress("counting linkages", done, samples)
        count = min(AT_ONCE, samples - done)
        found = drawn_postures(lengths, widths, count, seed=seed + done, instants=crank_angles())
        deviation = found.tool[..., 1] - HEIGHT
        sums += np.sum(deviation, axis=0), np.sum(deviation**2, axis=0)
        largest.append(np.abs(deviation).max(axis=1))
        smallest.append(found.transmission.min(axis=1))
    mean, square = sums / samples
    away, least = np.concatenate(largest), np.concatenate(smallest)
    return Counts(
        outside=al.results.Proportion(int(np.sum(away > ZONE)), samples),
        flat=al.results.Proportion(int(np.sum(least < TRANSMISSION)), samples),
        zone=float(np.max(np.abs(mean) + SIGMAS * np.sqrt(np.maximum(square - mean**2, 0.0)))),
        largest=tuple(np.quantile(away, LEVELS).tolist()),
    )


def lengths_of(solution: al.Solution) -> dict[str, float]:
    """The lengths that a design chose, mm."""
    return {name: float(solution.decisions[f"{name}.nominal"]) for name in LENGTHS}


def widths_of(solution: al.Solution) -> dict[str, float]:
    """The tolerances and clearances of a design, mm."""
    return {name: float(solution.decisions[name]) for name in WIDTHS}


def _unit(angle: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


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
