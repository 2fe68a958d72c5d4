"""Time-optimal robust motions by inverse dynamics against the same programs in CasADi with IPOPT, in one run.

    python benchmarks/motion.py

Both start from the same control points. CasADi has its exact sparse Jacobian, mapped over instants, and is timed with
the Hessian that is faster for it here (L-BFGS for both robust problems; `casadi_motion.main` prints the exact one too).
Times are wall times of solutions when warm: compiled, or constructed, before. The two take turns, and the ratio is the
median of those of the turns: the speed of a machine that is shared changes from minute to minute. The solvers' optima
are printed beside, for a time to another optimum does not compare.
"""

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from casadi_motion import PLANAR_GOAL, PLANAR_START, Plan, pick_and_place_time, six_axis_arm, straight_line
from rich.console import Console
from rich.table import Table

import aleator as al
from aleator.studies import pick_and_place_time as planar

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import six_axis_arm as six_axis  # pyright: ignore[reportMissingImports]

TURNS = 15


class Case(NamedTuple):
    """A problem, its start, and the same in CasADi."""

    name: str
    problem: al.Problem
    points: np.ndarray
    peer: Callable[..., Plan]


def cases() -> list[Case]:
    """The two-link arm with 18 points of one germ variable, the six-axis arm with 30 of two."""
    line = straight_line((PLANAR_START, PLANAR_GOAL), 0.5, 5)
    reach = straight_line((six_axis.START, six_axis.TARGET), 0.2, 1)
    return [
        Case(
            "two links, 18 points",
            planar.robust_problem(1.0),
            line,
            lambda **options: pick_and_place_time(1.0, perturbation=0.5, seed=5, **options),
        ),
        Case(
            "six axes, 30 points",
            six_axis.robust_problem(1.0),
            reach,
            lambda **options: six_axis_arm(1.0, perturbation=0.2, seed=1, **options),
        ),
    ]


def ours(case: Case) -> tuple[al.Solution, float]:
    """The solution, and the time it took, s."""
    start: dict[str, Any] = {"motion.free": case.points, "t_final": 2.0}
    began = time.perf_counter()
    solution = al.solve(case.problem, start=start, between=1)
    return solution, time.perf_counter() - began


def theirs(case: Case) -> tuple[Plan, float]:
    """CasADi's plan, and the time of its solution alone, s."""
    plan = case.peer(limited_memory=True)
    return plan, plan.solution


def main() -> None:
    """Print times, optima and evaluations side by side."""
    table = Table(
        "problem", "tool", "optimum, s", "iterations", "evaluations", "construct or compile, s", "solve warm, s"
    )
    console, ratios = Console(width=140), []
    for case in cases():
        first = ours(case)[1]
        turns = [(ours(case), theirs(case)) for _ in range(TURNS)]
        (solution, _), (plan, _) = turns[-1]
        warm, peer = (statistics.median(turn[i][1] for turn in turns) for i in range(2))
        faster = [other[1] / one[1] for one, other in turns]
        table.add_row(
            case.name,
            "aleator, filterSQP",
            f"{solution.objective:.8f}",
            str(solution.effort.iterations),
            str(solution.effort.evaluations),
            f"{first - warm:.2f}",
            f"{warm:.3f}",
        )
        table.add_row(
            "",
            "CasADi, IPOPT",
            f"{plan.optimum:.8f}",
            str(plan.iterations),
            str(plan.evaluations["jac_g"]),
            f"{plan.construction:.2f}",
            f"{peer:.3f}",
        )
        lower, middle, upper = statistics.quantiles(faster, n=4)
        ratios.append(f"{case.name}: {middle:.1f} times faster when warm (quartiles {lower:.1f}, {upper:.1f})")
    console.print(table)
    console.print("\n".join(ratios))


if __name__ == "__main__":
    main()
