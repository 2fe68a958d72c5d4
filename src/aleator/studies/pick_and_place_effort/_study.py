"""The study of pick and place with minimum effort."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, final

from typing_extensions import override

import aleator as al
from aleator._core.border import Progress
from aleator.reporting import Card, Schematic, Section, Table, given
from aleator.studies._motion.build import CALIBRATED
from aleator.studies._motion.family import Family
from aleator.studies._motion.results import Effort
from aleator.studies._motion.study import AbstractMotionStudy
from aleator.studies._study import Stage, stop_if_interrupted
from aleator.studies.pick_and_place_effort import DURATION, PAYLOAD, _page, _run, _verdict
from aleator.studies.pick_and_place_effort._facts import UNIT, effort_of, published_table
from aleator.studies.pick_and_place_effort._run import LEAST, MEAN, PAYLOADS, ROBUST, WIDE, Spread
from aleator.studies.two_link_arm import TORQUE
from aleator.studies.two_link_arm._drawing import arm_schematic


@final
class PickAndPlaceEffort(AbstractMotionStudy):
    """The plans of minimum effort and of minimum terminal variance, the front between them, and a wider payload."""

    title = "Pick and place with minimum effort: forward dynamics"
    subtitle = (
        f"Two-link arm, payload in kg: {PAYLOAD}; {given(DURATION)} s, torques within ±{given(TORQUE)} N m;"
        " dissertation, section 5.5.1"
    )
    glossary = _page.GLOSSARY
    full, quick = _run.FULL, _run.QUICK
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
        return _run.problems()

    @override
    def find_plans(self, progress: Progress) -> None:
        _run.search_plans(self.done, self.planned, progress)

    @override
    def margin_problem(self) -> al.Problem:
        return _run.margin_problem(self.done.plans[ROBUST])

    @override
    def more_stages(self) -> Mapping[str, Stage]:
        if not self.done.effort.whole:
            return {}
        return {"front": Stage(self.sweep_effort, 0.2), "wider payload": Stage(self.widen_payload, 0.1)}

    def sweep_effort(self, progress: Progress) -> None:
        """The cost of a smaller spread."""
        plans, most = self.done.plans, effort_of(self.done.families[LEAST])
        points = self.done.effort.front_points
        self.front = _run.sweep_effort(plans[LEAST], plans[ROBUST], most, points, progress)
        stop_if_interrupted(self.front)

    def widen_payload(self, progress: Progress) -> None:
        """The robust plan on payloads with five times the spread, sampled and by the expansion."""
        for i, payload in enumerate(PAYLOADS):
            progress(f"payload {payload}", i, len(PAYLOADS))
            self.flown[str(payload)], self.spreads[str(payload)] = _run.on_payload(self.done, payload)

    @override
    def more_results(self) -> Mapping[str, Any]:
        return {"front": self.front}

    @override
    def published(self) -> Table:
        return published_table(self.done)

    @override
    def beside(self) -> str:
        return _verdict.left_to_feedback(self.done)

    @override
    def sentences(self) -> Iterator[str]:
        return _verdict.sentences(self.done, self.spreads)

    @override
    def cards(self) -> Iterator[Card]:
        return _verdict.cards(self.done)

    @override
    def schematic(self) -> Schematic:
        return arm_schematic(PAYLOAD)

    @override
    def chapters(self) -> Sequence[Section]:
        families = self.done.families
        return [
            Section("The motion", list(_page.motion(families, self.names))),
            Section("Where the arm goes", list(_page.histories(families))),
            Section("Effort against spread", list(_page.trade_off(self.front))),
            Section("How wide a payload", list(_page.lesson(self.flown.get(str(WIDE)), self.spreads, self.names))),
        ]
