"""What the studies of motion planning share: searches from several starts, evidence, families, files and the page."""

import abc
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, final

import aleator as al
from aleator._core.progress import Progress, silent
from aleator.report import (
    HOW_TO_READ,
    PAGE,
    Block,
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
from aleator.studies._motion_facts import optima_table, plans_table
from aleator.studies._study import AbstractStudy
from aleator.validation import finer_by

KEPT = 25


@final
@dataclass(frozen=True)
class Effort:
    """How much is computed.

    - `starts`: of the search for each plan;
    - `samples`: Monte Carlo samples of the evidence; `family`: systems of which every output is kept;
    - `front_points`: on a front; `calibration_samples`: of each trial of a margin.
    """

    starts: int
    samples: int = 20_000
    family: int = 2_000
    front_points: int = 7
    calibration_samples: int = 10_000


@final
@dataclass
class MotionResults:
    """Everything a study of motion has finished so far, by the names of its plans.

    - `searches`: every start of each plan's search; `plans`: the best of each;
    - `coarse`: the plans whose limits hold at the instants of the grid alone, as in the reference;
    - `evidence`: fresh systems counted; `families`: some of them whole, with every output.
    """

    effort: Effort
    searches: dict[str, al.Starts] = field(default_factory=dict)
    plans: dict[str, al.Solution] = field(default_factory=dict)
    coarse: dict[str, al.Solution] = field(default_factory=dict)
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
        for name, plan in self.plans.items():
            self.coarse[name] = al.solve(plan.problem, start=plan.decisions, between=1, throw=False)

    def gather_evidence(self, progress: Progress) -> None:
        """Count on fresh systems how often each plan breaks its limits."""
        for name, plan in self.plans.items():
            self.evidence[name] = al.validate(plan, self.effort.samples, seed=1, keep=KEPT, progress=progress)

    def fly_families(self, progress: Progress) -> None:
        """Fly each plan on its family and keep every output."""
        for i, (name, plan) in enumerate(self.plans.items()):
            progress(f"family, {name}", i, len(self.plans))
            between = finer_by(plan)
            self.families[name] = fly(plan.problem, plan.vector, self.effort.family, seed=2, between=between)


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
    measures: ClassVar[Mapping[str, str]]
    """What each plan minimises, with its unit."""
    glossary: ClassVar[Sequence[tuple[str, str]]] = ()

    def __init__(self, effort: Effort):
        self.done = MotionResults(effort)

    @abc.abstractmethod
    def find_plans(self, progress: Progress) -> None:
        """Search for all plans."""

    @abc.abstractmethod
    def more(self) -> Mapping[str, Stage]:
        """The stages after plans, evidence and families."""

    @abc.abstractmethod
    def more_results(self) -> Mapping[str, Any]:
        """What these stages found that can be saved."""

    @abc.abstractmethod
    def verdict(self) -> Verdict:
        """The first screen, as far as the study has come."""

    @abc.abstractmethod
    def published(self) -> Table:
        """Published and reference values beside computed ones; called once there is a plan."""

    @abc.abstractmethod
    def schematic(self) -> Schematic:
        """The system as a drawing."""

    @abc.abstractmethod
    def chapters(self) -> Sequence[Section]:
        """The figures; called with whatever there is."""

    def work(self) -> Mapping[str, Stage]:
        """All stages in order."""
        done, every = self.done, set(self.names)
        return {
            "plans": Stage(self.find_plans, 0.5, lambda: every <= set(done.plans) and not list(self._cut_short())),
            "evidence": Stage(done.gather_evidence, 0.2, lambda: every <= set(done.evidence)),
            "families": Stage(done.fly_families, 0.1, lambda: every <= set(done.families)),
            **self.more(),
        }

    @property
    def stages(self) -> Mapping[str, float]:
        """See `AbstractStudy.stages`."""
        return {name: stage.share for name, stage in self.work().items()}

    def run(self, stage: str, progress: Progress = silent) -> None:
        """See `AbstractStudy.run`."""
        self.work()[stage].work(progress)

    def save(self, folder: Path) -> list[Path]:
        """See `AbstractStudy.save`."""
        return list(save_study(folder, plans=self.done.plans, evidence=self.done.evidence, **self.more_results()))

    def write_page(self, folder: Path) -> Path:
        """See `AbstractStudy.write_page`."""
        return write_page(self.page(), folder / PAGE)

    def tables(self) -> list[Table]:
        """See `AbstractStudy.tables`."""
        if not self.done.plans:
            return []
        return [self.plans_table(), self.published(), optima_table(self.done.searches)]

    def headline(self) -> str:
        """See `AbstractStudy.headline`."""
        said = self.verdict()
        return f"{said.word}: {said.headline}"

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

    def _unfinished(self) -> list[Block]:
        missing = [name for name, stage in self.work().items() if not stage.reached()]
        if not missing:
            return []
        said = f"Not reached, or not to its end: {words(missing)}."
        return [Text([said, *self._cut_short()], lead="The study was stopped early.")]

    def _cut_short(self) -> Iterator[str]:
        """What is there of the searches that were interrupted."""
        for name, one in self.done.searches.items():
            if one.interrupted:
                yield f"Of the starts of the search for '{name}', {len(one.solutions)} are finished and kept."
