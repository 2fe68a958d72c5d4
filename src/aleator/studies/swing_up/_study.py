"""The swing-up study: a drawing to scale, the chapters of its page, and its declaration."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, final

from typing_extensions import override

import aleator as al
from aleator._core.border import Progress
from aleator.reporting import Block, Card, Drawing, Scene, Schematic, Section, Table, Text, given, sketch
from aleator.reporting.sketch import Point, View
from aleator.studies._motion.facts import CALIBRATED
from aleator.studies._motion.results import Effort, Family
from aleator.studies._motion.study import AbstractMotionStudy
from aleator.studies._motion.views import SHADES, animations, joints_and_tip, tip_paths, torques_figure
from aleator.studies._staged import Stage
from aleator.studies.swing_up import MASS_2, TORQUE, DoublePendulum
from aleator.studies.swing_up._facts import (
    FAR,
    FRICTION,
    TIP,
    cards,
    friction_table,
    joints,
    left_below,
    overloads,
    published_table,
    sentences,
    steps_table,
)
from aleator.studies.swing_up._run import (
    ENERGY,
    EXPECTED,
    FULL,
    MEAN,
    QUICK,
    flown_finer,
    flown_frictionless,
    margin_problem,
    problems,
    search_plans,
)

WIDTH, HEIGHT = 420.0, 470.0
REACH = 195.0
"""Pixels from the first joint to the tip of the straight pendulum."""

HANGING, SWINGING, UPRIGHT = (-math.pi, 0.0), (-2.2, 0.5), (0.0, 0.0)
"""Angles of both joints, rad; the one between only shows how they are measured."""

GLOSSARY = (
    ("Deterministic plan", "The swing-up of the mean pendulum that exchanges the least energy (74)."),
    (
        "Robust plan",
        "The same for all pendulums: upright in the mean, with μ ± σ of the torque within its limits (92).",
    ),
    ("Expected torque", "Minimised: ∫ |E[τ₁] q̇₁| dt, the sum in equation (83)."),
    ("Expected energy", "Minimised: E[∫ |τ₁ q̇₁| dt]."),
    ("Hybrid dynamics", "The first joint follows the plan exactly, the second follows from the dynamics (70), (71)."),
    ("Energy exchanged", "Energy supplied and absorbed both count: ∫ |τ₁ q̇₁| dt."),
    ("Miss", f"The tip ends more than {given(FAR, 'm')} from its upright position."),
)


def pendulum_drawing(pendulum: DoublePendulum) -> str:
    """The pendulum (with numbers for its lengths) as SVG: its start and target dashed, a posture between them solid."""
    lengths = float(pendulum.length_1), float(pendulum.length_2)  # pyright: ignore[reportArgumentType]
    at = View((130.0, HEIGHT / 2), REACH / sum(lengths))
    base, elbow, tip = _points(lengths, SWINGING, at)
    hanging, upright = (_points(lengths, posture, at) for posture in (HANGING, UPRIGHT))
    first, second = (90.0 + math.degrees(one) for one in (SWINGING[0], sum(SWINGING)))
    ahead = (elbow[0] + 60 * math.cos(math.radians(first)), elbow[1] - 60 * math.sin(math.radians(first)))
    parts = [
        sketch.path(hanging, kind="hanging", dash=sketch.DASHED),
        sketch.path(upright, kind="upright", dash=sketch.DASHED),
        sketch.path([base, elbow, tip], kind="swinging", width=5.0),
        *(sketch.circle(place, 5.0, filled=True) for place in (base, elbow, hanging[1], upright[1])),
        sketch.ground((base[0] - 60, base[1] - 22), (base[0] - 60, base[1] + 22)),
        sketch.path([(base[0] - 60, base[1]), base], width=2.0),
        sketch.arc(base, 50.0, 90.0, first, kind="q1", arrow=True),
        sketch.path([elbow, ahead], width=1.2, dash=sketch.DASHED),
        sketch.arc(elbow, 48.0, first, second, kind="q2", arrow=True),
        sketch.label((base[0] + 54, base[1] - 22), "q₁, τ₁", anchor="start"),
        sketch.label((ahead[0] + 8, ahead[1] + 6), "q₂ (free)", anchor="start"),
        sketch.label((upright[2][0] + 14, upright[2][1] + 8), "target", anchor="start"),
        sketch.label((hanging[2][0] + 14, hanging[2][1]), "start", anchor="start"),
        sketch.label((hanging[1][0] - 12, (hanging[0][1] + hanging[1][1]) / 2 + 16), _length(1, lengths), anchor="end"),
        sketch.label((hanging[1][0] - 12, (hanging[1][1] + hanging[2][1]) / 2), _length(2, lengths), anchor="end"),
        sketch.label(((elbow[0] + tip[0]) / 2 + 14, (elbow[1] + tip[1]) / 2 - 14), "m₂(ξ)"),
        sketch.arrow((360.0, 60.0), (360.0, 120.0), kind="gravity"),
        sketch.label((372.0, 95.0), "g", anchor="start"),
    ]
    title = "Double pendulum driven at its first joint: hanging at the start, upright at the target"
    return sketch.drawing(parts, width=WIDTH, height=HEIGHT, title=title)


def _length(which: int, lengths: tuple[float, float]) -> str:
    return f"l{'₁₂'[which - 1]} = {given(lengths[which - 1], 'm')}"


def _points(lengths: tuple[float, float], q: tuple[float, float], at: View) -> tuple[Point, Point, Point]:
    """First joint, second joint and tip; `q1` is measured from upright, `q2` from the first link."""
    elbow = (-lengths[0] * math.sin(q[0]), lengths[0] * math.cos(q[0]))
    tip = (elbow[0] - lengths[1] * math.sin(sum(q)), elbow[1] + lengths[1] * math.cos(sum(q)))
    return at(0, 0), at(*elbow), at(*tip)


def schematic() -> Schematic:
    """The pendulum as a drawing."""
    caption = (
        f"To scale, hanging at the start and upright at the target. The mass of the second link in kg: {MASS_2}."
        " Only the first joint is driven; both have friction."
    )
    return Schematic([pendulum_drawing(DoublePendulum())], "Double pendulum", caption, "5.8")


def motion(families: Mapping[str, Family], names: Sequence[str]) -> Iterator[Block]:
    """The plans in motion; `names` are all plans of the study."""
    shown = [name for name in (MEAN, EXPECTED) if name in families]
    if not shown:
        return
    yield animations(families, shown, joints, TIP, Scene(), names, "5.9 and 5.12")
    figures = [
        tip_paths(families[name], name, joints, TIP, Scene(), overloads(families[name]), names)
        for name in (*shown, *([CALIBRATED] if CALIBRATED in families else []))
    ]
    caption = "The first joint moves alike in all systems; the tips diverge as the second links swing. Cross: upright."
    yield Drawing(figures, "Path of the tip", caption)


def histories(family: Family | None, torque: str, joint: str) -> Iterator[Block]:
    """Torque, joints and tip over time; `torque` and `joint` are the numbers of the figures that show the same."""
    if family is None:
        return
    figure = torques_figure(family.times, {"τ₁": family.systems["q1_torque"]}, TORQUE)
    yield Drawing([figure], "Torque over time", SHADES, torque)
    figures = joints_and_tip(family, UPRIGHT, TIP)
    yield Drawing(figures, "Joints and tip over time", f"Rings: the target. {SHADES}", joint)


def finer_steps(families: Mapping[str, Family], finer: Mapping[str, Family]) -> Iterator[Block]:
    """The accuracy of the integration steps."""
    if finer:
        yield steps_table(families, finer)


def friction(families: Mapping[str, Family], frictionless: Mapping[str, Family]) -> Iterator[Block]:
    """The effect of friction."""
    if frictionless:
        yield Text(FRICTION)
        yield friction_table(families, frictionless)


@final
class SwingUp(AbstractMotionStudy):
    """The swing-ups of minimum energy for the mean pendulum and for all pendulums."""

    title = "Swing-up of a double pendulum: hybrid dynamics"
    subtitle = (
        f"Driven at the first joint alone, within ±{given(TORQUE)} N m; mass of the second link in kg: {MASS_2};"
        " dissertation, section 5.5.3"
    )
    glossary = GLOSSARY
    full, quick = FULL, QUICK
    names = (MEAN, ENERGY, EXPECTED, CALIBRATED)
    spared = (ENERGY, CALIBRATED)
    only_whole = (
        "the calibration of the margin, the plan of minimum expected energy, finer steps, the effect of friction, and "
        "the motion of the systems drawn between instants"
    )
    sigmas: ClassVar = {EXPECTED: 1.0}
    limits = ("torque",)
    who = "pendulums"
    measures: ClassVar = {
        MEAN: "energy exchanged, J",
        EXPECTED: "energy of the expected torque, J",
        ENERGY: "expected energy, J",
        CALIBRATED: "energy of the expected torque, J",
    }
    unit = "J"

    def __init__(self, effort: Effort):
        super().__init__(effort)
        self.finer: dict[str, Family] = {}
        self.frictionless: dict[str, Family] = {}

    @property
    @override
    def problems(self) -> Mapping[str, al.Problem]:
        return problems()

    @override
    def find_plans(self, progress: Progress) -> None:
        search_plans(self.done, self.planned, progress)

    @override
    def margin_problem(self) -> al.Problem:
        return margin_problem(self.done.plans[EXPECTED])

    @override
    def more_stages(self) -> Mapping[str, Stage]:
        return {"finer steps": Stage(self.refine, 0.1)} if self.done.effort.whole else {}

    def refine(self, progress: Progress) -> None:
        """The same pendulums once more with smaller steps, and once more without friction."""
        count = self.done.effort.family
        for i, (name, plan) in enumerate(self.done.plans.items()):
            progress(f"finer steps, {name}", i, len(self.done.plans))
            self.finer[name] = flown_finer(name, plan, count)
            self.frictionless[name] = flown_frictionless(name, plan, count)

    @override
    def published(self) -> Table:
        return published_table(self.done)

    @override
    def beside(self) -> str:
        return left_below(self.done)

    @override
    def sentences(self) -> Iterator[str]:
        return sentences(self.done, self.frictionless)

    @override
    def cards(self) -> Iterator[Card]:
        return cards(self.done)

    @override
    def schematic(self) -> Schematic:
        return schematic()

    @override
    def chapters(self) -> Sequence[Section]:
        families = self.done.families
        mean, robust = families.get(MEAN), families.get(EXPECTED)
        return [
            Section("The motion", list(motion(families, self.names))),
            Section("The deterministic plan on the family", list(histories(mean, "5.10", "5.11"))),
            Section("The robust plan", list(histories(robust, "5.13", "5.14"))),
            Section("Accuracy of the steps", list(finer_steps(families, self.finer))),
            Section("The effect of friction", list(friction(families, self.frictionless))),
        ]
