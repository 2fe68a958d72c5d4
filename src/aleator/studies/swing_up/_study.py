"""Swing-up of a double pendulum as the command line runs it: plans, evidence, finer steps, friction, the page."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, final

import equinox as eqx
from typing_extensions import override

import aleator as al
from aleator._core.progress import Progress
from aleator.reporting import (
    Block,
    Card,
    Drawing,
    Scene,
    Schematic,
    Section,
    Table,
    Text,
    Verdict,
    bands_figure,
    given,
    number,
    percent,
    share_text,
)
from aleator.studies._motion.build import CALIBRATED, build_verdict
from aleator.studies._motion.facts import (
    SHADES,
    animations,
    duration,
    tip_paths,
    violation_cards,
)
from aleator.studies._motion.family import Family, fly
from aleator.studies._motion.printed import compared
from aleator.studies._motion.results import Effort
from aleator.studies._motion.study import AbstractMotionStudy, Stage
from aleator.studies.swing_up import MASS_2, SMOOTHING, TORQUE, VARIANCE, DoublePendulum
from aleator.studies.swing_up._drawing import pendulum_drawing
from aleator.studies.swing_up._facts import (
    FAR,
    FINER,
    FRICTION,
    TIP,
    joints,
    missed,
    overloads,
    steps_table,
    terminal_norm,
)
from aleator.studies.swing_up._plans import ENERGY, EXPECTED, MEAN, NAMES, margin_problem, search_plans

REFERENCE = {MEAN: 27.8, EXPECTED: 30.6}
PUBLISHED = {MEAN: ("1060", "5.66"), EXPECTED: ("310", "4.46")}
PUBLISHED_VARIANCE = 0.0032

FULL = Effort(starts=7, calibration_samples=5_000)
QUICK = Effort(starts=1, samples=1_000, family=200, whole=False)


@final
class SwingUp(AbstractMotionStudy):
    """The swing-ups of least energy for the mean pendulum and for all pendulums."""

    title = "Swing-up of a double pendulum: hybrid dynamics"
    subtitle = (
        f"Driven at the first joint alone, within ±{given(TORQUE)} N m; mass of the second link in kg: {MASS_2};"
        " dissertation, section 5.5.3"
    )
    names = NAMES
    spared = (ENERGY, CALIBRATED)
    left_out = (
        "the calibration of the margin, the plan of least expected energy, finer steps, what friction does, and what"
        " the systems drawn do between instants"
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
    glossary = (
        ("Deterministic plan", "The swing-up of the mean pendulum that exchanges the least energy (74)."),
        ("Robust plan", "The same for all pendulums: upright in the mean, torque within its limits at μ ± σ (92)."),
        ("Expected torque", "Minimised: ∫ |E[τ₁] q̇₁| dt, the sum that (83) prints."),
        ("Expected energy", "Minimised: E[∫ |τ₁ q̇₁| dt]."),
        ("Hybrid dynamics", "The first joint follows the plan exactly, the second swings as it must (70), (71)."),
        ("Energy exchanged", "Given and taken back both count: ∫ |τ₁ q̇₁| dt."),
        ("Miss", f"The tip ends more than {given(FAR, 'm')} from its upright place."),
    )

    def __init__(self, effort: Effort):
        super().__init__(effort)
        self.finer: dict[str, Family] = {}
        self.frictionless: dict[str, Family] = {}

    def find_plans(self, progress: Progress) -> None:
        """See `search_plans`."""
        search_plans(self.done, self.planned, progress)

    @override
    def margin_problem(self) -> al.Problem:
        return margin_problem(self.done.plans[EXPECTED])

    @override
    def more(self) -> Mapping[str, Stage]:
        if not self.done.effort.whole:
            return {}
        return {"finer steps": Stage(self.refine, 0.1, lambda: set(self.names) <= set(self.frictionless))}

    def refine(self, progress: Progress) -> None:
        """The same pendulums once more with smaller steps, and once more without friction."""
        for i, (name, plan) in enumerate(self.done.plans.items()):
            progress(f"finer steps, {name}", i, len(self.done.plans))
            count = self.done.effort.family
            self.finer[name] = fly(plan.problem, plan.vector, count, seed=2, finer=FINER)
            bare: Any = eqx.tree_at(lambda tree: tree.system.model.damping, plan.problem, 0.0)
            self.frictionless[name] = fly(bare, plan.vector, count, seed=2)

    @override
    def more_results(self) -> Mapping[str, Any]:
        return {}

    @override
    def published(self) -> Table:
        done = self.done
        printed = {name: float(energy) for name, (energy, _) in PUBLISHED.items()}
        rows, ours = [], {name: plan.objective for name, plan in done.plans.items()}
        for name, plan in done.plans.items():
            energy, time = PUBLISHED.get(name, ("–", "–"))
            family = done.families.get(name)
            rows.append(
                [
                    name,
                    energy,
                    f"{REFERENCE[name]} at most" if name in REFERENCE else "–",
                    number(plan.objective, 4),
                    time,
                    number(duration(plan), 3),
                    "–" if name != EXPECTED else given(PUBLISHED_VARIANCE),
                    "–" if family is None else terminal_norm(family),
                ]
            )
        note = (
            "The published numbers are called powers, in W, and are sums over an unstated number of samples for another"
            f" friction. {compared(printed, ours, 'the energies')} Reference:"
            " what an independent search found. Variances are those of the random pendulums flown, ± one standard error"
            f" of that sample; the limit of the true one is {given(VARIANCE, 'm²')}, asked of the robust plans only."
            " Powers are rounded off where they are zero, which lowers an energy by at most"
            f" {given(SMOOTHING)} J a second."
        )
        header = [
            "",
            "Published (W)",
            "Reference (J)",
            "Ours (J)",
            "Published t_f (s)",
            "Ours (s)",
            "Published variance (m²)",
            "Ours (m²)",
        ]
        return Table("Published and reference values beside ours", header, rows, note)

    @override
    def recommendation(self, sentences: Sequence[str], cards: Sequence[Card]) -> Verdict:
        done = self.done
        return build_verdict(
            done.calibration,
            done.plans[EXPECTED],
            unit="J",
            who=self.who,
            beside=self._beside(),
            sentences=sentences,
            cards=cards,
        )

    def _beside(self) -> str:
        """How many pendulums the plan to build does not bring up: no limit of the problem says so."""
        if CALIBRATED not in self.done.families:
            return ""
        share = share_text(missed(self.done.families[CALIBRATED]))
        return f" Of the pendulums flown with it {share} end more than {given(FAR, 'm')} from upright."

    @override
    def sentences(self) -> Iterator[str]:
        done = self.done
        if MEAN in done.evidence and MEAN in done.families:
            yield (
                "Do not use the deterministic plan: flown on the family, it breaks the torque limit in"
                f" {share_text(done.evidence[MEAN].joint)} of the cases and misses the target by more than"
                f" {given(FAR, 'm')} in {share_text(missed(done.families[MEAN]))}."
            )
        if {MEAN, EXPECTED} <= set(done.plans) and EXPECTED in done.evidence:
            more = percent(done.plans[EXPECTED].objective / done.plans[MEAN].objective - 1)
            yield (
                f"The robust plan of the printed margin, a = 1, brings the family up for {more} more energy, but"
                f" {share_text(done.evidence[EXPECTED].joint)} of the pendulums ask for more torque than there is."
            )
        if {EXPECTED, ENERGY} <= set(done.plans):
            first, second = (done.plans[name] for name in (EXPECTED, ENERGY))
            yield (
                f"Whether the energy of the expected torque is made least ({number(first.objective, 4, 'J')} in"
                f" {number(duration(first), 3, 's')}) or the expected energy ({number(second.objective, 4, 'J')} in"
                f" {number(duration(second), 3, 's')}) makes little difference: the torque spreads little where power"
                " flows."
            )
        if EXPECTED in self.frictionless and EXPECTED in done.families:
            with_friction, without = (
                float(one[EXPECTED].systems["q2"][:, -1].std()) for one in (done.families, self.frictionless)
            )
            yield (
                f"Friction makes the masses differ: the second joint ends with σ = {number(with_friction, 2, 'rad')};"
                f" without friction all masses swing alike (σ = {number(without, 1, 'rad')}), and nothing would be"
                " uncertain but the torque."
            )

    @override
    def cards(self) -> Iterator[Card]:
        for name in (EXPECTED, CALIBRATED):
            if plan := self.done.plans.get(name):
                yield Card(f"Energy, {name}", number(plan.objective, 4, "J"), f"in {number(duration(plan), 3, 's')}")
        yield from violation_cards(self.done.evidence, (EXPECTED, CALIBRATED), "the torque limit")

    @override
    def schematic(self) -> Schematic:
        caption = (
            f"To scale, hanging at the start and upright at the target. The mass of the second link in kg: {MASS_2}."
            " Only the first joint is driven; both have friction."
        )
        return Schematic([pendulum_drawing(DoublePendulum())], "Double pendulum", caption, "5.8")

    @override
    def chapters(self) -> Sequence[Section]:
        return [
            Section("The motion", list(self._motion())),
            Section("The deterministic plan on the family", list(self._histories(MEAN, "5.10", "5.11"))),
            Section("The robust plan", list(self._histories(EXPECTED, "5.13", "5.14"))),
            Section("How far to trust the steps", list(self._steps())),
            Section("What friction does", list(self._friction())),
        ]

    def _motion(self) -> Iterator[Block]:
        families = self.done.families
        shown = [name for name in (MEAN, EXPECTED) if name in families]
        if not shown:
            return
        yield animations(families, shown, joints, TIP, Scene(), self.names, "5.9 and 5.12")
        figures = [
            tip_paths(families[name], name, joints, TIP, Scene(), overloads(families[name]), self.names)
            for name in (*shown, *([CALIBRATED] if CALIBRATED in families else []))
        ]
        caption = "The first joint is the same for all; the tips part as the second links swing. Cross: upright."
        yield Drawing(figures, "Path of the tip", caption)

    def _histories(self, name: str, torque: str, joint: str) -> Iterator[Block]:
        if name not in self.done.families:
            return
        family = self.done.families[name]
        figure = bands_figure(
            family.times, {"τ₁": family.systems["q1_torque"]}, y="Torque", unit="N m", limits=(-TORQUE, TORQUE)
        )
        yield Drawing([figure], "Torque over time", SHADES, torque)
        angles = {"q₁": family.systems["q1"], "q₂": family.systems["q2"]}
        targets = {"q₁": 0.0, "q₂": 0.0}
        figures = [
            bands_figure(family.times, angles, y="Joint angle", unit="rad", targets=targets, title="Joints"),
            bands_figure(
                family.times,
                {"x": family.systems["tip_x"], "y": family.systems["tip_y"]},
                y="Place of the tip",
                unit="m",
                targets={"x": TIP[0], "y": TIP[1]},
                title="Tip",
            ),
        ]
        yield Drawing(figures, "Joints and tip over time", f"Rings: the target. {SHADES}", joint)

    def _steps(self) -> Iterator[Block]:
        if self.finer:
            yield steps_table(self.done.families, self.finer)

    def _friction(self) -> Iterator[Block]:
        if not self.frictionless:
            return
        yield Text(FRICTION)
        rows = [
            [
                name,
                *(
                    number(float(one[name].systems["q2"][:, -1].std()), 2)
                    for one in (self.done.families, self.frictionless)
                ),
            ]
            for name in self.frictionless
        ]
        yield Table("σ of q₂ at the end (rad)", ["Plan", "With friction", "Without"], rows)


def make(quick: bool) -> SwingUp:
    """The study, at full or at quick effort."""
    return SwingUp(QUICK if quick else FULL)
