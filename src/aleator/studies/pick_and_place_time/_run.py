"""The computations of the time-optimal study: starts of its searches, and numbers of samples."""

import numpy as np

import aleator as al
from aleator._core.border import Progress
from aleator.studies._motion.build import TRIED
from aleator.studies._motion.facts import named
from aleator.studies._motion.results import Effort, MotionResults
from aleator.studies.pick_and_place_time import deterministic_problem, robust_problem
from aleator.studies.two_link_arm._views import TOGETHER

MEAN, ONE, WORST = "deterministic", "robust, a = 1", "robust, a = √3"
SIGMAS = {ONE: 1.0, WORST: float(np.sqrt(3.0))}

FULL = Effort(starts=16)
QUICK = Effort(starts=3, samples=4_000, family=400, calibration_samples=2_000, whole=False)


def problems() -> dict[str, al.Problem]:
    """The problems of all plans, each with its own start."""
    bare = {MEAN: deterministic_problem(), **{name: robust_problem(sigmas) for name, sigmas in SIGMAS.items()}}
    return {name: named(one, TOGETHER) for name, one in bare.items()}


def search_plans(done: MotionResults, progress: Progress) -> None:
    """Each plan from several starts: the first from random ones, the robust ones also from the optima before."""
    plan = done.search(MEAN, problems()[MEAN], done.effort.starts, progress)
    for name, sigmas in SIGMAS.items():
        problem = named(robust_problem(sigmas, guess=plan.decisions["motion.free"]), TOGETHER)
        earlier = [dict(one.decisions) for search in done.searches.values() for one, _ in search.optima[:4]]
        plan = done.search(name, problem, earlier, progress)
    done.solve_at_instants()


def margin_problem(plan: al.Solution) -> al.Problem:
    """The problem of section 5.6, to be solved from a plan."""
    return named(robust_problem(TRIED, guess=plan.decisions["motion.free"]), TOGETHER)
