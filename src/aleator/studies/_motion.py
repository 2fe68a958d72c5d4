"""What the motion studies share: searches from several starts, a calibrated margin, tables and figures of plans.

The margin of one standard deviation in the dissertation leaves a fifth to two fifths of the systems beyond a limit. So
every study calibrates a margin until fresh systems confirm it for `TARGET`, counting all limits of the problem jointly.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

import aleator as al
from aleator import reporting
from aleator.journalling import kept
from aleator.reporting import Code, Drawing, Verdict, number
from aleator.studies._study import Draft

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

TARGET = 0.01
"""The share of systems that may break any limit."""

CALIBRATED = "calibrated"

TRIED = 1.6
"""The margin at which the search starts: four in a hundred of a uniform distribution lie beyond it on one side."""

SHADES = "Line: mean. Dark band: one σ to each side. Light band: from the minimum to the maximum over all systems."

Outputs = Mapping[str, Float[np.ndarray, "..."]]


# --- Plans ---------------------------------------------------------------------------------------------------------


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
    plans, evidence = {name: one.best for name, one in searches.items()}, dict[str, al.results.Evidence]()
    if margin is not None:
        plans[CALIBRATED] = margin.solution
    for name, plan in plans.items():
        known = margin.evidence if margin is not None and name == CALIBRATED else None
        evidence[name] = known or al.validate(plan, samples, seed=1, keep=25, progress=page.progress)
        page.keep("evidence", {name: evidence[name]})
    return Plans(plans, evidence, {name: flown(name, plan, systems) for name, plan in plans.items()})


def flown(name: str, plan: al.Solution, systems: int, problem: al.Problem | None = None) -> al.results.Motions:
    """A plan on random systems, those of another problem with the same decisions if it is given."""
    at_design = replace(plan, problem=problem or plan.problem)
    return kept(f"systems, {name}", al.simulate_systems, at_design, systems, seed=2)


def held_at_instants(page: Draft, plans: Mapping[str, al.Solution], names: Iterable[str]) -> dict[str, float]:
    """The objectives of plans whose limits hold at the instants alone, as in the programs they are compared with."""
    coarse = {name: al.solve(plans[name].problem, start=plans[name].decisions, between=1) for name in names}
    page.keep("at_instants", coarse)
    return {name: plan.objective for name, plan in coarse.items()}


def to_build(
    margin: al.results.Calibration | None, printed: al.Solution, evidence: al.results.Evidence, **said: Any
) -> Verdict:
    """The calibrated plan, or the `printed` one where no margin was calibrated.

    All limits of a calibrated plan have to hold as often as those with a margin.
    """
    if margin is None:
        return reporting.recommendation(printed, evidence, target=TARGET, **said)
    shares = [one for one in (margin.confirmation, margin.evidence and margin.evidence.joint) if one is not None]
    return reporting.recommendation(
        margin.solution,
        margin.evidence,
        nominal=printed,
        compared={"with the printed margin": evidence},
        confirmation=max(shares, key=lambda one: one.upper, default=None),
        target=margin.target,
        **said,
    )


def add_trust(page: Draft, searches: Mapping[str, al.results.Starts], plans: Plans) -> None:
    """Append how far plans can be trusted: the local optima of each search, and the certificates."""
    page.section("Local optima", folded=True)
    note = (
        "The problem is not convex: each start leads to a local optimum nearby, or to none. The plan is the best of "
        "them, but there may be a better one. Plans of equal objective, such as mirrored ones, count as one."
    )
    page.add(note, *(Code(name.capitalize(), str(search), opened=True) for name, search in searches.items()))
    page.section("Certificate", folded=True)
    page.add(reporting.certificate_table(plans.solutions))


def over_the_first(what: str, printed: Mapping[str, float], ours: Mapping[str, float]) -> dict[str, dict[str, str]]:
    """By plan, what can be compared with values of another arm, or of sums over unstated samples: their ratios."""
    first = next(iter(printed))
    return {
        name: {
            f"{what} over that of the first, published": number(printed[name] / printed[first], 3),
            "– ours, likewise": number(ours[name] / ours[first], 3),
        }
        for name in printed
        if name in ours
    }


# --- Figures -------------------------------------------------------------------------------------------------------


class Linkage(NamedTuple):
    """Two links in the plane, with their fixed joint at the origin.

    - `elbow`: its place from the outputs, m; `posture`, `target`: the joints' angles (rad) and the tip (m) at the end;
    - `scene`: what stands around it; `broken`: which systems break a limit.
    """

    elbow: Callable[[Outputs], Float[np.ndarray, "... 2"]]
    posture: Sequence[float]
    target: Sequence[float]
    scene: reporting.Scene
    broken: Callable[[al.results.Motions], Bool[np.ndarray, " systems"]]

    def joints(self, outputs: Outputs) -> Float[np.ndarray, "... joints 2"]:
        """Base, elbow and tip, m."""
        tip = np.stack([outputs["tip_x"], outputs["tip_y"]], axis=-1)
        return np.stack([np.zeros_like(tip), self.elbow(outputs), tip], axis=-2)

    def animation(self, plans: Plans, names: Sequence[str], figure: str = "") -> Drawing:
        """Plans of these names on their systems, side by side."""
        figures = []
        for name in names:
            family = plans.families[name]
            moving, around = self.joints(family.systems), self._around(name, plans)
            still = np.asarray(family.times), moving, moving[median(family)]
            figures.append(reporting.linkage_animation(*still, **around))
        caption = "Press play, or drag the slider. Thin: random systems under the same plan. Thick: the median one."
        return Drawing(figures, "The plans in motion", caption, figure)

    def paths(self, name: str, family: al.results.Motions, plans: Plans) -> "Figure":
        """The path of each system's tip under the plan of this name, and which systems break a limit."""
        tips = self.joints(family.systems)[..., -1, :]
        around = self._around(name, plans)
        return reporting.plane_figure(tips, tips[median(family)], broken=self.broken(family), **around)

    def _around(self, name: str, plans: Plans) -> dict[str, Any]:
        look = reporting.looks(plans.solutions)[name]
        return {"look": look, "scene": self.scene, "target": self.target, "title": name.capitalize()}

    def histories(self, family: al.results.Motions) -> list["Figure"]:
        """Both joints' angles and the place of the tip over time, with their targets."""
        posture = {"q₁": float(self.posture[0]), "q₂": float(self.posture[1])}
        target = {"x": float(self.target[0]), "y": float(self.target[1])}
        return [
            bands(family, {"q₁": "q1", "q₂": "q2"}, y="Joint angle", unit="rad", targets=posture, title="Joints"),
            bands(family, {"x": "tip_x", "y": "tip_y"}, y="Place of the tip", unit="m", targets=target, title="Tip"),
        ]


def median(family: al.results.Motions) -> int:
    """Which of the systems has the median of the one uncertain number."""
    (numbers,) = family.numbers.values()
    return int(np.argsort(numbers)[len(numbers) // 2])


def bands(family: al.results.Motions, names: Mapping[str, str], **more: Any) -> "Figure":
    """Outputs of all systems over time; `names` by their labels."""
    rows = {label: family.systems[name] for label, name in names.items()}
    return reporting.bands_figure(np.asarray(family.times), rows, **more)


def torques_figure(family: al.results.Motions, names: Mapping[str, str], limit: float, title: str = "") -> "Figure":
    """Torques over time, between their limits (N m)."""
    return bands(family, names, y="Torque", unit="N m", limits=(-limit, limit), title=title)
