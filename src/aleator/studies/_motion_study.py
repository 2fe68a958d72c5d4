"""What the studies of motion planning share: searches from several starts, evidence, families, files and the page."""

import abc
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, final

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
from aleator.studies._family import Family, fly
from aleator.studies._motion_build import CALIBRATED, TARGET, margin_blocks, price_table
from aleator.studies._motion_facts import no_recommendation, optima_table, plans_table
from aleator.studies._study import AbstractStudy
from aleator.validation import finer_by

KEPT = 25
PRECISION = 0.2
"""How closely below its aim a margin is sought: half a per cent of an objective is at stake between a = 1 and the worst
case, and each trial is a search with its count."""


@final
@dataclass(frozen=True)
class Effort:
    """How much is computed.

    - `starts`: of the search for each plan;
    - `samples`: Monte Carlo samples of the evidence; `family`: systems of which every output is kept;
    - `front_points`: on a front; `calibration_samples`: of each trial of a margin;
    - `whole`: whether what a first look can do without is computed too; what that is the study says (`left_out`).
    """

    starts: int
    samples: int = 20_000
    family: int = 2_000
    front_points: int = 7
    calibration_samples: int = 10_000
    whole: bool = True


@final
@dataclass
class MotionResults:
    """Everything a study of motion has finished so far, by the names of its plans.

    - `searches`: every start of each plan's search; `plans`: the best of each;
    - `coarse`: the plans whose limits hold at the instants of the grid alone, as in the reference;
    - `calibration`: the margin at which as few systems as asked break a limit; its plan is one of the plans;
    - `evidence`: fresh systems counted; `families`: some of them whole, with every output.
    """

    effort: Effort
    searches: dict[str, al.Starts] = field(default_factory=dict)
    plans: dict[str, al.Solution] = field(default_factory=dict)
    coarse: dict[str, al.Solution] = field(default_factory=dict)
    calibration: al.Calibration | None = None
    evidence: dict[str, al.Evidence] = field(default_factory=dict)
    families: dict[str, Family] = field(default_factory=dict)

    def search(
        self, name: str, problem: al.Problem, starts: int | Sequence[Mapping[str, Any]], progress: Progress
    ) -> al.Solution:
        """Solve for a plan from several starts and keep the best, of a search that Ctrl-C cut short, too."""
        found = al.multistart(problem, starts, progress=lambda _, done, total: progress(name, done, total))
        self.searches[name] = found
        if found.best.ok or not found.interrupted:
            self.plans[name] = found.best
        if found.interrupted:
            raise KeyboardInterrupt
        return found.best

    def solve_at_instants(self) -> None:
        """The same plans with limits at the instants of the grid alone, to compare with the reference."""
        for name, plan in self.plans.items() if self.effort.whole else ():
            self.coarse[name] = al.solve(plan.problem, start=plan.decisions, between=1, throw=False)

    def calibrate(self, problem: al.Problem, limits: Sequence[str], progress: Progress) -> None:
        """Find the margin at which no more systems than `TARGET` break a limit, and keep its plan and its evidence."""
        samples = self.effort.calibration_samples
        found = al.calibrate(problem, limits, TARGET, samples=samples, precision=PRECISION, progress=progress)
        self.calibration = found
        if found.interrupted:
            raise KeyboardInterrupt
        self.plans[CALIBRATED] = found.solution
        if found.evidence is not None:
            self.evidence[CALIBRATED] = found.evidence

    def gather_evidence(self, progress: Progress) -> None:
        """Count on fresh systems how often each plan breaks its limits; of a calibrated one that is known."""
        for name, plan in self.plans.items():
            if name not in self.evidence:
                self.evidence[name] = al.validate(plan, self.effort.samples, seed=1, keep=KEPT, progress=progress)

    def fly_families(self, progress: Progress) -> None:
        """Fly each plan on its family and keep every output."""
        for i, (name, plan) in enumerate(self.plans.items()):
            progress(f"family, {name}", i, len(self.plans))
            self.families[name] = self.flown(plan, plan.problem, seed=2)

    def flown(self, plan: al.Solution, problem: al.Problem, *, seed: int) -> Family:
        """A plan on the systems of a problem; its extremes between the instants too, but for a quick run."""
        between = finer_by(plan) if self.effort.whole else 1
        return fly(problem, plan.vector, self.effort.family, seed=seed, between=between)


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
