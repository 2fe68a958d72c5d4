"""What every study of motion says of its plans: tables, the cases in which there is no recommendation, drawings."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

import aleator as al
from aleator.reporting import (
    Card,
    Drawing,
    Scene,
    Table,
    Verdict,
    count,
    interval,
    linkage_animation,
    looks,
    number,
    percent,
    plane_figure,
    share_text,
    unresolved,
    words,
)
from aleator.studies._motion.family import Family

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

Outputs = Mapping[str, Float[np.ndarray, "..."]]

SHADES = "Line: mean. Dark band: one σ to each side. Light band: from the least to the largest of all systems."


def named(problem: al.Problem, together: Mapping[str, str]) -> al.Problem:
    """The problem with its constraints by other names: those of one name count as one limit."""
    constraints = tuple(one.named(together.get(one.name, one.name)) for one in problem.constraints)
    changed: Any = eqx.tree_at(lambda tree: tree.constraints, problem, constraints)
    return changed


def duration(plan: al.Solution) -> float:
    """How long a plan takes, s."""
    return float(plan.instants[-1])


def held_by(plan: al.Solution) -> str:
    """What holds a plan where it is; the bounds of an array of decisions count as one."""
    bounds = {name: f"bounds of {name.split('[')[0].removesuffix('.free')}" for name in plan.at_bounds}
    return words(list(dict.fromkeys(bounds.get(name, name) for name in plan.active)), "nothing")


def plans_table(
    plans: Mapping[str, al.Solution], evidence: Mapping[str, al.Evidence], measures: Mapping[str, str]
) -> Table:
    """The plans side by side: objective, duration, what holds them, and how often fresh systems break a limit."""
    every = list(plans.values())
    rows = [
        ["Status", *("solved" if one.ok else "not solved: see the verdict" for one in every)],
        ["Minimised", *(measures[name] for name in plans)],
        ["Its value", *(number(one.objective, 5) for one in every)],
        ["Duration", *(number(duration(one), 4, "s") for one in every)],
        ["Held by", *(held_by(one) for one in every)],
    ]
    found = [evidence.get(name) for name in plans]
    for limit in dict.fromkeys(limit for one in found if one for limit in one.violations):
        shares = (share_text(one.violations.get(limit)) if one else "–" for one in found)
        rows.append([f"Systems that break {limit}", *shares])
    if any(found):
        rows.append(["Systems that break any limit", *(share_text(one.joint) if one else "–" for one in found)])
        rows.append(["Fresh systems counted", *(count(one.samples) if one else "–" for one in found)])
    instants = words([count(one) for one in sorted({one.instants for one in found if one and one.instants})])
    note = (
        f"Counted on fresh random systems without the expansion, over time at {instants} instants; in brackets 95 %"
        " confidence."
    )
    return Table("Plans, limits and violations", ["", *plans], rows, note if any(found) else "")


def optima_table(searches: Mapping[str, al.Starts]) -> Table:
    """The local optima that each search found, best first, and how many starts led to each."""
    rows = []
    for name, search in searches.items():
        total = len(search.solutions)
        for i, (plan, led) in enumerate(search.optima):
            shown = name if i == 0 else ""
            rows.append([shown, number(plan.objective, 5), number(duration(plan), 4), f"{led} of {total}"])
        if failed := sum(not one.ok for one in search.solutions):
            rows.append([name if not search.optima else "", "no optimum reached", "–", f"{failed} of {total}"])
    note = (
        "The problem is not convex: each start leads to the optimum of its own valley, or to none. The best of them is"
        " the plan; that there is no better one is not proved. Plans of equal objective count as one, mirrored ones"
        " too."
    )
    return Table("Local optima of the searches", ["Plan", "Objective", "Duration (s)", "Starts"], rows, note)


def no_recommendation(
    plans: Mapping[str, al.Solution],
    evidence: Mapping[str, al.Evidence],
    names: Sequence[str],
    sentences: Sequence[str],
    cards: Sequence[Card],
) -> Verdict | None:
    """The verdict where something is missing, not solved or not resolved; None where all plans can be judged."""
    if failed := [name for name, one in plans.items() if not one.ok]:
        why = [f"{name}: {plans[name].why()}" for name in failed]
        headline = f"{words(failed)} could not be solved: no recommendation."
        return Verdict("bad", "Not solved", headline, [*why, *sentences], cards)
    if not set(names) <= set(evidence):
        headline = "The study was stopped before its evidence: no recommendation yet."
        return Verdict("caution", "Incomplete", headline, sentences, cards)
    if coarse := unresolved(plans):
        headline = f"The expansion of {words(list(coarse))} is too coarse to trust."
        return Verdict("bad", "Not resolved", headline, sentences, cards)
    return None


def violation_cards(evidence: Mapping[str, al.Evidence], names: Sequence[str], what: str) -> Iterator[Card]:
    """How often the systems of some plans break a limit."""
    for name in names:
        if one := evidence.get(name):
            note = f"95 % confidence: {interval(one.joint)}"
            yield Card(f"{name}: systems that break {what}", percent(one.joint.estimate), note)


Joints = Callable[[Outputs], Float[np.ndarray, "... joints 2"]]


def animations(
    families: Mapping[str, Family],
    names: Sequence[str],
    joints: Joints,
    target: Sequence[float],
    scene: Scene,
    every: Sequence[str],
    figure: str = "",
) -> Drawing:
    """Some plans flown on their families, side by side; `every` are all plans of the study, which gives the colours.

    `figure` is the number of the figure in the dissertation that shows the same.
    """
    figures = [
        linkage_animation(
            families[name].times,
            joints(families[name].systems),
            joints(families[name].nominal),
            look=looks(every)[name],
            scene=scene,
            target=target,
            title=name.capitalize(),
        )
        for name in names
    ]
    caption = "Press play, or drag the slider. Thin: random systems under the same plan. Thick: the nominal one."
    return Drawing(figures, "The plans in motion", caption, figure)


def tip_paths(
    family: Family,
    name: str,
    joints: Joints,
    target: Sequence[float],
    scene: Scene,
    broken: np.ndarray,
    every: Sequence[str],
) -> "Figure":
    """Where the tip of each system goes, and which systems break a limit on the way."""
    return plane_figure(
        joints(family.systems)[..., -1, :],
        joints(family.nominal)[..., -1, :],
        look=looks(every)[name],
        scene=scene,
        target=target,
        broken=broken,
        title=name.capitalize(),
    )
