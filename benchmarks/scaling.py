"""What more cores bring: evidence of a million systems, fronts and searches by one worker and by two.

    python benchmarks/scaling.py [evidence] [sweep] [search] [--samples N] [--designs N] [--evaluations N]

Without a name, all are measured. `evidence`: `al.validate` of the suspension's robust design, compilation included:
asked are less than 60 s on two cores and less than 4 GiB. `sweep`: that many robust designs of the suspension along its
limit on travel, workers begun anew each time, with programs that an earlier run has compiled: asked is a ratio of 1.6.
`search`: differential evolution of the same design, whose generations are simulated here, by one worker, and by two.
Their objectives must be the same to the last bit.

Wall times mean something on an idle machine alone. CPU seconds (user and system, of this process or of the workers that
have ended) do so under load as well; the ratio that they would allow, `one / (two / 2)`, supposes that the work of two
workers is shared evenly.
"""

import argparse
import resource
import time
from contextlib import nullcontext
from dataclasses import replace
from typing import NamedTuple

import numpy as np

import aleator as al
from aleator.studies.suspension import robust_problem

_WHAT = ["evidence", "sweep", "search"]


class Spent(NamedTuple):
    """Seconds by the clock, and CPU seconds of this process and of its children."""

    wall: float
    own: float
    workers: float


def now() -> Spent:
    """The time so far; that of children counts once they have ended."""
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return Spent(time.perf_counter(), own.ru_utime + own.ru_stime, children.ru_utime + children.ru_stime)


def since(before: Spent) -> Spent:
    """The time since then."""
    return Spent(*(later - earlier for later, earlier in zip(now(), before, strict=True)))


def evidence(samples: int) -> None:
    """Fresh systems of one design, on all cores of this process."""
    solution = al.solve(robust_problem())
    begun = now()
    found = al.validate(solution, samples)
    spent = since(begun)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"evidence of {samples} systems: {spent.wall:.1f} s, {spent.own:.1f} CPU s, at most {peak:.2f} GiB")
    print("\n".join(f"  violates {name}: {share}" for name, share in found.violations.items()))


def sweep(designs: int) -> None:
    """A front by one worker and by two, start included."""
    values = np.linspace(0.19, 0.23, designs)
    with al.workers(1) as executor:  # Both find the same compiled programs.
        al.pareto(robust_problem(), "travel", values[:2], executor=executor)
    times, objectives = [], []
    for count in (1, 2):
        begun = now()
        with al.workers(count) as executor:
            front = al.pareto(robust_problem(), "travel", values, executor=executor)
        times.append(since(begun))
        objectives.append(front.objectives)
        solved = sum(point.ok for point in front.points)
        print(
            f"{designs} designs by {count} worker(s): {times[-1].wall:.1f} s, {times[-1].workers:.1f} CPU s of "
            f"workers, {times[-1].own:.1f} here; {solved} solved"
        )
    one, two = times
    print(f"  by the clock {one.wall / two.wall:.2f} times as fast; CPU seconds allow", end=" ")
    print(f"{(one.own + one.workers) / (two.own + two.workers / 2):.2f} times")
    print(f"  the same to the last bit: {objectives[0].tobytes() == objectives[1].tobytes()}")


def search(evaluations: int) -> None:
    """A search whose generations are simulated here by one thread, by one worker and by two, start included."""
    al.threads(1)
    solver = al.solvers.DifferentialEvolution(evaluations=evaluations, polish=False)
    for count in (None, 1, 2):
        # The first time compiles, for all.
        for budget in (solver.population, evaluations) if count is None else (evaluations,):
            own, begun = replace(solver, evaluations=budget), now()
            with nullcontext() if count is None else al.workers(count) as executor:
                found = al.solve(robust_problem(), own, executor=executor, throw=False)
            spent = since(begun)
        whose = "here" if count is None else f"by {count} worker(s)"
        print(f"{evaluations} designs {whose}: {spent.wall:.1f} s, {spent.workers:.1f} CPU s of workers, ", end="")
        print(f"{spent.own:.1f} here; the objective is {found.objective.hex()}")


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", choices=_WHAT, default=_WHAT)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--designs", type=int, default=40)
    parser.add_argument("--evaluations", type=int, default=1000)
    asked = parser.parse_args()
    if "evidence" in asked.what:
        evidence(asked.samples)
    if "sweep" in asked.what:
        sweep(asked.designs)
    if "search" in asked.what:
        search(asked.evaluations)


if __name__ == "__main__":
    main()
