"""Pick and place in the least time as the command line runs it: plans, evidence, a calibrated margin, the page."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, final

import numpy as np
from scipy import stats
from typing_extensions import override

import aleator as al
from aleator._core.progress import Progress
from aleator.reporting import (
    Block,
    Card,
    Drawing,
    Schematic,
    Section,
    Table,
    Text,
    Verdict,
    bands_figure,
    count,
    given,
    interval,
    number,
    percent,
    share_text,
)
from aleator.studies._motion.build import CALIBRATED, TARGET, TRIED, build_verdict, price
from aleator.studies._motion.facts import (
    SHADES,
    animations,
    duration,
    named,
    violation_cards,
)
from aleator.studies._motion.family import Family
from aleator.studies._motion.printed import compared
from aleator.studies._motion.results import Effort
from aleator.studies._motion.study import AbstractMotionStudy, Stage
from aleator.studies.pick_and_place_time import PAYLOAD, deterministic_problem, robust_problem
from aleator.studies.two_link_arm import TORQUE
from aleator.studies.two_link_arm._drawing import arm_schematic
from aleator.studies.two_link_arm._views import SCENE, TIP, TOGETHER, joints

MEAN, ONE, WORST = "deterministic", "robust, a = 1", "robust, a = √3"
SIGMAS = {ONE: 1.0, WORST: float(np.sqrt(3.0))}
REFERENCE = {MEAN: 1.4142, ONE: 1.5938}
PUBLISHED = {MEAN: 1.12, ONE: 1.20}
SPREAD = 0.2
"""Of the random starts, as a share of each decision's range."""

FULL = Effort(starts=16)
QUICK = Effort(starts=3, samples=4_000, family=400, calibration_samples=2_000, whole=False)


def predicted_share(sigmas: float) -> float:
    """How many payloads lie more than `sigmas` standard deviations off their mean: of a uniform law, `1 - a/√3`."""
    return max(0.0, 1.0 - sigmas / np.sqrt(3.0))


@final
class PickAndPlaceTime(AbstractMotionStudy):
    """The fastest plans for the mean payload and for all payloads, and the margin that a tolerated share asks for."""

    title = "Pick and place in the least time: inverse dynamics"
    subtitle = (
        f"Two-link arm, payload in kg: {PAYLOAD}; torques within ±{given(TORQUE)} N m;"
        " dissertation, sections 5.5.2 and 5.6"
    )
    names = (MEAN, ONE, WORST, CALIBRATED)
    left_out = "plans with limits at the instants alone, and what the systems drawn do between instants"
    sigmas: ClassVar = SIGMAS
    limits = ("torque",)
    who = "payloads"
    measures: ClassVar = dict.fromkeys(names, "duration, s")
    glossary = (
        ("Deterministic plan", "The fastest plan for the mean payload (73)."),
        ("Robust plan", "The fastest plan whose torques keep their limits with μ ± a·σ, (80) and (91)."),
        ("μ, σ", "Mean and standard deviation over all payloads."),
        ("Margin a", "How many σ are kept between the mean torque and its limit."),
        ("Inverse dynamics", "The joints follow the plan exactly; the payload changes the torques that this takes."),
        ("t_f", "Duration of the motion, chosen by the plan."),
    )

    def find_plans(self, progress: Progress) -> None:
        """Each plan from several starts: the first at random, the robust ones from the optima found before, too."""
        done = self.done
        plan = done.search(MEAN, named(deterministic_problem(), TOGETHER), done.effort.starts, progress)
        for name, sigmas in SIGMAS.items():
            problem = named(robust_problem(sigmas, guess=plan.decisions["motion.free"]), TOGETHER)
            earlier = [dict(one.decisions) for search in done.searches.values() for one, _ in search.optima[:4]]
            plan = done.search(name, problem, earlier, progress)
        done.solve_at_instants()

    @override
    def more(self) -> Mapping[str, Stage]:
        return {}

    @override
    def margin_problem(self) -> al.Problem:
        """Section 5.6."""
        return named(robust_problem(TRIED, guess=self.done.plans[ONE].decisions["motion.free"]), TOGETHER)

    @override
    def more_results(self) -> Mapping[str, Any]:
        return {}

    @override
    def published(self) -> Table:
        rows, ours = [], {name: duration(plan) for name, plan in self.done.plans.items()}
        for name, plan in self.done.plans.items():
            printed, reference = PUBLISHED.get(name), REFERENCE.get(name)
            rows.append(
                [
                    name,
                    "–" if printed is None else given(printed, "s"),
                    "–" if reference is None else f"{reference:.4f} s",
                    number(duration(self.done.coarse[name]), 5, "s") if name in self.done.coarse else "–",
                    number(duration(plan), 5, "s"),
                ]
            )
        note = (
            "Reference: an independent program for the same arm, with limits at the 91 instants alone. No digit of the"
            " published times is to be met: the dissertation prints neither the arm's inertias nor its obstacle, and no"
            " arm whose parameters are all one gives both of its times."
            f" {compared(PUBLISHED, ours, 'the published times')}"
        )
        header = ["t_f", "Published", "Reference", "Ours, at the instants", "Ours, between them too"]
        return Table("Published and reference values beside ours", header, rows, note)

    @override
    def recommendation(self, sentences: Sequence[str], cards: Sequence[Card]) -> Verdict:
        done = self.done
        plan, one, found = done.plans[WORST], done.plans[ONE], done.evidence[WORST].joint
        if found.upper > TARGET or found.count:
            said = f" The plan with a = √3 is none: {share_text(found)} of the payloads break a limit of it."
            return build_verdict(
                done.calibration, one, unit="s", who=self.who, beside=said, sentences=sentences, cards=cards
            )
        headline = (
            f"The worst-case plan, a = √3, for {price(duration(plan), duration(one), 's')}: none of"
            f" {count(found.samples)} payloads breaks a limit [{interval(found)}, target {given(100 * TARGET)} %]."
        )
        return Verdict("good", "Build", headline + self._saving(), sentences, cards)

    def _saving(self) -> str:
        """What tolerating a few payloads beyond a limit would save."""
        if (found := self.done.calibration) is None:
            return ""
        less = duration(self.done.plans[WORST]) - duration(found.solution)
        return f" A margin of a = {number(found.sigmas, 4)} would save {number(1000 * less, 2, 'ms')}."

    @override
    def sentences(self) -> Iterator[str]:
        evidence = self.done.evidence
        if one := evidence.get(MEAN):
            yield (
                "Do not run the plan for the mean payload: it drives the torques to their limits, and"
                f" {share_text(one.joint)} of the payloads ask for more."
            )
        if one := evidence.get(ONE):
            yield (
                f"The printed margin of one σ is not safe: {share_text(one.joint)} of the payloads overload a joint."
                f" That is right: {percent(predicted_share(1.0))} of uniform payloads lie outside μ ± σ."
            )
        if (found := self.done.calibration) is not None:
            yield (
                f"If {given(100 * found.target)} % of the payloads may fail, a = {number(found.sigmas, 4)}, in"
                f" {number(duration(found.solution), 4, 's')}, is {found.sentence('payloads')}."
            )

    @override
    def cards(self) -> Iterator[Card]:
        notes = {ONE: "the printed margin", WORST: "fastest for all payloads"}
        for name, note in notes.items():
            if plan := self.done.plans.get(name):
                yield Card(f"Duration, {name}", number(duration(plan), 4, "s"), note)
        yield from violation_cards(self.done.evidence, (ONE, WORST), "a limit")

    @override
    def schematic(self) -> Schematic:
        return arm_schematic(PAYLOAD)

    @override
    def chapters(self) -> Sequence[Section]:
        return [
            Section("Torques against their limits", list(self._torques())),
            Section("The motion", list(self._motion())),
        ]

    def _torques(self) -> Iterator[Block]:
        families = self.done.families
        if MEAN in families:
            nominal = {text: rows[:1] for text, rows in _torques(families[MEAN], nominal=True).items()}
            figures = [
                _torque_figure(families[MEAN].times, nominal, "The mean payload"),
                _torque_figure(families[MEAN].times, _torques(families[MEAN]), "All payloads"),
            ]
            caption = (
                "The fastest plan holds one torque or the other at its limit almost throughout. Another payload on the"
                f" same path asks for more. {SHADES}"
            )
            yield Drawing(figures, "Torques of the deterministic plan", caption, "5.5")
        robust = [name for name in (ONE, WORST) if name in families]
        if robust:
            figures = [
                _torque_figure(families[name].times, _torques(families[name]), name.capitalize()) for name in robust
            ]
            caption = (
                "The margin pushes the bands inside the limits: with a = 1 the dark band of one σ, with a = √3 the"
                " light band of all payloads, for a uniform law ends √3 σ off its mean."
            )
            yield Drawing(figures, "Torques of the robust plans", caption, "5.6")

    def _motion(self) -> Iterator[Block]:
        families = self.done.families
        shown = [name for name in (MEAN, WORST) if name in families]
        if not shown:
            return
        yield animations(families, shown, joints, TIP, SCENE, self.names)
        robust = families[shown[-1]]
        angles = {"q₁": robust.systems["q1"], "q₂": robust.systems["q2"]}
        figure = bands_figure(robust.times, angles, y="Joint angle", unit="rad", title=shown[-1].capitalize())
        yield Drawing(
            [figure],
            "Configuration over time",
            "The joints follow the plan whatever the payload: nothing spreads.",
            "5.7",
        )

    @override
    def margin(self) -> Iterator[Block]:
        """Why one σ leaves so many outside, too."""
        if self.done.evidence:
            yield Text(_WHY, lead="Why one σ leaves four payloads in ten outside.")
            yield self._shares()
        yield from super().margin()

    def _shares(self) -> Table:
        rows = []
        for name in (ONE, WORST):
            if (one := self.done.evidence.get(name)) and name in self.done.families:
                family = self.done.families[name]
                rows.append(
                    [
                        name,
                        percent(predicted_share(SIGMAS[name])),
                        share_text(one.violations["torque"]),
                        number(_largest_skewness(family), 2),
                    ]
                )
        header = ["Plan", "Payloads outside μ ± a·σ", "Payloads that overload a joint", "Largest skewness of a torque"]
        note = (
            "Skewness is of the sampled torques, at the instant where it is largest; its sampling error is"
            f" {number(float(np.sqrt(6 / self.done.effort.family)), 2)}."
        )
        return Table("What a margin is worth", header, rows, note)


_WHY = (
    (
        "Along a given motion each torque is a straight line in the payload: τ = τ₀(t) + τ₁(t)·M. So it is uniform as"
        " the payload is, its skewness is zero, and μ ± σ covers the share 1/√3 = 57.7 % of the payloads at every"
        " instant. Where a heavier payload and a lighter one both meet a limit, 1 − 1/√3 = 42.3 % overload a joint."
    ),
    (
        "For one uniform payload a = √3 is the exact worst case. For other laws, or several uncertain numbers, the"
        " share that a margin leaves outside is not known beforehand: count it and calibrate a, as below (section 5.6)."
    ),
)


def _torques(family: Family, *, nominal: bool = False) -> dict[str, np.ndarray]:
    outputs = family.nominal if nominal else family.systems
    return {text: np.atleast_2d(outputs[name]) for text, name in (("τ₁", "q1_torque"), ("τ₂", "q2_torque"))}


def _torque_figure(times: np.ndarray, torques: dict[str, np.ndarray], title: str) -> Any:
    return bands_figure(times, torques, y="Torque", unit="N m", limits=(-TORQUE, TORQUE), title=title)


def _largest_skewness(family: Family) -> float:
    found = [stats.skew(rows, axis=0) for rows in _torques(family).values()]
    return float(np.nanmax(np.abs(found)))


def make(quick: bool) -> PickAndPlaceTime:
    """The study, at full or at quick effort."""
    return PickAndPlaceTime(QUICK if quick else FULL)
