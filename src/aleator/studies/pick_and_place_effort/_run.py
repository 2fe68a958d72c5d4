"""The computations of the effort-optimal study: its plans, a front between two of them, and a wider payload."""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

import aleator as al
from aleator._core.border import Progress
from aleator.journalling import kept
from aleator.studies._motion.facts import TRIED, named
from aleator.studies._motion.results import Effort, Family, MotionResults
from aleator.studies.pick_and_place_effort import (
    DURATION,
    PAYLOAD,
    deterministic_problem,
    robust_problem,
    start_torques,
    terminal_variance_problem,
)
from aleator.studies.two_link_arm import TORQUE
from aleator.studies.two_link_arm._views import TOGETHER
from aleator.transcription import transcribe

MEAN, ROBUST, LEAST = "deterministic", "robust", "least variance"
WIDE = al.Uniform(1.0, std=0.5)
BENDS = (1.2, 0.6, 2.5)
"""The bend of the elbow on the paths from which searches start, besides the problem's own, rad."""

MOST = 2 * TORQUE**2 * DURATION
"""The effort of both torques at their limits throughout: no plan takes more."""

FULL = Effort(starts=4)
QUICK = Effort(starts=1, samples=2_000, family=400, calibration_samples=2_000, whole=False)
PAYLOADS = (PAYLOAD, WIDE)
"""The payload of the study, and one with five times the spread."""


def problems() -> dict[str, al.Problem]:
    """The problems of all plans."""
    bare = {
        MEAN: deterministic_problem(),
        ROBUST: robust_problem(),
        LEAST: terminal_variance_problem(effort=MOST),
    }
    return {name: named(one, TOGETHER) for name, one in bare.items()}


def search_plans(done: MotionResults, names: Collection[str], progress: Progress) -> None:
    """Deterministic from bent paths; those of `names` from the plans before them, and from these paths as well."""
    # An empty start is the problem's own.
    bent = [{}, *({"torque.free": start_torques(bend)} for bend in BENDS)][: done.effort.starts]
    declared = problems()
    plan = done.search(MEAN, declared.pop(MEAN), bent, progress)
    for name in (name for name in declared if name in names):
        plan = done.search(name, declared[name], [dict(plan.decisions), *bent[1:]], progress)
    done.solve_at_instants()


def margin_problem(plan: al.Solution) -> al.Problem:
    """The problem of least effort, to be solved from a plan."""
    return named(robust_problem(TRIED, guess=plan.decisions["torque.free"]), TOGETHER)


def sweep_effort(
    least: al.Solution, robust: al.Solution, most: float, points: int, progress: Progress
) -> al.results.Front:
    """The minimum terminal variance for each effort, from where more effort brings no gain down to the robust plan."""
    problem = named(terminal_variance_problem(effort=MOST, guess=least.decisions["torque.free"]), TOGETHER)
    return al.pareto(problem, "effort", np.linspace(most, 1.01 * robust.objective, points), progress=progress)


class Spread(NamedTuple):
    """The spread of a joint at the end: sampled, by the expansion, and its leave-one-out error."""

    sampled: float
    expanded: float
    error: float


def on_payload(done: MotionResults, payload: al.Uniform) -> tuple[Family, dict[str, Spread]]:
    """The robust plan on another payload: its family, and its joints' final spread, sampled and by the expansion."""
    plan, problem = done.plans[ROBUST], named(robust_problem(payload=payload), TOGETHER)
    family = done.flown(f"family of payload {payload}", plan, problem, seed=3)
    ends = kept(f"expansion on payload {payload}", expanded_ends, problem, plan.vector)
    return family, {name: Spread(float(family.systems[name][:, -1].std()), *one) for name, one in ends.items()}


def expanded_ends(problem: al.Problem, decisions: Float[np.ndarray, " n"]) -> dict[str, tuple[float, float]]:
    """The standard deviation of each joint's final angle by the expansion, rad, and its leave-one-out error."""
    resolved = transcribe(problem).resolve(decisions)
    ends = {name: resolved[f"{name}(t_f)"] for name in ("q1", "q2")}
    return {name: (float(one.std), float(one.leave_one_out)) for name, one in ends.items()}
