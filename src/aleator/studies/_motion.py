"""What the motion studies share: searches from several starts, plans on random systems, figures of linkages.

The margin of one standard deviation in the dissertation leaves a fifth to two fifths of the systems beyond a limit. So
every study calibrates a margin until fresh systems confirm it for `TARGET`, counting all limits of the problem jointly.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

import aleator as al
from aleator import reporting
from aleator.journalling import kept
from aleator.reporting import Drawing
from aleator.studies._shared import TARGET, sampled
from aleator.studies._study import Draft

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

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


# --- Figures -------------------------------------------------------------------------------------------------------


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
