"""Stretches of a sample that an earlier run has finished, and those that are left, here or by an executor."""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from typing import TypeAlias

from aleator._core.elsewhere import each_done
from aleator._core.journalled import AbstractParts
from aleator.design import refuse_other_code
from aleator.solution import Solution
from aleator.validation._stretches import Plan, Simulated, Stretch, simulated
from aleator.validation._systems import Systems

Simulate: TypeAlias = Callable[[Sequence[Stretch]], Iterator[tuple[Stretch, Simulated]]]
"""What each of some stretches finds, in order."""

# What is finished is kept so often, in seconds: a crash costs no more, and a file each time costs little.
_OFTEN = 3.0
# Calls of an executor at most: enough to share them evenly, few enough that sending a solution costs nothing.
_CALLS = 32


def part_by_part(
    stretches: Sequence[Stretch], simulate: Simulate, parts: AbstractParts
) -> Iterator[tuple[Stretch, Simulated]]:
    """What each stretch finds, in order; those at the beginning from an earlier run, as far as it came.

    What has been found since is kept every few seconds, in one part each time.
    """
    done = 0
    while done < len(stretches) and (some := parts.recall(done)) is not None:
        yield from zip(stretches[done : done + len(some)], some, strict=True)
        done += len(some)
    unkept: list[Simulated] = []
    kept_at = time.monotonic()
    for i, (stretch, found) in enumerate(simulate(stretches[done:]), done + 1):
        unkept.append(found)
        if time.monotonic() - kept_at >= _OFTEN and i < len(stretches):
            parts.keep(i - len(unkept), unkept)
            unkept, kept_at = [], time.monotonic()
        yield stretch, found


def simulated_elsewhere(
    executor: Executor, solution: Solution, plan: Plan, stretches: Sequence[Stretch]
) -> Iterator[tuple[Stretch, Simulated]]:
    """What each of some stretches finds, in order, by an executor."""
    size = max(-(-len(stretches) // _CALLS), 1)
    shares = [stretches[first : first + size] for first in range(0, len(stretches), size)]
    calls = [{"solution": solution, "plan": plan, "stretches": tuple(one)} for one in shares]
    waiting: dict[int, Sequence[Simulated]] = {}
    following = 0
    for i, found in each_done(executor, _simulated_there, calls, ["validate"] * len(calls)):
        waiting[i] = found
        while following in waiting:
            yield from zip(shares[following], waiting.pop(following), strict=True)
            following += 1


def _simulated_there(solution: Solution, plan: Plan, stretches: Sequence[Stretch]) -> list[Simulated]:
    refuse_other_code(solution.problem)
    return [found for _, found in simulated(Systems(solution, "validate"), plan, stretches)]
