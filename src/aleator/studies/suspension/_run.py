"""The suspension study, run: all designs, their evidence and their fronts, in order of usefulness."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import NamedTuple, final

import numpy as np

import aleator as al
from aleator._core.progress import Progress, silent
from aleator.studies.suspension import apportionment_problem, deterministic_problem, robust_problem

TRAVEL, HOLDING, RIDE = 0.203, 0.034, 220.0
NARROW_TRAVEL = 0.152
HOLDING_BOXES = (0.0305, 0.032, 0.0335, 0.035)
TARGET = 0.01
DRAWN = 60
MARGIN, RIDE_MARGIN = 1.6, 2.4
"""Where the search for the margins to build with starts: of travel and holding, and of ride. It keeps their ratio.

Equation (119) adds the spreads of both masses, which is more than that of their distance, and ride is skewed upwards:
so ride takes more multiples of σ for the same share. With one margin for all, no spreads keep the limits in 99 of 100
cars; of the ratios between 1.3 and 1.7, this one costs least, to a tenth.
"""
BUILT = {"uOpt": ("travel", "holding"), "aOpt": ("travel", "holding", "ride")}
"""The designs to build, and their limits, which no more than `TARGET` of the cars may break."""


@final
@dataclass(frozen=True)
class Effort:
    """How much is computed: points on each front, Monte Carlo samples for each design and for each trial of a margin.

    Without samples for trials, no margin is calibrated.
    """

    front_points: int = 15
    samples: int = 100_000
    calibration_samples: int = 20_000


QUICK = Effort(front_points=4, samples=4_000, calibration_samples=0)


@final
@dataclass
class SuspensionResults:
    """Everything the study has finished so far; what has not been reached is empty.

    - `designs`, `evidence`: dOpt, uOpt and aOpt at travel 0.203 m, holding 0.034 m, ride 220 m²/s³;
    - `built`: uOpt and aOpt with the margins at which all their limits together are broken by 1 % of the cars at most;
    - `narrow`, `narrow_evidence`: dOpt, and uOpt with margins of 1 and 1.25 sigma, at travel 0.152 m (6.9, 6.10);
    - `travel_fronts`: dOpt, uOpt and aOpt over the travel bound;
    - `holding_fronts`: dOpt and uOpt over the holding bound;
    - `boxes`: dOpt and uOpt at the holding bounds of figure 6.7;
    - `calibration`: the margin at which 1 % of systems leave the narrow travel.
    """

    effort: Effort
    designs: dict[str, al.Solution] = field(default_factory=dict)
    evidence: dict[str, al.Evidence] = field(default_factory=dict)
    built: dict[str, al.Calibration] = field(default_factory=dict)
    narrow: dict[str, al.Solution] = field(default_factory=dict)
    narrow_evidence: dict[str, al.Evidence] = field(default_factory=dict)
    travel_fronts: dict[str, al.Front] = field(default_factory=dict)
    holding_fronts: dict[str, al.Front] = field(default_factory=dict)
    boxes: dict[str, al.Front] = field(default_factory=dict)
    calibration: al.Calibration | None = None


class Stage(NamedTuple):
    """A part of the study, and roughly which share of the whole time it takes."""

    work: Callable[[SuspensionResults, Progress], None]
    share: float


def solve_designs(results: SuspensionResults, progress: Progress) -> None:
    """The three designs side by side."""
    problems = {
        "dOpt": deterministic_problem(TRAVEL, HOLDING),
        "uOpt": robust_problem(TRAVEL, HOLDING),
        "aOpt": apportionment_problem(TRAVEL, HOLDING, RIDE),
    }
    for i, (name, problem) in enumerate(problems.items()):
        progress(f"design {name}", i, len(problems))
        results.designs[name] = al.solve(problem)


def solve_narrow(results: SuspensionResults, progress: Progress) -> None:
    """The designs of figures 6.9 and 6.10."""
    problems = {
        "dOpt": deterministic_problem(NARROW_TRAVEL, HOLDING),
        "uOpt, 1 σ": robust_problem(NARROW_TRAVEL, HOLDING, sigmas=1.0),
        "uOpt, 1.25 σ": robust_problem(NARROW_TRAVEL, HOLDING, sigmas=1.25),
    }
    for i, (name, problem) in enumerate(problems.items()):
        progress(f"narrow travel, {name}", i, len(problems))
        results.narrow[name] = al.solve(problem)


def sample_designs(results: SuspensionResults, progress: Progress) -> None:
    """Evidence for every design found."""
    for solutions, evidence in ((results.designs, results.evidence), (results.narrow, results.narrow_evidence)):
        for name, solution in solutions.items():
            evidence[name] = al.validate(solution, results.effort.samples, seed=1, keep=DRAWN, progress=progress)


def calibrate_designs(results: SuspensionResults, progress: Progress) -> None:
    """The margins at which uOpt and aOpt can be built: fresh cars break their limits no more often than asked."""
    problems = {
        "uOpt": robust_problem(TRAVEL, HOLDING, sigmas=MARGIN),
        "aOpt": apportionment_problem(TRAVEL, HOLDING, RIDE, sigmas=MARGIN, ride_sigmas=RIDE_MARGIN),
    }
    for name, problem in problems.items():
        samples = results.effort.calibration_samples
        results.built[name] = al.calibrate(problem, BUILT[name], TARGET, samples=samples, progress=progress)
        if results.built[name].interrupted:
            raise KeyboardInterrupt


def calibrate_margin(results: SuspensionResults, progress: Progress) -> None:
    """The loop that sections 5.6 and 6.5 describe by hand."""
    problem = robust_problem(NARROW_TRAVEL, HOLDING)
    samples = results.effort.calibration_samples
    results.calibration = al.calibrate(problem, "travel", TARGET, samples=samples, progress=progress)
    if results.calibration.interrupted:
        raise KeyboardInterrupt


def sweep_travel(results: SuspensionResults, progress: Progress) -> None:
    """Figures 6.4, 7.3, 7.4 and 7.5, from the widest travel down."""
    values = np.linspace(0.25, 0.145, results.effort.front_points)
    problems = {"dOpt": deterministic_problem(), "uOpt": robust_problem(), "aOpt": apportionment_problem(ride=RIDE)}
    for name, problem in problems.items():
        _keep(results.travel_fronts, name, al.pareto(problem, "travel", values, progress=progress))


def sweep_holding(results: SuspensionResults, progress: Progress) -> None:
    """Figures 6.5, 6.7 and 6.8, from the loosest holding down."""
    values = np.linspace(0.0365, 0.0280, results.effort.front_points)
    for name, problem in {"dOpt": deterministic_problem(), "uOpt": robust_problem()}.items():
        _keep(results.holding_fronts, name, al.pareto(problem, "holding", values, progress=progress))
        _keep(results.boxes, name, al.pareto(problem, "holding", HOLDING_BOXES, progress=progress))


def _keep(fronts: dict[str, al.Front], name: str, front: al.Front) -> None:
    """Keep what is finished of a front; one that Ctrl-C cut short ends the study, too."""
    fronts[name] = front
    if front.interrupted:
        raise KeyboardInterrupt


STAGES: dict[str, Stage] = {
    "designs": Stage(solve_designs, 0.04),
    "narrow travel": Stage(solve_narrow, 0.01),
    "evidence": Stage(sample_designs, 0.30),
    "designs to build": Stage(calibrate_designs, 0.25),
    "calibration": Stage(calibrate_margin, 0.08),
    "fronts over travel": Stage(sweep_travel, 0.22),
    "fronts over holding": Stage(sweep_holding, 0.10),
}
CALIBRATIONS = ("designs to build", "calibration")


def stages_of(effort: Effort) -> dict[str, Stage]:
    """The stages of a run: without calibrations where these have no samples."""
    return {name: one for name, one in STAGES.items() if effort.calibration_samples or name not in CALIBRATIONS}


def finished(results: SuspensionResults) -> dict[str, bool]:
    """Whether each stage of the run has come to its end."""
    holding = [*results.holding_fronts.values(), *results.boxes.values()]
    calibrated = [results.calibration] if results.calibration else []
    done = {
        "designs": len(results.designs) == 3,
        "narrow travel": len(results.narrow) == 3,
        "evidence": len(results.evidence) == 3 and len(results.narrow_evidence) == 3,
        "designs to build": _whole(results.built.values(), len(BUILT)),
        "calibration": _whole(calibrated, 1),
        "fronts over travel": _whole(results.travel_fronts.values(), 3),
        "fronts over holding": _whole(holding, 4),
    }
    return {name: done[name] for name in stages_of(results.effort)}


def _whole(parts: Collection[al.Front] | Collection[al.Calibration], count: int) -> bool:
    return len(parts) == count and not any(one.interrupted for one in parts)


def run_stage(name: str, results: SuspensionResults, progress: Progress = silent) -> None:
    """Run one stage into `results`."""
    STAGES[name].work(results, progress)
