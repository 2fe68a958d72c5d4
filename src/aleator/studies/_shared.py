"""What chapters do alike: designs solved and sampled, a margin calibrated, published values beside ours, trust."""

from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from typing import TypeVar

import aleator as al
from aleator import reporting
from aleator.reporting import NOTHING, Code, Drawing, Schematic, Table, Verdict, given, number, words
from aleator.studies._study import Draft

Item = TypeVar("Item")
Result = TypeVar("Result")

TARGET = 0.01
"""The share of systems that may break any limit of a design to build."""


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


def to_build(
    margin: al.results.Calibration | None, printed: al.Solution, evidence: al.results.Evidence, **said: object
) -> Verdict:
    """The calibrated design, or the `printed` one where no margin was calibrated.

    All limits of a calibrated design have to hold as often as those with a margin.
    """
    told: dict[str, object] = {"target": TARGET, **said}
    if margin is None:
        return reporting.recommendation(printed, evidence, **told)  # pyright: ignore
    shares = [one for one in (margin.confirmation, margin.evidence and margin.evidence.joint) if one is not None]
    told |= {"nominal": printed, "compared": {"with the printed margin": evidence}}
    told["confirmation"] = max(shares, key=lambda one: one.upper, default=None)
    return reporting.recommendation(margin.solution, margin.evidence, **told)  # pyright: ignore


def margin_drawing(found: al.results.Calibration, heading: str, who: str) -> Drawing:
    """The search for a margin, with the result on fresh systems for the chosen one."""
    chosen = words([f"{number(sigmas, 4)} σ on {name}" for name, sigmas in found.margins.items()])
    caption = (
        f"Each trial is a full design, counted on the same random {who}, until at most {given(100 * found.target)} % "
        f"of them break a limit. The chosen margin, {chosen}, is {found.sentence(who)}. Bars: 95 % intervals; on fresh "
        f"{who} at the confidence stated."
    )
    return Drawing([reporting.calibration_figure(found, who=who)], heading, caption)


def comparison(
    header: Sequence[str],
    published: Mapping[str, str | Sequence[str]],
    ours: Mapping[str, str | Sequence[str]],
    note: str,
    caption: str = "Published values and ours",
) -> Table:
    """What we found, by what it is, beside published values of the same name; a dash where there is none."""
    missing = [NOTHING] * len(_cells(next(iter(published.values()))))
    rows = [[name, *_cells(published.get(name, missing)), *_cells(cells)] for name, cells in ours.items()]
    return Table(caption, ["", *header], rows, note)


def _cells(texts: str | Sequence[str]) -> Sequence[str]:
    return [texts] if isinstance(texts, str) else texts


def add_trust(
    page: Draft, designs: Mapping[str, al.Solution], searches: Mapping[str, al.results.Starts] | None = None
) -> None:
    """Append how far designs can be trusted: the local optima of each search, and the certificates."""
    if searches:
        page.section("Local optima", folded=True)
        note = (
            "The problem is not convex: each start leads to a local optimum nearby, or to none. The plan is the best "
            "of them, but there may be a better one. Plans of equal objective, such as mirrored ones, count as one."
        )
        page.add(note, *(Code(name.capitalize(), str(search), opened=True) for name, search in searches.items()))
    page.section("Certificate", folded=True)
    page.add(reporting.certificate_table(designs))


def add_second_way(page: Draft, name: str, problem: al.Problem, most_states: int = 20_000) -> None:
    """Append a solution by direct collocation too, which shares neither discretisation nor solver with shooting."""
    page.section("A second way", folded=True)
    both = al.cross_check(problem, most_states=most_states, progress=page.progress)
    page.keep("collocated", {name: both.second})
    page.add(Code(f"{name} by shooting and by direct collocation", str(both), opened=True))
