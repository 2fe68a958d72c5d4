"""Pick and place with the least effort as the command line runs it: plans, evidence, a front, a wider payload."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, final

import numpy as np
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
    front_figure,
    given,
    number,
    percent,
    share_text,
)
from aleator.studies._motion.build import CALIBRATED, TRIED, build_verdict
from aleator.studies._motion.facts import SHADES, animations, named, tip_paths, violation_cards
from aleator.studies._motion.family import Family
from aleator.studies._motion.results import Effort
from aleator.studies._motion.study import AbstractMotionStudy, Stage
from aleator.studies.pick_and_place_effort import (
    DURATION,
    PAYLOAD,
    deterministic_problem,
    robust_problem,
    start_torques,
    terminal_variance_problem,
)
from aleator.studies.pick_and_place_effort._facts import (
    LEAST,
    LESSON,
    MEAN,
    REFERENCE,
    ROBUST,
    UNIT,
    Spread,
    effort_of,
    pair_text,
    published_table,
    spreads_table,
    terminal_spread,
)
from aleator.studies.two_link_arm import TARGET, TORQUE
from aleator.studies.two_link_arm._drawing import arm_schematic
from aleator.studies.two_link_arm._views import SCENE, TIP, TOGETHER, joints, touches
from aleator.transcription import transcribe

WIDE = al.Uniform(1.0, std=0.5)
BENDS = (1.2, 0.6, 2.5)
"""How far the elbow is bent on the paths from which searches start beside the problem's own, rad."""

MOST = 2 * TORQUE**2 * DURATION
"""The effort of both torques at their limits throughout: no plan takes more."""

FULL = Effort(starts=4)
QUICK = Effort(starts=1, samples=2_000, family=400, calibration_samples=2_000, whole=False)


@final
class PickAndPlaceEffort(AbstractMotionStudy):
    """The plans of least effort and of least terminal variance, what lies between them, and a wider payload."""

    title = "Pick and place with the least effort: forward dynamics"
    subtitle = (
        f"Two-link arm, payload in kg: {PAYLOAD}; {given(DURATION)} s, torques within ±{given(TORQUE)} N m;"
        " dissertation, section 5.5.1"
    )
    names = (MEAN, ROBUST, LEAST, CALIBRATED)
    spared = (LEAST,)
    left_out = (
        "the plan of least variance, its front, plans with limits at the instants alone, what the systems drawn do"
        " between instants, and a wider payload"
    )
    sigmas: ClassVar = {ROBUST: 1.0}
    limits = ("obstacle", "wall")
    who = "payloads"
    measures: ClassVar = {
        MEAN: f"effort, {UNIT}",
        ROBUST: f"effort, {UNIT}",
        LEAST: "norm of variances, m²",
        CALIBRATED: f"effort, {UNIT}",
    }
    glossary = (
        ("Deterministic plan", "The least effort that brings the mean payload to its target (72)."),
        ("Robust plan", "The least effort that does so in the mean, one σ off obstacle and wall, (79) and (90)."),
        ("Least variance", "Under the same limits, the least norm of the tip's variances at the end (86)."),
        ("Effort", f"∫ τ₁² + τ₂² dt, {UNIT}."),
        ("Forward dynamics", "The torques act as planned, open loop; the payload changes where the arm goes."),
        ("μ, σ", "Mean and standard deviation over all payloads."),
        ("Leave-one-out error", "Of predicting one collocation point from all others, relative to the variance."),
    )

    def __init__(self, effort: Effort):
        super().__init__(effort)
        self.front: al.Front | None = None
        self.spreads: dict[str, dict[str, Spread]] = {}
        self.wide: Family | None = None

    def find_plans(self, progress: Progress) -> None:
        """Deterministic from bent paths; the others from the plans before them, and from these paths as well."""
        done = self.done
        # An empty start is the problem's own.
        bent = [{}, *({"torque.free": start_torques(bend)} for bend in BENDS)][: done.effort.starts]
        plan = done.search(MEAN, named(deterministic_problem(), TOGETHER), bent, progress)
        problems = {ROBUST: robust_problem(), LEAST: terminal_variance_problem(effort=MOST)}
        for name in (name for name in problems if name in self.planned):
            plan = done.search(name, named(problems[name], TOGETHER), [dict(plan.decisions), *bent[1:]], progress)
        done.solve_at_instants()

    @override
    def margin_problem(self) -> al.Problem:
        return named(robust_problem(TRIED, guess=self.done.plans[ROBUST].decisions["torque.free"]), TOGETHER)

    @override
    def more(self) -> Mapping[str, Stage]:
        front = Stage(self.sweep_effort, 0.2, lambda: self.front is not None and not self.front.interrupted)
        wider = Stage(self.widen_payload, 0.1, lambda: self.wide is not None)
        return {"front": front, "wider payload": wider} if self.done.effort.whole else {}

    def sweep_effort(self, progress: Progress) -> None:
        """The least terminal variance for each effort, from where more effort helps no more down to the robust plan."""
        plan, least = self.done.plans[LEAST], self.done.plans[ROBUST].objective
        most = effort_of(self.done.families[LEAST])
        problem = named(terminal_variance_problem(effort=MOST, guess=plan.decisions["torque.free"]), TOGETHER)
        values = np.linspace(most, 1.01 * least, self.done.effort.front_points)
        self.front = al.pareto(problem, "effort", values, progress=progress)
        if self.front.interrupted:
            raise KeyboardInterrupt

    def widen_payload(self, progress: Progress) -> None:
        """The robust plan on payloads that spread five times as much: sampled, and as the expansion sees it."""
        plan = self.done.plans[ROBUST]
        for i, payload in enumerate((PAYLOAD, WIDE)):
            progress(f"payload {payload}", i, 2)
            problem = named(robust_problem(payload=payload), TOGETHER)
            self.wide = self.done.flown(plan, problem, seed=3)
            resolved = transcribe(problem).resolve(plan.vector)
            ends = {name: resolved[f"{name}(t_f)"] for name in ("q1", "q2")}
            self.spreads[str(payload)] = {
                name: Spread(float(self.wide.systems[name][:, -1].std()), float(one.std), float(one.leave_one_out))
                for name, one in ends.items()
            }

    @override
    def more_results(self) -> Mapping[str, Any]:
        return {"front": self.front}

    @override
    def published(self) -> Table:
        return published_table(self.done)

    @override
    def recommendation(self, sentences: Sequence[str], cards: Sequence[Card]) -> Verdict:
        done = self.done
        return build_verdict(
            done.calibration,
            done.plans[ROBUST],
            unit=UNIT,
            who=self.who,
            beside=self._beside(),
            sentences=sentences,
            cards=cards,
        )

    def _beside(self) -> str:
        """What clearance does not do: it does not bring every payload to its place."""
        if CALIBRATED not in self.done.families:
            return ""
        spread = pair_text(terminal_spread(self.done.families[CALIBRATED]))
        return f" At the end its tip spreads by σ = {spread} m in x and y: feedback has to do the rest."

    @override
    def sentences(self) -> Iterator[str]:
        done, families = self.done, self.done.families
        if {MEAN, ROBUST} <= set(done.evidence):
            mean, robust = (done.evidence[name].violations["obstacle"] for name in (MEAN, ROBUST))
            yield (
                "The deterministic plan grazes the obstacle with the mean payload, so that"
                f" {share_text(mean)} of all payloads hit it. One σ of clearance, as printed, leaves"
                f" {share_text(robust)}: the share of payloads that a uniform law has beyond one σ on one side is"
                " 21.1 %."
            )
        if {ROBUST, LEAST} <= set(families):
            robust, least = (terminal_spread(families[name]) for name in (ROBUST, LEAST))
            efforts = [effort_of(families[name]) for name in (ROBUST, LEAST)]
            yield (
                f"At the end the tip spreads by σ = {pair_text(robust)} m in x and y. The most that torques can do,"
                f" with {number(efforts[1] / efforts[0], 3)} times the effort, is {pair_text(least)} m: no open-loop"
                " plan brings it to zero."
            )
        if wide := self.spreads.get(str(WIDE)):
            spread, error = (
                max(parts) for parts in zip(*((one.sampled, one.error) for one in wide.values()), strict=True)
            )
            yield (
                f"With payloads that spread five times as much a joint ends with σ = {number(spread, 2, 'rad')}, and"
                f" order 5 misses a new payload by {percent(error)} of it: there the expansion must not be trusted."
            )

    @override
    def cards(self) -> Iterator[Card]:
        plans = self.done.plans
        if ROBUST in plans:
            note = f"margin a = 1; reference {REFERENCE[ROBUST]}"
            yield Card(f"Effort, {ROBUST}", number(plans[ROBUST].objective, 4, UNIT), note)
        if CALIBRATED in plans and self.done.calibration is not None:
            note = f"margin a = {number(self.done.calibration.sigmas, 3)}"
            yield Card(f"Effort, {CALIBRATED}", number(plans[CALIBRATED].objective, 4, UNIT), note)
        yield from violation_cards(self.done.evidence, (ROBUST, CALIBRATED), "a limit")

    @override
    def schematic(self) -> Schematic:
        return arm_schematic(PAYLOAD)

    @override
    def chapters(self) -> Sequence[Section]:
        return [
            Section("The motion", list(self._motion())),
            Section("Where the arm goes", list(self._histories())),
            Section("Effort against spread", list(self._front())),
            Section("How wide a payload", list(self._lesson())),
        ]

    def _motion(self) -> Iterator[Block]:
        families = self.done.families
        shown = [name for name in (MEAN, ROBUST) if name in families]
        if not shown:
            return
        yield animations(families, shown, joints, TIP, SCENE, self.names)
        figures = [
            tip_paths(families[name], name, joints, TIP, SCENE, touches(families[name]), self.names)
            for name in families
        ]
        caption = (
            "The same torques with another payload lead elsewhere. Arms that touch obstacle or wall, with either link,"
            " stand out."
        )
        yield Drawing(figures, "Path of the tip", caption)

    def _histories(self) -> Iterator[Block]:
        numbers = {MEAN: "5.2", ROBUST: "5.3", LEAST: "5.4"}
        for name, family in ((name, self.done.families[name]) for name in numbers if name in self.done.families):
            systems = family.systems
            targets = {"q₁": TARGET[0], "q₂": TARGET[1], "x": float(TIP[0]), "y": float(TIP[1])}
            angles = {"q₁": systems["q1"], "q₂": systems["q2"]}
            places = {"x": systems["tip_x"], "y": systems["tip_y"]}
            figures = [
                bands_figure(family.times, angles, y="Joint angle", unit="rad", targets=targets, title="Joints"),
                bands_figure(family.times, places, y="Place of the tip", unit="m", targets=targets, title="Tip"),
            ]
            caption = f"Rings: the target. {SHADES}"
            yield Drawing(figures, f"{name.capitalize()} plan on its family", caption, numbers[name])
        torques = [
            bands_figure(
                family.times,
                {"τ₁": family.nominal["q1_torque"][None], "τ₂": family.nominal["q2_torque"][None]},
                y="Torque",
                unit="N m",
                limits=(-TORQUE, TORQUE),
                title=name.capitalize(),
            )
            for name, family in self.done.families.items()
        ]
        if torques:
            yield Drawing(torques, "Torques", "They act as planned on every arm: nothing spreads.")

    def _front(self) -> Iterator[Block]:
        if self.front is None:
            return
        figure = front_figure(
            {"least variance": self.front},
            x="Effort allowed",
            x_unit=UNIT,
            y="Norm of the tip's variances",
            y_unit="m²",
        )
        caption = (
            "Each point is the plan whose tip spreads least for its effort. The first steps beyond the robust plan's"
            " effort buy most; at the right end the torques are at their limits wherever that helps."
        )
        yield Drawing([figure], "What a smaller spread costs", caption)

    def _lesson(self) -> Iterator[Block]:
        if self.wide is None:
            return
        yield Text(LESSON, lead="An open-loop plan for widely spread payloads is not one plan.")
        yield spreads_table(self.spreads)
        wide = self.wide
        angles = {"q₁": wide.systems["q1"], "q₂": wide.systems["q2"]}
        paths = tip_paths(wide, ROBUST, joints, TIP, SCENE, touches(wide), self.names)
        figures = [bands_figure(wide.times, angles, y="Joint angle", unit="rad", title="Joints"), paths]
        yield Drawing(figures, f"The robust plan with payload {WIDE}", SHADES)


def make(quick: bool) -> PickAndPlaceEffort:
    """The study, at full or at quick effort."""
    return PickAndPlaceEffort(QUICK if quick else FULL)
