"""The stages that several studies share: designs solved, sampled and swept, a margin, and a design in a second way."""

from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

import aleator as al
from aleator.reporting import Drawing, Table, calibration_figure, given, mesh_drawing, number, percent
from aleator.studies._study import Draft

if TYPE_CHECKING:
    import xarray

_DIGITS = 8


def picture(place: str) -> str:
    """A drawing of a study as SVG, by its file: `suspension/car.svg`."""
    return (resources.files("aleator.studies") / place).read_text(encoding="utf-8")


def solved(page: Draft, problems: Mapping[str, al.Problem], group: str = "designs") -> dict[str, al.Solution]:
    """The designs of problems by name, kept as a group."""
    designs = dict[str, al.Solution]()
    for i, (name, problem) in enumerate(problems.items()):
        page.progress(f"design {name}", i, len(problems))
        designs[name] = al.solve(problem)
        page.keep(group, {name: designs[name]})
    return designs


def sampled(
    page: Draft, designs: Mapping[str, al.Solution], samples: int, group: str = "evidence"
) -> dict[str, al.results.Evidence]:
    """Evidence on designs by their names, kept as a group."""
    evidence = dict[str, al.results.Evidence]()
    for name, design in designs.items():
        evidence[name] = al.validate(design, samples, seed=1, keep=60, progress=page.progress)
        page.keep(group, {name: evidence[name]})
    return evidence


def swept(
    page: Draft, group: str, problems: Mapping[str, al.Problem], bound: str, values: Sequence[float] | np.ndarray
) -> dict[str, al.results.Front]:
    """The fronts of problems over one bound by their names, kept as a group."""
    fronts = dict[str, al.results.Front]()
    for name, problem in problems.items():
        fronts[name] = al.pareto(problem, bound, values, progress=page.progress)
        page.keep(group, {name: fronts[name]})
    return fronts


def add_second_way(page: Draft, name: str, problem: al.Problem, most_states: int = 20_000) -> None:
    """Solve by direct collocation too, which shares neither discretisation nor solver with shooting, and compare.

    - `most_states`: see `al.cross_check`.
    """
    page.section("A second way", folded=True)
    both = al.cross_check(problem, most_states=most_states, progress=page.progress)
    page.keep("collocated", {name: both.second})
    page.add(comparison_table(name, both), mesh_drawing(both.second.meshes, name))


def requirements_active(solution: al.Solution) -> list[str]:
    """The active requirements of a design, without decisions at their bounds."""
    return [name for name in solution.active if name not in solution.at_bounds]


def signed(change: float) -> str:
    """A relative change with its sign: `+3.9 %`."""
    return f"{'+' if change >= 0 else '−'}{percent(abs(change))}"


def margin_drawing(found: al.results.Calibration, heading: str, who: str, margin: str = "") -> Drawing:
    """The search for a margin, with the result on fresh systems for the chosen one; `margin` names it in words."""
    chosen = margin or f"a = {number(found.sigmas, 4)}"
    caption = (
        f"Each trial is a full design, counted on the same random {who}, until at most {given(100 * found.target)} % "
        f"of them break a limit. The chosen margin, {chosen}, is {found.sentence(who)}. Bars: 95 % intervals; on fresh "
        f"{who} at the confidence stated."
    )
    return Drawing([calibration_figure(found, who=who)], heading, caption)


def stored(name: str, rows: Mapping[str, Sequence[float]], units: Mapping[str, str]) -> "xarray.Dataset":
    """Rows of numbers, whose labels are the coordinate `name`, as columns with units."""
    import xarray

    columns = zip(units.items(), zip(*rows.values(), strict=True), strict=True)
    variables = {column: (name, list(values), {"units": unit}) for (column, unit), values in columns}
    return xarray.Dataset(variables, coords={name: list(rows)})


def comparison_table(name: str, found: al.results.CrossChecked) -> Table:
    """Both answers, decision by decision, and the largest differences of statistics and shadow prices."""
    ways = found.first, found.second
    rows = [
        ["Status", *("solved" if one.ok else one.why() for one in ways), ""],
        ["Objective", *(number(one.objective, _DIGITS) for one in ways), number(found.objective, 3)],
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
        yield [name, *shown, number(difference, 3) if np.isfinite(difference) else "on another mesh"]


def _largest(differences: Mapping[str, float]) -> str:
    if not differences:
        return "–"
    name, worst = max(differences.items(), key=lambda one: one[1])
    return f"{number(worst, 3)} ({name})"
