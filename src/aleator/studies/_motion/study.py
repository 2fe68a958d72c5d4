"""What the studies of motion planning share: their stages, files and the page."""

import abc
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from typing_extensions import override

import aleator as al
from aleator._core.progress import Progress, silent
from aleator.reporting import (
    HOW_TO_READ,
    PAGE,
    Block,
    Card,
    Code,
    Page,
    Schematic,
    Section,
    Table,
    Text,
    Verdict,
    certificate_table,
    footer,
    save_study,
    words,
    write_page,
)
from aleator.studies._motion.build import CALIBRATED, margin_blocks, price_table
from aleator.studies._motion.facts import no_recommendation, optima_table, plans_table
from aleator.studies._motion.results import Effort, MotionResults
from aleator.studies._study import AbstractStudy


class Stage(NamedTuple):
    """A part of a study, roughly which share of the whole time it takes, and whether it has been reached."""

    work: Callable[[Progress], None]
    share: float
    reached: Callable[[], bool]


class AbstractMotionStudy(AbstractStudy):
    """A study that searches for plans of one motion, flies them on their families and reports on them."""

    title: ClassVar[str]
    subtitle: ClassVar[str]
    names: ClassVar[tuple[str, ...]]
    """Its plans."""
    spared: ClassVar[tuple[str, ...]] = ()
    """Those of them that a quick run leaves out."""
    left_out: ClassVar[str]
    """All that a quick run leaves out, in words."""
    sigmas: ClassVar[Mapping[str, float]]
    """The margins of its robust plans that were given; the first is the one that is printed."""
    limits: ClassVar[tuple[str, ...]]
    """The limits that hold with a margin, which is calibrated for all of them."""
    who: ClassVar[str]
    """What its systems are called."""
    measures: ClassVar[Mapping[str, str]]
    """What each plan minimises, with its unit."""
    glossary: ClassVar[Sequence[tuple[str, str]]] = ()

    def __init__(self, effort: Effort):
        self.done = MotionResults(effort)

    @abc.abstractmethod
    def find_plans(self, progress: Progress) -> None:
        """Search for all plans."""

    @abc.abstractmethod
    def margin_problem(self) -> al.Problem:
        """The problem whose margin is calibrated, to be solved from the printed plan."""

    @abc.abstractmethod
    def more(self) -> Mapping[str, Stage]:
        """The stages after plans, evidence and families."""

    @abc.abstractmethod
    def more_results(self) -> Mapping[str, Any]:
        """What these stages found that can be saved."""

    @abc.abstractmethod
    def sentences(self) -> Iterator[str]:
        """What the first screen says of the plans there are."""

    @abc.abstractmethod
    def cards(self) -> Iterator[Card]:
        """The numbers of the first screen, of the plans there are."""

    @abc.abstractmethod
    def recommendation(self, sentences: Sequence[str], cards: Sequence[Card]) -> Verdict:
        """What to build; called once all plans and their evidence are there."""

    @abc.abstractmethod
    def published(self) -> Table:
        """Published and reference values beside computed ones; called once there is a plan."""

    @abc.abstractmethod
    def schematic(self) -> Schematic:
        """The system as a drawing."""

    @abc.abstractmethod
    def chapters(self) -> Sequence[Section]:
        """The figures; called with whatever there is."""

    def verdict(self) -> Verdict:
        """The first screen, as far as the study has come."""
        done, sentences, cards = self.done, list(self.sentences()), list(self.cards())
        missing = no_recommendation(done.plans, done.evidence, self.planned, sentences, cards)
        return missing or self.recommendation(sentences, cards)

    def work(self) -> Mapping[str, Stage]:
        """All stages in order."""
        done, every = self.done, set(self.planned)
        calibration = {"calibration": Stage(self.calibrate, 0.2, lambda: CALIBRATED in done.plans)}
        return {
            "plans": Stage(
                self.find_plans,
                0.5,
                lambda: every - {CALIBRATED} <= set(done.plans) and not list(self._cut_short()),
            ),
            **(calibration if CALIBRATED in every else {}),
            "evidence": Stage(done.gather_evidence, 0.2, lambda: every <= set(done.evidence)),
            "families": Stage(done.fly_families, 0.1, lambda: every <= set(done.families)),
            **self.more(),
        }

    @property
    def planned(self) -> list[str]:
        """The plans of this run."""
        return [name for name in self.names if self.done.effort.whole or name not in self.spared]

    def calibrate(self, progress: Progress) -> None:
        """The margin for which fresh systems confirm the target, all limits counted jointly."""
        self.done.calibrate(self.margin_problem(), self.limits, progress)

    @property
    @override
    def stages(self) -> Mapping[str, float]:
        return {name: stage.share for name, stage in self.work().items()}

    @override
    def run(self, stage: str, progress: Progress = silent) -> None:
        self.work()[stage].work(progress)

    @override
    def save(self, folder: Path) -> list[Path]:
        done = self.done
        found = {"plans": done.plans, "evidence": done.evidence, "calibration": done.calibration}
        return list(save_study(folder, **found, **self.more_results()))

    @override
    def write_page(self, folder: Path) -> Path:
        return write_page(self.page(), folder / PAGE)

    @override
    def tables(self) -> list[Table]:
        if not self.done.plans:
            return []
        return [self.plans_table(), self.published(), optima_table(self.done.searches)]

    @override
    def headline(self) -> str:
        said = self.verdict()
        return " ".join([f"{said.word}: {said.headline}", *self._quick()])

    def _quick(self) -> list[str]:
        return [] if self.done.effort.whole else [f"A quick run: left out are {self.left_out}."]

    def plans_table(self) -> Table:
        """The plans side by side."""
        return plans_table(self.done.plans, self.done.evidence, self.measures)

    def page(self) -> Page:
        """The page as data; parts that were not reached are left out and named."""
        plans = self.done.plans
        tables: list[Block] = [self.plans_table(), self.published()] if plans else []
        texts = [Code(f"{name} as mathematics", str(one.problem)) for name, one in plans.items()]
        sections = [
            Section("The system", [replace(self.schematic(), beside=texts)]),
            Section("The plans", [*self._unfinished(), *tables]),
            *self.chapters(),
            Section("How wide a margin", list(self.margin())),
            Section("Local optima", [optima_table(self.done.searches)] if plans else []),
            Section("Certificate", [certificate_table(plans)] if plans else []),
            Section("How to read this", [Text(HOW_TO_READ), Table("Glossary", ["Term", "Meaning"], self.glossary)]),
        ]
        return Page(
            title=self.title,
            subtitle=self.subtitle,
            verdict=self.verdict(),
            sections=[one for one in sections if one.blocks],
            footer=footer(),
        )

    def margin(self) -> Iterator[Block]:
        """The chapter about margins."""
        done, printed = self.done, next(iter(self.sigmas))
        calibrated = {CALIBRATED: done.calibration.sigmas} if done.calibration is not None else {}
        margins = dict(self.sigmas) | calibrated
        prices = price_table(done.plans, done.evidence, margins, printed, self.measures[printed])
        yield from margin_blocks(done.calibration, prices, self.who)

    def _unfinished(self) -> list[Block]:
        missing = [name for name, stage in self.work().items() if not stage.reached()]
        quick: list[Block] = [Text([sentence]) for sentence in self._quick()]
        if not missing:
            return quick
        said = f"Not reached, or not to its end: {words(missing)}."
        return [Text([said, *self._cut_short()], lead="The study was stopped early."), *quick]

    def _cut_short(self) -> Iterator[str]:
        """What is there of the searches that were interrupted."""
        for name, one in self.done.searches.items():
            if one.interrupted:
                yield f"Of the starts of the search for '{name}', {len(one.solutions)} are finished and kept."
