"""Numbers, tables and verdicts of motion studies: what they plan, what a margin costs, which plan to build.

The margin of one standard deviation in the dissertation leaves a fifth to two fifths of the systems beyond a limit. So
every study calibrates a margin until fresh systems confirm it for `TARGET`, counting all limits of the problem jointly.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np

import aleator as al
from aleator.reporting import (
    Block,
    Card,
    Table,
    Verdict,
    count,
    given,
    interval,
    number,
    percent,
    share_text,
    words,
)
from aleator.studies._shared import margin_drawing, signed, violation_rows

TARGET = 0.01
"""The share of systems that may break any limit."""

CALIBRATED = "calibrated"

TRIED = 1.6
"""The margin at which the search starts: four in a hundred of a uniform distribution lie beyond it on one side."""

SAME_SIZE = 0.1
"""Changes agree in size if they differ by at most this fraction of the published one."""


def meets(found: al.results.Calibration | None) -> bool:
    """Whether fresh systems confirm a calibrated plan, and its other limits hold as often as the calibrated ones."""
    if found is None or found.evidence is None:
        return False
    return found.confirmed and found.evidence.joint.upper <= found.target


def price(built: float, printed: float, unit: str) -> str:
    """A plan's cost compared with that at the published margin: `113.0 J, 0.8 % more than with a = 1 (112.1 J)`."""
    change = built / printed - 1
    side = "more" if change >= 0 else "less"
    return f"{number(built, 4, unit)}, {percent(abs(change))} {side} than with a = 1 ({number(printed, 4, unit)})"


def build_verdict(
    found: al.results.Calibration | None,
    printed: al.Solution,
    *,
    unit: str,
    who: str,
    beside: str = "",
    sentences: Sequence[str] = (),
    cards: Sequence[Card] = (),
) -> Verdict:
    """Whether there is a design to build, which it is, and its cost compared with the `printed` one.

    - `unit`: of the objective; `who`: what the systems are called; `beside`: a further sentence about the plan.
    """
    if found is None:
        headline = (
            f"No design to build yet: no margin was calibrated at which at most {given(100 * TARGET)} % of the {who} "
            "break a limit."
        )
        return Verdict("caution", "Not calibrated", headline, sentences, cards)
    cost = price(found.solution.objective, printed.objective, unit)
    plan = f"the calibrated plan, a = {number(found.sigmas, 3)}, for {cost}"
    if meets(found):
        headline = f"{plan[0].upper()}{plan[1:]}: {found.sentence(who)}.{beside}"
        return Verdict("good", "Build", headline, sentences, cards)
    why = found.sentence(who)
    if found.confirmed and found.evidence is not None:
        why = f"confirmed for its margins alone: {share_text(found.evidence.joint)} of the {who} break some limit"
    headline = f"No design to build: the best is {plan}. It is {why}."
    return Verdict("bad", "Not confirmed", headline, sentences, cards)


def price_table(
    plans: Mapping[str, al.Solution],
    evidence: Mapping[str, al.results.Evidence],
    sigmas: Mapping[str, float],
    printed: str,
    measure: str,
) -> Table:
    """The cost of each margin, and how often it fails; `sigmas` are those of the plans to show."""
    rows = []
    for name, margin in sigmas.items():
        if name in plans and printed in plans:
            change = plans[name].objective / plans[printed].objective - 1
            found = evidence.get(name)
            rows.append(
                [
                    name,
                    number(margin, 4),
                    number(plans[name].objective, 5),
                    "–" if name == printed else signed(change),
                    share_text(found.joint) if found else "–",
                ]
            )
    header = ["Plan", "Margin a", measure[:1].upper() + measure[1:], "Beside a = 1", "Systems that break any limit"]
    return Table("What a margin costs", header, rows)


def margin_blocks(found: al.results.Calibration | None, prices: Table, who: str) -> Iterator[Block]:
    """The chapter on margins: their costs, and the search for the confirmed one."""
    if prices.rows:
        yield prices
    if found is not None:
        yield margin_drawing(found, "The margin for a tolerated share of violations", who)


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


def compared(printed: Mapping[str, float], ours: Mapping[str, float], what: str) -> str:
    """Whether `what` agrees between plans of the same names, in a sentence; others are relative to the first plan.

    Signs agree if every plan changes the first one's value in the same direction, orders if they are the same from
    smallest to largest, sizes if the relative changes differ by at most a tenth of the published ones.
    """
    names = [name for name in printed if name in ours and np.isfinite(ours[name])]
    if len(names) < 2:
        return ""
    theirs, found = (_changes([values[name] for name in names]) for values in (printed, ours))
    said = {
        "signs": bool(np.all(np.sign(theirs) == np.sign(found))),
        "order": _order(printed, names) == _order(ours, names),
        "sizes": bool(np.all(np.abs(found - theirs) <= SAME_SIZE * np.abs(theirs))),
    }
    yes, no = ([one for one in said if said[one] is told] for told in (True, False))
    parts = [f"{words(yes)} agree"] * bool(yes) + [f"{words(no)} do not{'' if yes else ' agree'}"] * bool(no)
    changes = [
        f"{name} {signed(one)} (published {signed(other)})"
        for name, one, other in zip(names[1:], found, theirs, strict=True)
    ]
    return f"Of {what}, {', '.join(parts)}: relative to {names[0]}, {words(changes)}."


def _changes(values: Sequence[float]) -> np.ndarray:
    return np.array(values[1:]) / values[0] - 1


def _order(values: Mapping[str, float], names: Sequence[str]) -> list[str]:
    return sorted(names, key=lambda name: values[name])
