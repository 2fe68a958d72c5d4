"""What the studies of motion planning share: their stages, what they save, and the chapters that all of them have."""

import abc
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

from typing_extensions import override

import aleator as al
from aleator._core.progress import Progress
from aleator.reporting import Block, Card, Code, Schematic, Section, Table, Verdict, certificate_table
from aleator.studies._declared import Stage
from aleator.studies._designs import no_recommendation
from aleator.studies._motion.build import CALIBRATED, build_verdict, margin_blocks, price_table
from aleator.studies._motion.facts import optima_table, plans_table
from aleator.studies._motion.results import Effort, MotionResults
from aleator.studies._study import AbstractStudy


class AbstractMotionStudy(AbstractStudy):
    """A study that searches for plans of one motion, flies them on their families and reports on them."""

    names: ClassVar[tuple[str, ...]]
    """Its plans."""
    spared: ClassVar[tuple[str, ...]] = ()
    """Those of them that a quick run leaves out."""
    only_whole: ClassVar[str]
    """All that a quick run leaves out, in words."""
    sigmas: ClassVar[Mapping[str, float]]
    """The margins of its robust plans that were given; the first is the one that is printed."""
    limits: ClassVar[tuple[str, ...]]
    """The limits that hold with a margin, which is calibrated for all of them."""
    who: ClassVar[str]
    """What its systems are called."""
    measures: ClassVar[Mapping[str, str]]
    """What each plan minimises, with its unit."""
    unit: ClassVar[str]
    """The unit of what the printed plan minimises."""

    def __init__(self, effort: Effort):
        self.done = MotionResults(effort)

    @abc.abstractmethod
    def find_plans(self, progress: Progress) -> None:
        """Search for all plans."""

    @abc.abstractmethod
    def margin_problem(self) -> al.Problem:
        """The problem whose margin is calibrated, to be solved from the printed plan."""

    @abc.abstractmethod
    def sentences(self) -> Iterator[str]:
        """What the first screen says of the plans there are."""

    @abc.abstractmethod
    def cards(self) -> Iterator[Card]:
        """The numbers of the first screen, of the plans there are."""

    @abc.abstractmethod
    def published(self) -> Table:
        """Published and reference values beside computed ones; called once there is a plan."""

    @abc.abstractmethod
    def schematic(self) -> Schematic:
        """The system as a drawing."""

    @abc.abstractmethod
    def chapters(self) -> Sequence[Section]:
        """The figures; called with whatever there is."""

    def more_stages(self) -> Mapping[str, Stage]:
        """The stages after plans, evidence and families: by default none."""
        return {}

    def more_results(self) -> Mapping[str, Any]:
        """What these stages found that can be saved: by default nothing."""
        return {}

    def beside(self) -> str:
        """What else there is to say of the plan to build: by default nothing."""
        return ""

    def recommendation(self, sentences: Sequence[str], cards: Sequence[Card]) -> Verdict:
        """What to build; called once all plans and their evidence are there."""
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
        """The plan of the printed margin."""
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
        texts = [Code(f"{name} as mathematics", str(one.problem)) for name, one in plans.items()]
        return [
            Section("The system", [replace(self.schematic(), beside=texts)]),
            Section("The plans", self._plans()),
            *self.chapters(),
            Section("How wide a margin", list(self.margin())),
            Section("Local optima", [optima_table(self.done.searches)] if plans else []),
            Section("Certificate", [certificate_table(plans)] if plans else []),
        ]

    def _plans(self) -> list[Table]:
        """The plans side by side, and beside what is published."""
        done = self.done
        return [plans_table(done.plans, done.evidence, self.measures), self.published()] if done.plans else []

    def margin(self) -> Iterator[Block]:
        """The chapter about margins."""
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
