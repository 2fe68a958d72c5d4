"""A study's design found in a second way: by direct collocation, which shares neither discretisation nor solver."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

import aleator as al
from aleator._core.progress import Progress
from aleator.reporting import Section, Table, mesh_drawing, number

SECOND_WAY = "second way"
"""The name of its stage."""

_HEADING, _DIGITS = "A second way", 8


def found_both_ways(name: str, problem: al.Problem, progress: Progress) -> al.results.CrossChecked:
    """A design by shooting and by direct collocation."""
    progress(f"{name} by direct collocation", 0, 1)
    return al.cross_check(problem)


def collocated(name: str, found: al.results.CrossChecked | None) -> dict[str, al.Solution]:
    """What the study keeps of it: the design by direct collocation, once it is found."""
    return {} if found is None else {name: found.second}


def second_way(name: str, found: al.results.CrossChecked | None) -> Section:
    """The chapter that compares both, without blocks before they are found."""
    if found is None:
        return Section(_HEADING, [])
    return Section(_HEADING, [comparison_table(name, found), mesh_drawing(found.second.meshes, name)])


def comparison_table(name: str, found: al.results.CrossChecked) -> Table:
    """Both answers, decision by decision, and the largest differences of statistics and shadow prices."""
    ways = found.first, found.second
    rows = [
        ["Status", *("solved" if one.ok else one.why() for one in ways), ""],
        ["Objective", *(number(one.objective, _DIGITS) for one in ways), _difference(found.objective)],
        *_decision_rows(found),
        ["Statistics, the largest difference", "", "", _largest(found.statistics)],
        ["Shadow prices, the largest difference", "", "", _largest(found.multipliers)],
        ["Iterations", *(str(one.effort.iterations) for one in ways), ""],
    ]
    note = (
        "Shooting integrates from the start, step by step; direct collocation makes the states at all instants "
        "variables of one sparse program, for another solver. Both have the same grid and the same expansion. "
        "Differences of decisions are relative to the range allowed for each."
    )
    said = "agree" if found.agree else "do NOT agree"
    caption = f"{name} by shooting and by direct collocation: they {said} to {number(found.tolerance, 1)}"
    return Table(caption, ["", "Shooting", "Direct collocation", "Relative difference"], rows, note)


def _decision_rows(found: al.results.CrossChecked) -> Iterator[Sequence[str]]:
    """The decisions that are free, one number each; arrays by their difference alone."""
    for name, difference in found.decisions.items():
        if name in found.first.at_bounds:
            continue
        values = [np.asarray(one.decisions[name]) for one in (found.first, found.second)]
        shown = [number(float(one), _DIGITS) if one.ndim == 0 else f"{one.size} numbers" for one in values]
        yield [name, *shown, _difference(difference) if np.isfinite(difference) else "on another mesh"]


def _largest(differences: Mapping[str, float]) -> str:
    if not differences:
        return "–"
    name, worst = max(differences.items(), key=lambda one: one[1])
    return f"{_difference(worst)} ({name})"


def _difference(value: float) -> str:
    return number(value, 3)
