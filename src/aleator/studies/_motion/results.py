"""The computations of a motion study: searches from several starts, a margin, evidence, and families of systems."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import aleator as al
from aleator._core.arrays import numbers_to_arrays
from aleator._core.border import Progress
from aleator._core.compilation import Compiled
from aleator.design import grid_at, history, uncertain
from aleator.dynamics import History
from aleator.ensemble import at_levels, few_at_once, random_levels
from aleator.journalling import kept
from aleator.studies._motion.facts import CALIBRATED, TARGET
from aleator.studies._staged import stop_if_interrupted
from aleator.validation import finer_by

KEPT = 25
PRECISION = 0.2
"""How closely below its aim a margin is sought: half a per cent of an objective is at stake between a = 1 and the worst
case, and each trial is a search with its count."""


@final
@dataclass(frozen=True)
class Family:
    """One plan on many random systems.

    - `times`: the instants, shape (instants,), s;
    - `nominal`: the outputs of the system at the median of every distribution, by name, shape (instants,);
    - `systems`: those of the random systems, shape (systems, instants);
    - `extremes`: the minimum and maximum of each output of each random system, shape (systems, 2); between the instants
      too, where the plan holds its limits there.
    """

    times: Float[np.ndarray, " instants"]
    nominal: Mapping[str, Float[np.ndarray, " instants"]]
    systems: Mapping[str, Float[np.ndarray, "systems instants"]]
    extremes: Mapping[str, Float[np.ndarray, "systems 2"]]


def _histories(problem: al.Problem, germ: Float[Array, "systems variables"], decisions: Float[Array, " n"]) -> History:
    return jax.vmap(lambda point: history(problem, point, decisions))(germ)


def _extremes(
    problem: al.Problem, germ: Float[Array, "systems variables"], decisions: Float[Array, " n"]
) -> dict[str, Float[Array, "systems 2"]]:
    def one(point: Float[Array, " variables"]) -> dict[str, Float[Array, " 2"]]:
        found = history(problem, point, decisions)
        return {name: jnp.stack([rows.min(), rows.max()]) for name, rows in found.items()}

    return few_at_once(one, germ)


HISTORIES = Compiled(_histories)
EXTREMES = Compiled(_extremes)


def fly(problem: al.Problem, decisions: Any, count: int, *, seed: int = 0, finer: int = 1, between: int = 1) -> Family:
    """Simulate a problem's systems at given decisions: `count` random ones, and the nominal one.

    The grid has `finer` times as many steps; extremes are taken on one with `between` times as many again. A
    deterministic problem is flown on the family it stands for, and the same seed draws the same systems.
    """
    bare = _bare(problem, finer)
    germs = bare.placements.germs.values()
    levels = random_levels(np.random.default_rng(seed), count + 1, len(germs))
    levels[0] = 0.5
    drawn = at_levels(germs, levels)
    x = jnp.asarray(decisions)
    found = HISTORIES(numbers_to_arrays(bare), jnp.asarray(drawn), x)
    systems = {name: np.asarray(rows)[1:] for name, rows in found.items()}
    if between == 1:
        extremes = {name: np.stack([rows.min(axis=1), rows.max(axis=1)], axis=1) for name, rows in systems.items()}
    else:
        extremes = EXTREMES(numbers_to_arrays(_bare(problem, finer * between)), jnp.asarray(drawn[1:]), x)
    return Family(
        times=np.asarray(grid_at(bare, x).times),
        nominal={name: np.asarray(rows)[0] for name, rows in found.items()},
        systems=systems,
        extremes={name: np.asarray(rows) for name, rows in extremes.items()},
    )


def _bare(problem: al.Problem, finer: int) -> Any:
    """The systems of a problem alone, since objectives and constraints would be compiled anew for every plan."""
    whole: Any = uncertain(problem)
    anything = al.terminal(whole.system.model.coordinates[0]).mean
    return al.Problem(whole.system, grid=whole.grid.finer(finer), minimize=anything)


@final
@dataclass(frozen=True)
class Effort:
    """How much is computed.

    - `starts`: of the search for each plan;
    - `samples`: Monte Carlo samples of the evidence; `family`: systems of which every output is kept;
    - `front_points`: on a front; `calibration_samples`: of each trial of a margin;
    - `whole`: whether the parts that a quick run skips are computed too; the study names them (`left_out`).
    """

    starts: int
    samples: int = 20_000
    family: int = 2_000
    front_points: int = 7
    calibration_samples: int = 10_000
    whole: bool = True


@final
@dataclass
class MotionResults:
    """Everything that a motion study has finished so far, by the names of its plans.

    - `searches`: every start of each plan's search; `plans`: the best of each;
    - `coarse`: the plans with limits only at the instants of the grid, as in the reference;
    - `calibration`: the margin that meets the target for violations; its plan is one of the plans;
    - `evidence`: counts on fresh systems; `families`: some of these systems with every output.
    """

    effort: Effort
    searches: dict[str, al.results.Starts] = field(default_factory=dict)
    plans: dict[str, al.Solution] = field(default_factory=dict)
    coarse: dict[str, al.Solution] = field(default_factory=dict)
    calibration: al.results.Calibration | None = None
    evidence: dict[str, al.results.Evidence] = field(default_factory=dict)
    families: dict[str, Family] = field(default_factory=dict)

    def search(
        self, name: str, problem: al.Problem, starts: int | Sequence[Mapping[str, Any]], progress: Progress
    ) -> al.Solution:
        """Solve for a plan from several starts and keep the best, even of a search interrupted by Ctrl-C."""
        found = al.multistart(problem, starts, progress=lambda _, done, total: progress(name, done, total))
        self.searches[name] = found
        if found.best.ok or not found.interrupted:
            self.plans[name] = found.best
        stop_if_interrupted(found)
        return found.best

    def solve_at_instants(self) -> None:
        """The same plans with limits only at the instants of the grid, for comparison with the reference."""
        for name, plan in self.plans.items() if self.effort.whole else ():
            self.coarse[name] = al.solve(plan.problem, start=plan.decisions, between=1, throw=False)

    def calibrate(self, problem: al.Problem, limits: Sequence[str], progress: Progress) -> None:
        """Find the margin at which at most `TARGET` of the systems break a limit, and keep its plan and evidence."""
        samples = self.effort.calibration_samples
        found = al.calibrate(problem, limits, TARGET, samples=samples, precision=PRECISION, progress=progress)
        self.calibration = found
        stop_if_interrupted(found)
        self.plans[CALIBRATED] = found.solution
        if found.evidence is not None:
            self.evidence[CALIBRATED] = found.evidence

    def gather_evidence(self, progress: Progress) -> None:
        """Count on fresh systems how often each plan breaks its limits; for a calibrated one this is known."""
        for name, plan in self.plans.items():
            if name not in self.evidence:
                self.evidence[name] = al.validate(plan, self.effort.samples, seed=1, keep=KEPT, progress=progress)

    def fly_families(self, progress: Progress) -> None:
        """Fly each plan on its family and keep every output."""
        for i, (name, plan) in enumerate(self.plans.items()):
            progress(f"family, {name}", i, len(self.plans))
            self.families[name] = self.flown(f"family, {name}", plan, plan.problem, seed=2)

    def flown(self, called: str, plan: al.Solution, problem: al.Problem, *, seed: int) -> Family:
        """A plan on the systems of a problem, with extremes between the instants too, except in a quick run."""
        between = finer_by(plan) if self.effort.whole else 1
        return kept(called, fly, problem, plan.vector, self.effort.family, seed=seed, between=between)
