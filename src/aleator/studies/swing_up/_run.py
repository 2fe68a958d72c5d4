"""The computations of the swing-up study: its searches, and its pendulums with finer steps and without friction."""

from collections.abc import Collection
from typing import Any

import equinox as eqx
import numpy as np

import aleator as al
from aleator._core.border import Progress
from aleator.journalling import kept
from aleator.studies._motion.facts import TRIED, named
from aleator.studies._motion.results import Effort, Family, MotionResults, fly
from aleator.studies.swing_up import DEGREE, ENDS, FREE, deterministic_problem, robust_problem

MEAN, EXPECTED, ENERGY = "deterministic", "robust, expected torque", "robust, expected energy"
FINER = 4
"""The refinement factor for checking the problem's steps."""

FULL = Effort(starts=7, calibration_samples=5_000)
QUICK = Effort(starts=1, samples=1_000, family=200, whole=False)

_TOGETHER = {"q1_torque": "torque", "q2": "upright", "q2_rate": "upright"}

Swing = tuple[float, int, float, int]
"""Duration (s), half swings, their width (rad), and lateness of the rise, for a motion to start a search from."""

SWINGS: tuple[Swing, ...] = (
    (3.0, 6, 0.8, 5),
    (4.0, 4, -0.8, 5),
    (3.0, 4, -0.8, 2),
    (4.0, 4, -0.8, 2),
    (3.0, 3, 0.8, 2),
    (4.0, 3, -0.8, 2),
    (3.0, 5, -0.8, 2),
)
FAMILY_SWINGS: tuple[Swing, ...] = ((3.0, 4, -0.8, 2), (3.0, 5, -0.8, 2), (4.0, 3, -0.8, 2), (3.0, 6, -0.8, 5))
"""The swings from which searches for the whole family start: late and wide ones spread it too far."""


def problems() -> dict[str, al.Problem]:
    """The problems of all plans, each with its own start."""
    bare = {
        MEAN: deterministic_problem(),
        ENERGY: robust_problem(expected="energy"),
        EXPECTED: robust_problem(expected="torque"),
    }
    return {name: named(one, _TOGETHER) for name, one in bare.items()}


def search_plans(results: MotionResults, names: Collection[str], progress: Progress) -> None:
    """The plans of these names, each from its problem's own start and several swings; the last from the optimum before
    it, too.
    """
    count = results.effort.starts
    # An empty start is the problem's own.
    starts = [{}, *(_start(*one) for one in SWINGS)][:count]
    family_starts = [{}, *(_start(*one) for one in FAMILY_SWINGS)][:count]
    declared = problems()
    results.search(MEAN, declared[MEAN], starts, progress)
    if ENERGY in names:
        plan = results.search(ENERGY, declared[ENERGY], family_starts, progress)
        family_starts = [dict(plan.decisions), *family_starts]
    results.search(EXPECTED, declared[EXPECTED], family_starts, progress)


def margin_problem(plan: al.Solution) -> al.Problem:
    """The problem of minimum energy of the expected torque, to be solved from a plan."""
    duration = float(plan.decisions["t_final"])
    return named(robust_problem(TRIED, guess=plan.decisions["motion.q1.free"], duration=duration), _TOGETHER)


def flown_finer(name: str, plan: al.Solution, count: int) -> Family:
    """The same pendulums as those of the plan's family, with smaller steps."""
    return kept(f"finer steps, {name}", fly, plan.problem, plan.vector, count, seed=2, finer=FINER)


def flown_frictionless(name: str, plan: al.Solution, count: int) -> Family:
    """The same pendulums without friction."""
    bare: Any = eqx.tree_at(lambda tree: tree.system.model.damping, plan.problem, 0.0)
    return kept(f"frictionless, {name}", fly, bare, plan.vector, count, seed=2)


def _start(duration: float, halves: int, width: float, late: int) -> dict[str, np.ndarray | float]:
    """A motion that rises `late`, superposed with `halves` half swings of growing width."""
    fractions = np.linspace(0.0, 1.0, 80)
    swing = -np.pi * (1 - fractions**late) + width * np.sin(halves * np.pi * fractions) * fractions
    return {"motion.q1.free": al.fit_control_points(swing, FREE, degree=DEGREE, **ENDS), "t_final": duration}
