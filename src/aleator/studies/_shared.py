"""What chapters do alike: designs solved, sampled and judged, margins, published values beside ours, trust.

For the motion studies: searches from several starts, plans on random systems, figures of linkages.

The margin of one standard deviation in the dissertation leaves a fifth to two fifths of the systems beyond a limit. So
every study calibrates a margin until fresh systems confirm it for `TARGET`, counting all limits of the problem jointly.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

import aleator as al
from aleator import reporting
from aleator.journalling import kept
from aleator.reporting import NOTHING, Code, Drawing, Schematic, Table, Verdict, given, number, words
from aleator.studies._study import Draft

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

Item = TypeVar("Item")
Result = TypeVar("Result")
Outputs = Mapping[str, Float[np.ndarray, "..."]]

TARGET = 0.01
"""The share of systems that may break any limit of a design to build."""

CALIBRATED = "calibrated"

TRIED = 1.6
"""The margin at which the search starts: four in a hundred of a uniform distribution lie beyond it on one side."""

SHADES = "Line: mean. Dark band: one σ to each side. Light band: from the minimum to the maximum over all systems."


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
    margin: al.results.Calibration | None, printed: al.Solution, evidence: al.results.Evidence, **said: Any
) -> Verdict:
    """The calibrated design, or the `printed` one where no margin was calibrated.

    All limits of a calibrated design have to hold as often as those with a margin.
    """
    if margin is None:
        return reporting.recommendation(printed, evidence, target=TARGET, **said)
    shares = [one for one in (margin.confirmation, margin.evidence and margin.evidence.joint) if one is not None]
    said |= {"nominal": printed, "compared": {"with the printed margin": evidence}, "target": TARGET}
    worst = max(shares, key=lambda one: one.upper, default=None)
    return reporting.recommendation(margin.solution, margin.evidence, confirmation=worst, **said)


def margin_drawing(
    found: al.results.Calibration, who: str, heading: str = "The margin for a tolerated share of violations"
) -> Drawing:
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
        note = (
            "The problem is not convex: each start leads to a local optimum nearby, or to none. The plan is the best "
            "of them, but there may be a better one. Plans of equal objective, such as mirrored ones, count as one."
        )
        optima = [Code(name.capitalize(), str(search), opened=True) for name, search in searches.items()]
        page.section("Local optima", note, *optima, folded=True)
    page.section("Certificate", reporting.certificate_table(designs), folded=True)


# --- Plans of motions ----------------------------------------------------------------------------------------------


class Plans(NamedTuple):
    """The plans of a study by name, how often fresh systems break their limits, and how random ones move."""

    solutions: dict[str, al.Solution]
    evidence: dict[str, al.results.Evidence]
    families: dict[str, al.results.Motions]


def search(page: Draft, name: str, problem: al.Problem, starts: int | Sequence[Mapping[str, Any]]) -> al.results.Starts:
    """Solve for a plan from several starts and keep the best. Raises `SolveError` if none is solved."""
    every = al.multistart(problem, starts, progress=lambda _, done, total: page.progress(name, done, total))
    if every.best.ok:
        page.keep("plans", {name: every.best})
    if every.interrupted:
        page.add(f"Of the starts of the search for '{name}', {len(every.solutions)} are finished and kept.")
        raise KeyboardInterrupt
    if not every.best.ok:
        raise al.SolveError(f"{name}: {every.best.why()}", every.best)
    return every


def calibrated(page: Draft, problem: al.Problem, limits: Sequence[str], samples: int) -> al.results.Calibration:
    """The margin at which at most `TARGET` of the systems break one of the limits."""
    # Half a per cent of an objective is at stake between a = 1 and the worst case, so that precision brings little.
    margin = al.calibrate(problem, limits, TARGET, samples=samples, precision=0.2, progress=page.progress)
    page.keep("calibration", margin)
    page.keep("plans", {CALIBRATED: margin.solution})
    return margin


def judged(
    page: Draft,
    searches: Mapping[str, al.results.Starts],
    margin: al.results.Calibration | None,
    samples: int,
    systems: int,
) -> Plans:
    """The plans that were found, and the calibrated one if there is a margin, on fresh systems and on random ones."""
    plans = {name: one.best for name, one in searches.items()}
    evidence = sampled(page, plans, samples)
    if margin is not None:
        plans[CALIBRATED] = margin.solution
        if margin.evidence is not None:
            evidence[CALIBRATED] = margin.evidence
            page.keep("evidence", {CALIBRATED: margin.evidence})
    return Plans(plans, evidence, {name: flown(name, plan, systems) for name, plan in plans.items()})


def flown(name: str, plan: al.Solution, systems: int, problem: al.Problem | None = None) -> al.results.Motions:
    """A plan on random systems, those of another problem with the same decisions if it is given."""
    at_design = replace(plan, problem=problem or plan.problem)
    return kept(f"systems, {name}", al.simulate_systems, at_design, systems, seed=2)


class Linkage(NamedTuple):
    """Two links in the plane, with their fixed joint at the origin.

    - `elbow`: its place from the outputs, m; `posture`, `target`: the joints' angles (rad) and the tip (m) at the end;
    - `torques`: their names by label; `limit`: of each, N m; `scene`: what stands around it;
    - `limits`: outputs with the range outside of which a system is highlighted.
    """

    elbow: Callable[[Outputs], Float[np.ndarray, "... 2"]]
    posture: tuple[float, float]
    target: tuple[float, float]
    torques: Mapping[str, str]
    limit: float
    limits: Mapping[str, tuple[float, float]]
    scene: reporting.Scene

    def show(
        self,
        page: Draft,
        plans: Plans,
        animated: Sequence[str],
        figures: Mapping[str, tuple[str, str]],
        animation: str = "",
    ) -> None:
        """Append plans in motion, and over time.

        - `figures`: the numbers of the figures of torques, and of joints and tip, by plan; `animation`: that of it.
        """
        page.section("The motion")
        told = "Press play, or drag the slider. Thin: random systems under the same plan. Thick: the median one."
        page.add(Drawing([self._moving(plans, name) for name in animated], "The plans in motion", told, animation))
        paths = [self.paths(plans, name, one) for name, one in plans.families.items()]
        page.add(Drawing(paths, "Path of the tip", "Cross: the target. Systems that break a limit are highlighted."))
        page.section("Over time")
        for name, (torque, joints) in figures.items():
            if name in plans.families:
                page.add(
                    Drawing([self._torques(plans.families[name])], f"Torques, {name}", SHADES, torque),
                    Drawing(self.histories(plans.families[name]), f"Joints and tip, {name}", SHADES, joints),
                )

    def paths(self, plans: Plans, name: str, family: al.results.Motions) -> "Figure":
        """The path of each system's tip under the plan of this name, and which systems break a limit."""
        tips, rows = _tips(family), family.systems
        beyond = [(rows[output] < least) | (rows[output] > most) for output, (least, most) in self.limits.items()]
        broken = np.any(beyond, axis=(0, 2))
        return reporting.plane_figure(tips, tips[_median(family)], broken=broken, **self._around(plans, name))

    def histories(self, family: al.results.Motions) -> list["Figure"]:
        """Both joints' angles and the place of the tip over time, with their targets."""
        posture = dict(zip(("q₁", "q₂"), self.posture, strict=True))
        target = dict(zip(("x", "y"), self.target, strict=True))
        return [
            _bands(family, {"q₁": "q1", "q₂": "q2"}, y="Joint angle", unit="rad", targets=posture, title="Joints"),
            _bands(family, {"x": "tip_x", "y": "tip_y"}, y="Place of the tip", unit="m", targets=target, title="Tip"),
        ]

    def _torques(self, family: al.results.Motions) -> "Figure":
        return _bands(family, self.torques, y="Torque", unit="N m", limits=(-self.limit, self.limit))

    def _moving(self, plans: Plans, name: str) -> "Figure":
        family = plans.families[name]
        tip = _tips(family)
        joints = np.stack([np.zeros_like(tip), self.elbow(family.systems), tip], axis=-2)
        median = joints[_median(family)]
        return reporting.linkage_animation(np.asarray(family.times), joints, median, **self._around(plans, name))

    def _around(self, plans: Plans, name: str) -> dict[str, Any]:
        look = reporting.looks(plans.solutions)[name]
        return {"look": look, "scene": self.scene, "target": self.target, "title": name.capitalize()}


def _tips(family: al.results.Motions) -> Float[np.ndarray, "systems instants 2"]:
    return np.stack([family.systems["tip_x"], family.systems["tip_y"]], axis=-1)


def _median(family: al.results.Motions) -> int:
    """Which of the systems has the median of the one uncertain number."""
    (numbers,) = family.numbers.values()
    return int(np.argsort(numbers)[len(numbers) // 2])


def _bands(family: al.results.Motions, names: Mapping[str, str], **more: Any) -> "Figure":
    """Outputs of all systems over time; `names` by their labels."""
    rows = {label: family.systems[name] for label, name in names.items()}
    return reporting.bands_figure(np.asarray(family.times), rows, **more)
