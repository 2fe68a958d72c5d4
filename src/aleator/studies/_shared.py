"""The stages that several studies share: the system, designs solved and sampled, a margin, and a second way."""

from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING, TypeVar

import aleator as al
from aleator import reporting
from aleator.reporting import Code, Drawing, Schematic, given, number
from aleator.studies._study import Draft

if TYPE_CHECKING:
    import xarray

Item = TypeVar("Item")
Result = TypeVar("Result")


def system(page: Draft, drawing: str, heading: str, caption: str, figure: str = "") -> Schematic:
    """A drawing of the system by its file, such as `suspension/car.svg`, with the study's problems beside it."""
    svg = (resources.files("aleator.studies") / drawing).read_text(encoding="utf-8")
    problems = page.study.problems.items()
    beside = [Code(f"As mathematics: {name}", str(problem)) for name, problem in problems]
    return Schematic([svg], heading, caption, figure, beside)


def gathered(page: Draft, group: str, verb: Callable[[Item], Result], items: Mapping[str, Item]) -> dict[str, Result]:
    """What a verb makes of each item, by name, kept as a group as soon as it is there."""
    results = dict[str, Result]()
    for i, (name, item) in enumerate(items.items()):
        page.progress(f"{group}, {name}", i, len(items))
        results[name] = verb(item)
        page.keep(group, {name: results[name]})
    return results


def sampled(
    page: Draft, designs: Mapping[str, al.Solution], samples: int, group: str = "evidence"
) -> dict[str, al.results.Evidence]:
    """Evidence on designs by their names, kept as a group."""

    def counted(design: al.Solution) -> al.results.Evidence:
        return al.validate(design, samples, seed=1, keep=60, progress=page.progress)

    return gathered(page, group, counted, designs)


def add_second_way(page: Draft, name: str, problem: al.Problem, most_states: int = 20_000) -> None:
    """Solve by direct collocation too, which shares neither discretisation nor solver with shooting, and compare.

    - `most_states`: see `al.cross_check`.
    """
    page.section("A second way", folded=True)
    both = al.cross_check(problem, most_states=most_states, progress=page.progress)
    page.keep("collocated", {name: both.second})
    told = (
        "Shooting integrates from the start, step by step; direct collocation makes the states at all instants "
        "variables of one sparse program, for another solver. Both have the same grid and the same expansion. "
        "Differences of decisions are relative to the range allowed for each."
    )
    page.add(
        Code(f"{name} by shooting and by direct collocation", str(both), opened=True),
        reporting.designs_table({"Shooting": both.first, "Direct collocation": both.second}, {}),
        Drawing([both.plot.differences()], "Relative differences", told),
        reporting.mesh_drawing(both.second.meshes, name),
    )


def requirements_active(solution: al.Solution) -> list[str]:
    """The active requirements of a design, without decisions at their bounds."""
    return [name for name in solution.active if name not in solution.at_bounds]


def margin_drawing(found: al.results.Calibration, heading: str, who: str, margin: str = "") -> Drawing:
    """The search for a margin, with the result on fresh systems for the chosen one; `margin` names it in words."""
    chosen = margin or f"a = {number(found.sigmas, 4)}"
    caption = (
        f"Each trial is a full design, counted on the same random {who}, until at most {given(100 * found.target)} % "
        f"of them break a limit. The chosen margin, {chosen}, is {found.sentence(who)}. Bars: 95 % intervals; on fresh "
        f"{who} at the confidence stated."
    )
    return Drawing([reporting.calibration_figure(found, who=who)], heading, caption)


def stored(name: str, rows: Mapping[str, Sequence[float]], units: Mapping[str, str]) -> "xarray.Dataset":
    """Rows of numbers, whose labels are the coordinate `name`, as columns with units."""
    import xarray

    columns = zip(units.items(), zip(*rows.values(), strict=True), strict=True)
    variables = {column: (name, list(values), {"units": unit}) for (column, unit), values in columns}
    return xarray.Dataset(variables, coords={name: list(rows)})
