"""The study of pick and place in minimum time: searches, numbers, verdict, chapters, and its declaration."""

from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, final

import numpy as np
import scipy
from typing_extensions import override

import aleator as al
from aleator._core.border import Progress
from aleator.reporting import (
    Block,
    Card,
    Drawing,
    Schematic,
    Section,
    Table,
    Text,
    Verdict,
    count,
    given,
    interval,
    number,
    percent,
    share_text,
)
from aleator.studies._motion.facts import CALIBRATED, TARGET, TRIED, compared, duration, named, price, violation_cards
from aleator.studies._motion.results import Effort, Family, MotionResults
from aleator.studies._motion.study import AbstractMotionStudy
from aleator.studies._motion.views import SHADES, angles_figure, animations, torques_figure
from aleator.studies.pick_and_place_time import PAYLOAD, deterministic_problem, robust_problem
from aleator.studies.two_link_arm import TORQUE
from aleator.studies.two_link_arm._views import SCENE, TIP, TOGETHER, arm_schematic, joints

MEAN, ONE, WORST = "deterministic", "robust, a = 1", "robust, a = √3"
SIGMAS = {ONE: 1.0, WORST: float(np.sqrt(3.0))}

FULL = Effort(starts=16)
QUICK = Effort(starts=3, samples=4_000, family=400, calibration_samples=2_000, whole=False)
REFERENCE = {MEAN: 1.4142, ONE: 1.5938}
PUBLISHED = {MEAN: 1.12, ONE: 1.20}
GLOSSARY = (
    ("Deterministic plan", "The fastest plan for the mean payload (73)."),
    ("Robust plan", "The fastest plan whose torques keep their limits with μ ± a·σ, (80) and (91)."),
    ("μ, σ", "Mean and standard deviation over all payloads."),
    ("Margin a", "The number of σ kept between the mean torque and its limit."),
    ("Inverse dynamics", "The joints follow the plan exactly; the payload changes the torques needed."),
    ("t_f", "Duration of the motion, chosen by the plan."),
)
_WHY = (
    (
        "Along a given motion each torque is affine in the payload: τ = τ₀(t) + τ₁(t)·M. So it is uniformly "
        "distributed like the payload, its skewness is zero, and μ ± σ covers 1/√3 = 57.7 % of the payloads at every "
        "instant. Where both heavier and lighter payloads reach a limit, 1 − 1/√3 = 42.3 % overload a joint."
    ),
    (
        "For one uniform payload a = √3 is the exact worst case. For other distributions, or several uncertain "
        "numbers, the share outside a margin is not known beforehand: count it and calibrate a, as below (section 5.6)."
    ),
)


def problems() -> dict[str, al.Problem]:
    """The problems of all plans, each with its own start."""
    bare = {MEAN: deterministic_problem(), **{name: robust_problem(sigmas) for name, sigmas in SIGMAS.items()}}
    return {name: named(one, TOGETHER) for name, one in bare.items()}


def search_plans(done: MotionResults, progress: Progress) -> None:
    """Each plan from several starts: the first from random ones, the robust ones also from the optima before."""
    plan = done.search(MEAN, problems()[MEAN], done.effort.starts, progress)
    for name, sigmas in SIGMAS.items():
        problem = named(robust_problem(sigmas, guess=plan.decisions["motion.free"]), TOGETHER)
        earlier = [dict(one.decisions) for search in done.searches.values() for one, _ in search.optima[:4]]
        plan = done.search(name, problem, earlier, progress)
    done.solve_at_instants()


def margin_problem(plan: al.Solution) -> al.Problem:
    """The problem of section 5.6, to be solved from a plan."""
    return named(robust_problem(TRIED, guess=plan.decisions["motion.free"]), TOGETHER)


def predicted_share(sigmas: float) -> float:
    """The share of payloads more than `sigmas` standard deviations from the mean: `1 - a/√3` if uniform."""
    return max(0.0, 1.0 - sigmas / np.sqrt(3.0))


def torques_of(family: Family, *, nominal: bool = False) -> dict[str, np.ndarray]:
    """Both torques of all systems, or of the nominal one alone, shape (systems, instants), N m."""
    outputs = family.nominal if nominal else family.systems
    return {text: np.atleast_2d(outputs[name]) for text, name in (("τ₁", "q1_torque"), ("τ₂", "q2_torque"))}


def margins_table(done: MotionResults) -> Table:
    """The share of payloads outside a margin: in closed form, and counted."""
    rows = []
    for name in (ONE, WORST):
        if (one := done.evidence.get(name)) and name in done.families:
            rows.append(
                [
                    name,
                    percent(predicted_share(SIGMAS[name])),
                    share_text(one.violations["torque"]),
                    number(_largest_skewness(done.families[name]), 2),
                ]
            )
    header = ["Plan", "Payloads outside μ ± a·σ", "Payloads that overload a joint", "Largest skewness of a torque"]
    note = (
        "Skewness is that of the sampled torques at the instant where it is largest; its sampling error is "
        f"{number(float(np.sqrt(6 / done.effort.family)), 2)}."
    )
    return Table("The effect of a margin", header, rows, note)


def _largest_skewness(family: Family) -> float:
    found = [scipy.stats.skew(rows, axis=0) for rows in torques_of(family).values()]
    return float(np.nanmax(np.abs(found)))


def worst_case_holds(done: MotionResults) -> bool:
    """Whether fresh payloads confirm that the worst-case plan breaks no limit."""
    found = done.evidence[WORST].joint
    return found.upper <= TARGET and not found.count


def headline(done: MotionResults) -> str:
    """The worst-case plan, its cost, and the time saved by tolerating a few violations."""
    plan, one, found = done.plans[WORST], done.plans[ONE], done.evidence[WORST].joint
    said = (
        f"The worst-case plan, a = √3, for {price(duration(plan), duration(one), 's')}: none of"
        f" {count(found.samples)} payloads breaks a limit [{interval(found)}, target {given(100 * TARGET)} %]."
    )
    if done.calibration is None:
        return said
    less = duration(plan) - duration(done.calibration.solution)
    return f"{said} A margin of a = {number(done.calibration.sigmas, 4)} would save {number(1000 * less, 2, 'ms')}."


def sentences(done: MotionResults) -> Iterator[str]:
    """Sentences on the plans available."""
    if one := done.evidence.get(MEAN):
        yield (
            "Do not run the plan for the mean payload: it drives the torques to their limits, and "
            f"{share_text(one.joint)} of the payloads need more."
        )
    if one := done.evidence.get(ONE):
        yield (
            f"The published margin of one σ is not safe: {share_text(one.joint)} of the payloads overload a joint. "
            f"This agrees with theory: {percent(predicted_share(1.0))} of uniform payloads lie outside μ ± σ."
        )
    if (found := done.calibration) is not None:
        yield (
            f"If {given(100 * found.target)} % of the payloads may fail, a = {number(found.sigmas, 4)}, in"
            f" {number(duration(found.solution), 4, 's')}, is {found.sentence('payloads')}."
        )


def cards(done: MotionResults) -> Iterator[Card]:
    """The durations of the robust plans, and how often they fail."""
    notes = {ONE: "the published margin", WORST: "fastest for all payloads"}
    for name, note in notes.items():
        if plan := done.plans.get(name):
            yield Card(f"Duration, {name}", number(duration(plan), 4, "s"), note)
    yield from violation_cards(done.evidence, (ONE, WORST), "a limit")


def chapters(families: Mapping[str, Family], names: Sequence[str]) -> list[Section]:
    """The figures of section 5.5.2; `names` are all plans of the study."""
    return [
        Section("Torques against their limits", list(_torques(families))),
        Section("The motion", list(_motion(families, names))),
    ]


def _torques(families: Mapping[str, Family]) -> Iterator[Block]:
    if MEAN in families:
        times, nominal = families[MEAN].times, torques_of(families[MEAN], nominal=True)
        figures = [
            torques_figure(times, nominal, TORQUE, "The mean payload"),
            torques_figure(times, torques_of(families[MEAN]), TORQUE, "All payloads"),
        ]
        caption = (
            "The fastest plan keeps one torque or the other at its limit almost throughout. Another payload on the "
            f"same path needs more. {SHADES}"
        )
        yield Drawing(figures, "Torques of the deterministic plan", caption, "5.5")
    if robust := {name: families[name] for name in (ONE, WORST) if name in families}:
        figures = [
            torques_figure(one.times, torques_of(one), TORQUE, name.capitalize()) for name, one in robust.items()
        ]
        caption = (
            "The margin moves the bands inside the limits: with a = 1 the dark band of one σ, with a = √3 the light "
            "band of all payloads, since a uniform distribution ends √3 σ from its mean."
        )
        yield Drawing(figures, "Torques of the robust plans", caption, "5.6")


def _motion(families: Mapping[str, Family], names: Sequence[str]) -> Iterator[Block]:
    shown = [name for name in (MEAN, WORST) if name in families]
    if not shown:
        return
    yield animations(families, shown, joints, TIP, SCENE, names)
    figure = angles_figure(families[shown[-1]], shown[-1].capitalize())
    caption = "The joints follow the plan whatever the payload, and so have no spread."
    yield Drawing([figure], "Configuration over time", caption, "5.7")


def why_one_sigma(done: MotionResults) -> Iterator[Block]:
    """Why one σ excludes so many payloads."""
    if done.evidence:
        yield Text(_WHY, lead="Why one σ excludes four payloads in ten.")
        yield margins_table(done)


@final
class PickAndPlaceTime(AbstractMotionStudy):
    """The fastest plans for the mean payload and for all payloads, and the margin for a tolerated violation rate."""

    title = "Pick and place in minimum time: inverse dynamics"
    subtitle = (
        f"Two-link arm, payload in kg: {PAYLOAD}; torques within ±{given(TORQUE)} N m;"
        " dissertation, sections 5.5.2 and 5.6"
    )
    glossary = GLOSSARY
    full, quick = FULL, QUICK
    names = (MEAN, ONE, WORST, CALIBRATED)
    only_whole = "plans with limits at the instants alone, and what the systems drawn do between instants"
    sigmas: ClassVar = SIGMAS
    limits = ("torque",)
    who = "payloads"
    measures: ClassVar = dict.fromkeys(names, "duration, s")
    unit = "s"

    @property
    @override
    def problems(self) -> Mapping[str, al.Problem]:
        return problems()

    @override
    def find_plans(self, progress: Progress) -> None:
        search_plans(self.done, progress)

    @override
    def margin_problem(self) -> al.Problem:
        return margin_problem(self.done.plans[ONE])

    @override
    def published(self) -> Table:
        done = self.done
        rows, ours = [], {name: duration(plan) for name, plan in done.plans.items()}
        for name, plan in done.plans.items():
            printed, reference = PUBLISHED.get(name), REFERENCE.get(name)
            rows.append(
                [
                    name,
                    "–" if printed is None else given(printed, "s"),
                    "–" if reference is None else f"{reference:.4f} s",
                    number(duration(done.coarse[name]), 5, "s") if name in done.coarse else "–",
                    number(duration(plan), 5, "s"),
                ]
            )
        note = (
            "Reference: an independent program for the same arm, with limits only at the 91 instants. The published "
            "times cannot be reproduced: the dissertation gives neither the inertias nor the obstacle, and no arm "
            f"whose parameters are all one has both of its times. {compared(PUBLISHED, ours, 'the published times')}"
        )
        header = ["t_f", "Published", "Reference", "Ours, at the instants", "Ours, between them too"]
        return Table("Published and reference values compared with ours", header, rows, note)

    @override
    def recommendation(self, sentences: Sequence[str], cards: Sequence[Card]) -> Verdict:
        if not worst_case_holds(self.done):
            return super().recommendation(sentences, cards)
        return Verdict("good", "Build", headline(self.done), sentences, cards)

    @override
    def beside(self) -> str:
        share = share_text(self.done.evidence[WORST].joint)
        return f" The plan with a = √3 is not safe either: {share} of the payloads break a limit."

    @override
    def sentences(self) -> Iterator[str]:
        return sentences(self.done)

    @override
    def cards(self) -> Iterator[Card]:
        return cards(self.done)

    @override
    def schematic(self) -> Schematic:
        return arm_schematic(PAYLOAD)

    @override
    def chapters(self) -> Sequence[Section]:
        return chapters(self.done.families, self.names)

    @override
    def margin(self) -> Iterator[Block]:
        yield from why_one_sigma(self.done)
        yield from super().margin()
