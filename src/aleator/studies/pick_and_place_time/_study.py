"""The study of pick and place in minimum time."""

from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, final

from typing_extensions import override

import aleator as al
from aleator._core.border import Progress
from aleator.reporting import Block, Card, Schematic, Section, Table, Verdict, given
from aleator.studies._motion.build import CALIBRATED
from aleator.studies._motion.study import AbstractMotionStudy
from aleator.studies.pick_and_place_time import PAYLOAD, _page, _run, _verdict
from aleator.studies.pick_and_place_time._facts import published_table
from aleator.studies.pick_and_place_time._run import MEAN, ONE, WORST
from aleator.studies.two_link_arm import TORQUE
from aleator.studies.two_link_arm._drawing import arm_schematic


@final
class PickAndPlaceTime(AbstractMotionStudy):
    """The fastest plans for the mean payload and for all payloads, and the margin for a tolerated violation rate."""

    title = "Pick and place in minimum time: inverse dynamics"
    subtitle = (
        f"Two-link arm, payload in kg: {PAYLOAD}; torques within ±{given(TORQUE)} N m;"
        " dissertation, sections 5.5.2 and 5.6"
    )
    glossary = _page.GLOSSARY
    full, quick = _run.FULL, _run.QUICK
    names = (MEAN, ONE, WORST, CALIBRATED)
    only_whole = "plans with limits at the instants alone, and what the systems drawn do between instants"
    sigmas: ClassVar = _run.SIGMAS
    limits = ("torque",)
    who = "payloads"
    measures: ClassVar = dict.fromkeys(names, "duration, s")
    unit = "s"

    @property
    @override
    def problems(self) -> Mapping[str, al.Problem]:
        return _run.problems()

    @override
    def find_plans(self, progress: Progress) -> None:
        _run.search_plans(self.done, progress)

    @override
    def margin_problem(self) -> al.Problem:
        return _run.margin_problem(self.done.plans[ONE])

    @override
    def published(self) -> Table:
        return published_table(self.done)

    @override
    def recommendation(self, sentences: Sequence[str], cards: Sequence[Card]) -> Verdict:
        if not _verdict.worst_case_holds(self.done):
            return super().recommendation(sentences, cards)
        return Verdict("good", "Build", _verdict.headline(self.done), sentences, cards)

    @override
    def beside(self) -> str:
        return _verdict.worst_case_broken(self.done)

    @override
    def sentences(self) -> Iterator[str]:
        return _verdict.sentences(self.done)

    @override
    def cards(self) -> Iterator[Card]:
        return _verdict.cards(self.done)

    @override
    def schematic(self) -> Schematic:
        return arm_schematic(PAYLOAD)

    @override
    def chapters(self) -> Sequence[Section]:
        return _page.chapters(self.done.families, self.names)

    @override
    def margin(self) -> Iterator[Block]:
        yield from _page.why_one_sigma(self.done)
        yield from super().margin()
