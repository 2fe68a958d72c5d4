"""Tables and cards of every motion study's plans, and the names of its limits."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import equinox as eqx

import aleator as al
from aleator.reporting import Card, Table, count, interval, number, percent, words
from aleator.studies._shared import violation_rows


def named(problem: al.Problem, together: Mapping[str, str]) -> al.Problem:
    """The problem with renamed constraints; those of one name count as one limit."""
    constraints = tuple(one.named(together.get(one.name, one.name)) for one in problem.constraints)
    changed: Any = eqx.tree_at(lambda tree: tree.constraints, problem, constraints)
    return changed


def duration(plan: al.Solution) -> float:
    """The duration of a plan, s."""
    return float(plan.instants[-1])


def held_by(plan: al.Solution) -> str:
    """The active limits of a plan; the bounds of an array of decisions count as one."""
    bounds = {name: f"bounds of {name.split('[')[0].removesuffix('.free')}" for name in plan.at_bounds}
    return words(list(dict.fromkeys(bounds.get(name, name) for name in plan.active)), "nothing")


def plans_table(
    plans: Mapping[str, al.Solution], evidence: Mapping[str, al.results.Evidence], measures: Mapping[str, str]
) -> Table:
    """The plans side by side: objective, duration, active limits, and how often fresh systems break a limit."""
    every = list(plans.values())
    rows = [
        ["Status", *("solved" if one.ok else "not solved: see the verdict" for one in every)],
        ["Minimised", *(measures[name] for name in plans)],
        ["Its value", *(number(one.objective, 5) for one in every)],
        ["Duration", *(number(duration(one), 4, "s") for one in every)],
        ["Active limits", *(held_by(one) for one in every)],
    ]
    found = [evidence.get(name) for name in plans]
    rows += violation_rows(found, "Systems that break")
    if any(found):
        rows.append(["Fresh systems counted", *(count(one.samples) if one else "–" for one in found)])
    instants = words([count(one) for one in sorted({one.instants for one in found if one and one.instants})])
    note = (
        f"Counted on fresh random systems without the expansion, over time at {instants} instants; in brackets 95 %"
        " confidence."
    )
    return Table("Plans, limits and violations", ["", *plans], rows, note if any(found) else "")


def optima_table(searches: Mapping[str, al.results.Starts]) -> Table:
    """The local optima found by each search, best first, with the number of starts that led to each."""
    rows = []
    for name, search in searches.items():
        total = len(search.solutions)
        for i, (plan, led) in enumerate(search.optima):
            shown = name if i == 0 else ""
            rows.append([shown, number(plan.objective, 5), number(duration(plan), 4), f"{led} of {total}"])
        if failed := sum(not one.ok for one in search.solutions):
            rows.append([name if not search.optima else "", "no optimum reached", "–", f"{failed} of {total}"])
    note = (
        "The problem is not convex: each start leads to a local optimum nearby, or to none. The plan is the best of "
        "them, but there may be a better one. Plans of equal objective, such as mirrored ones, count as one."
    )
    return Table("Local optima of the searches", ["Plan", "Objective", "Duration (s)", "Starts"], rows, note)


def violation_cards(evidence: Mapping[str, al.results.Evidence], names: Sequence[str], what: str) -> Iterator[Card]:
    """How often the systems of some plans break a limit."""
    for name in names:
        if one := evidence.get(name):
            note = f"95 % confidence: {interval(one.joint)}"
            yield Card(f"{name}: systems that break {what}", percent(one.joint.estimate), note)
