"""The study of pick and place with minimum effort: the chapters of its page, and its declaration."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, final

from typing_extensions import override

import aleator as al
from aleator._core.border import Progress
from aleator.reporting import Block, Card, Drawing, Schematic, Section, Table, Text, front_figure, given, linked_front
from aleator.studies._motion.facts import CALIBRATED
from aleator.studies._motion.results import Effort, Family
from aleator.studies._motion.study import AbstractMotionStudy
from aleator.studies._motion.views import SHADES, angles_figure, animations, joints_and_tip, tip_paths, torques_figure
from aleator.studies._staged import Stage, stop_if_interrupted
from aleator.studies.pick_and_place_effort import DURATION, PAYLOAD
from aleator.studies.pick_and_place_effort._facts import (
    LESSON,
    UNIT,
    cards,
    effort_of,
    left_to_feedback,
    published_table,
    sentences,
    spreads_table,
)
from aleator.studies.pick_and_place_effort._run import (
    FULL,
    LEAST,
    MEAN,
    PAYLOADS,
    QUICK,
    ROBUST,
    WIDE,
    Spread,
    margin_problem,
    on_payload,
    problems,
    search_plans,
    sweep_effort,
)
from aleator.studies.two_link_arm import TARGET, TORQUE
from aleator.studies.two_link_arm._views import SCENE, TIP, arm_schematic, joints, touches

GLOSSARY = (
    ("Deterministic plan", "The minimum effort that brings the mean payload to its target (72)."),
    (
        "Robust plan",
        "The minimum effort that does so in the mean, with one σ of clearance from obstacle and wall, (79) and (90).",
    ),
    ("Least variance", "Under the same limits, the minimum norm of the tip's variances at the end (86)."),
    ("Effort", f"∫ τ₁² + τ₂² dt, {UNIT}."),
    ("Forward dynamics", "The torques act as planned, open loop; the payload changes where the arm goes."),
    ("μ, σ", "Mean and standard deviation over all payloads."),
    ("Leave-one-out error", "Of predicting one collocation point from all others, relative to the variance."),
)


def motion(families: Mapping[str, Family], names: Sequence[str]) -> Iterator[Block]:
    """The plans in motion; `names` are all plans of the study."""
    shown = [name for name in (MEAN, ROBUST) if name in families]
    if not shown:
        return
    yield animations(families, shown, joints, TIP, SCENE, names)
    figures = [tip_paths(one, name, joints, TIP, SCENE, touches(one), names) for name, one in families.items()]
    caption = (
        "With another payload, the same torques lead elsewhere. Arms that touch obstacle or wall, with either link, "
        "are highlighted."
    )
    yield Drawing(figures, "Path of the tip", caption)


def histories(families: Mapping[str, Family]) -> Iterator[Block]:
    """Joints, tip and torques over time."""
    numbers = {MEAN: "5.2", ROBUST: "5.3", LEAST: "5.4"}
    for name, number in numbers.items():
        if name in families:
            figures = joints_and_tip(families[name], TARGET, TIP)
            caption = f"Rings: the target. {SHADES}"
            yield Drawing(figures, f"{name.capitalize()} plan on its family", caption, number)
    torques = [
        torques_figure(
            one.times,
            {"τ₁": one.nominal["q1_torque"][None], "τ₂": one.nominal["q2_torque"][None]},
            TORQUE,
            name.capitalize(),
        )
        for name, one in families.items()
    ]
    if torques:
        yield Drawing(torques, "Torques", "They act as planned on every arm, and so have no spread.")


def trade_off(front: al.results.Front | None) -> Iterator[Block]:
    """The trade-off between effort and spread."""
    if front is None:
        return
    fronts = {"least variance": front}
    figure = front_figure(
        fronts,
        x="Effort allowed",
        x_unit=UNIT,
        y="Norm of the tip's variances",
        y_unit="m²",
    )
    caption = (
        "Each point is the plan with the smallest spread of the tip for its effort. The first increases beyond the "
        "robust plan's effort gain most; at the right end the torques are at their limits wherever that helps."
    )
    yield linked_front(fronts, [figure], "The cost of a smaller spread", caption)


def lesson(wide: Family | None, spreads: Mapping[str, Mapping[str, Spread]], names: Sequence[str]) -> Iterator[Block]:
    """The effect of a wider payload distribution on one plan."""
    if wide is None:
        return
    yield Text(LESSON, lead="No single open-loop plan suits widely spread payloads.")
    yield spreads_table(spreads)
    paths = tip_paths(wide, ROBUST, joints, TIP, SCENE, touches(wide), names)
    yield Drawing([angles_figure(wide, "Joints"), paths], f"The robust plan with payload {WIDE}", SHADES)


@final
class PickAndPlaceEffort(AbstractMotionStudy):
    """The plans of minimum effort and of minimum terminal variance, the front between them, and a wider payload."""

    title = "Pick and place with minimum effort: forward dynamics"
    subtitle = (
        f"Two-link arm, payload in kg: {PAYLOAD}; {given(DURATION)} s, torques within ±{given(TORQUE)} N m;"
        " dissertation, section 5.5.1"
    )
    glossary = GLOSSARY
    full, quick = FULL, QUICK
    names = (MEAN, ROBUST, LEAST, CALIBRATED)
    spared = (LEAST,)
    only_whole = (
        "the plan of least variance, its front, plans with limits at the instants alone, what the systems drawn do"
        " between instants, and a wider payload"
    )
    sigmas: ClassVar = {ROBUST: 1.0}
    limits = ("obstacle", "wall")
    who = "payloads"
    measures: ClassVar = {**dict.fromkeys(names, f"effort, {UNIT}"), LEAST: "norm of variances, m²"}
    unit = UNIT

    def __init__(self, effort: Effort):
        super().__init__(effort)
        self.front: al.results.Front | None = None
        self.spreads: dict[str, dict[str, Spread]] = {}
        self.flown: dict[str, Family] = {}

    @property
    @override
    def problems(self) -> Mapping[str, al.Problem]:
        return problems()

    @override
    def find_plans(self, progress: Progress) -> None:
        search_plans(self.done, self.planned, progress)

    @override
    def margin_problem(self) -> al.Problem:
        return margin_problem(self.done.plans[ROBUST])

    @override
    def more_stages(self) -> Mapping[str, Stage]:
        if not self.done.effort.whole:
            return {}
        return {"front": Stage(self.sweep_effort, 0.2), "wider payload": Stage(self.widen_payload, 0.1)}

    def sweep_effort(self, progress: Progress) -> None:
        """The cost of a smaller spread."""
        plans, most = self.done.plans, effort_of(self.done.families[LEAST])
        points = self.done.effort.front_points
        self.front = sweep_effort(plans[LEAST], plans[ROBUST], most, points, progress)
        stop_if_interrupted(self.front)

    def widen_payload(self, progress: Progress) -> None:
        """The robust plan on payloads with five times the spread, sampled and by the expansion."""
        for i, payload in enumerate(PAYLOADS):
            progress(f"payload {payload}", i, len(PAYLOADS))
            self.flown[str(payload)], self.spreads[str(payload)] = on_payload(self.done, payload)

    @override
    def more_results(self) -> Mapping[str, Any]:
        return {"front": self.front}

    @override
    def published(self) -> Table:
        return published_table(self.done)

    @override
    def beside(self) -> str:
        return left_to_feedback(self.done)

    @override
    def sentences(self) -> Iterator[str]:
        return sentences(self.done, self.spreads)

    @override
    def cards(self) -> Iterator[Card]:
        return cards(self.done)

    @override
    def schematic(self) -> Schematic:
        return arm_schematic(PAYLOAD)

    @override
    def chapters(self) -> Sequence[Section]:
        families = self.done.families
        return [
            Section("The motion", list(motion(families, self.names))),
            Section("Where the arm goes", list(histories(families))),
            Section("Effort against spread", list(trade_off(self.front))),
            Section("How wide a payload", list(lesson(self.flown.get(str(WIDE)), self.spreads, self.names))),
        ]
