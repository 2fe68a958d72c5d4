"""The base class of motion studies: their common stages, saved results and chapters."""

import abc
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

from typing_extensions import override

import aleator as al
from aleator._core.border import Progress
from aleator.reporting import Block, Card, Code, Schematic, Section, Table, Verdict, certificate_table
from aleator.studies._motion.facts import (
    CALIBRATED,
    build_verdict,
    margin_blocks,
    optima_table,
    plans_table,
    price_table,
)
from aleator.studies._motion.results import Effort, MotionResults
from aleator.studies._shared import no_recommendation
from aleator.studies._staged import AbstractStagedStudy, Stage


class AbstractMotionStudy(AbstractStagedStudy):
    """A study that searches for plans of one motion, flies them on their families and reports on them."""

    names: ClassVar[tuple[str, ...]]
    """Its plans."""
    spared: ClassVar[tuple[str, ...]] = ()
    """The plans that a quick run skips."""
    only_whole: ClassVar[str]
    """Everything that a quick run skips, in words."""
    sigmas: ClassVar[Mapping[str, float]]
    """The given margins of its robust plans; the first is the published one."""
    limits: ClassVar[tuple[str, ...]]
    """The limits with a margin, which is calibrated for all of them."""
    who: ClassVar[str]
    """The name of its systems."""
    measures: ClassVar[Mapping[str, str]]
    """The objective of each plan, with its unit."""
    unit: ClassVar[str]
    """The unit of the published plan's objective."""

    def __init__(self, effort: Effort):
        self.done = MotionResults(effort)

    @abc.abstractmethod
    def find_plans(self, progress: Progress) -> None:
        """Search for all plans."""

    @abc.abstractmethod
    def margin_problem(self) -> al.Problem:
        """The problem whose margin is calibrated, to be solved from the published plan."""

    @abc.abstractmethod
    def sentences(self) -> Iterator[str]:
        """The sentences of the first screen, on the plans available."""

    @abc.abstractmethod
    def cards(self) -> Iterator[Card]:
        """The key numbers of the first screen, of the plans available."""

    @abc.abstractmethod
    def published(self) -> Table:
        """Published and reference values compared with computed ones; called once there is a plan."""

    @abc.abstractmethod
    def schematic(self) -> Schematic:
        """The system as a drawing."""

    @abc.abstractmethod
    def chapters(self) -> Sequence[Section]:
        """The chapters with figures; called with whatever results are available."""

    def more_stages(self) -> Mapping[str, Stage]:
        """The stages after plans, evidence and families; none by default."""
        return {}

    def more_results(self) -> Mapping[str, Any]:
        """The results of these stages to save; none by default."""
        return {}

    def beside(self) -> str:
        """A further sentence on the plan to build; none by default."""
        return ""

    def recommendation(self, sentences: Sequence[str], cards: Sequence[Card]) -> Verdict:
        """What to build; called once all plans and their evidence are available."""
        return build_verdict(
            self.done.calibration,
            self.done.plans[self.printed],
            unit=self.unit,
            who=self.who,
            beside=self.beside(),
            sentences=sentences,
            cards=cards,
        )

    @property
    def printed(self) -> str:
        """The plan with the published margin."""
        return next(iter(self.sigmas))

    @property
    def planned(self) -> list[str]:
        """The plans of this run."""
        return [name for name in self.names if self.done.effort.whole or name not in self.spared]

    @property
    @override
    def left_out(self) -> str:
        return "" if self.done.effort.whole else self.only_whole

    @property
    @override
    def stages(self) -> Mapping[str, Stage]:
        calibration = {"calibration": Stage(self.calibrate, 0.2)}
        return {
            "plans": Stage(self.find_plans, 0.5),
            **(calibration if CALIBRATED in self.planned else {}),
            "evidence": Stage(self.done.gather_evidence, 0.2),
            "families": Stage(self.done.fly_families, 0.1),
            **self.more_stages(),
        }

    def calibrate(self, progress: Progress) -> None:
        """The margin for which fresh systems confirm the target, all limits counted jointly."""
        self.done.calibrate(self.margin_problem(), self.limits, progress)

    @override
    def results(self) -> Mapping[str, Any]:
        done = self.done
        found = {"plans": done.plans, "evidence": done.evidence, "calibration": done.calibration}
        return {**found, **self.more_results()}

    @override
    def verdict(self) -> Verdict:
        done, sentences, cards = self.done, list(self.sentences()), list(self.cards())
        missing = no_recommendation(done.plans, done.evidence, self.planned, sentences, cards)
        return missing or self.recommendation(sentences, cards)

    @override
    def tables(self) -> list[Table]:
        return [*self._plans(), optima_table(self.done.searches)] if self.done.plans else []

    @override
    def sections(self) -> Sequence[Section]:
        plans = self.done.plans
        texts = [Code(f"{name} as mathematics", one.problem_text) for name, one in plans.items()]
        return [
            Section("The system", [replace(self.schematic(), beside=texts)]),
            Section("The plans", self._plans()),
            *self.chapters(),
            Section("How wide a margin", list(self.margin())),
            Section("Local optima", [optima_table(self.done.searches)] if plans else []),
            Section("Certificate", [certificate_table(plans)] if plans else []),
        ]

    def _plans(self) -> list[Table]:
        """The plans side by side, and compared with published values."""
        done = self.done
        return [plans_table(done.plans, done.evidence, self.measures), self.published()] if done.plans else []

    def margin(self) -> Iterator[Block]:
        """The chapter on margins."""
        done = self.done
        calibrated = {CALIBRATED: done.calibration.sigmas} if done.calibration is not None else {}
        margins = dict(self.sigmas) | calibrated
        prices = price_table(done.plans, done.evidence, margins, self.printed, self.measures[self.printed])
        yield from margin_blocks(done.calibration, prices, self.who)

    @override
    def cut_short(self) -> Iterator[str]:
        for name, one in self.done.searches.items():
            if one.interrupted:
                yield f"Of the starts of the search for '{name}', {len(one.solutions)} are finished and kept."
