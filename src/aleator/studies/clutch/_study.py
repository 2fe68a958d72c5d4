"""The clutch study as the command line runs it."""

from collections.abc import Mapping
from pathlib import Path
from typing import final

from typing_extensions import override

from aleator._core.progress import Progress
from aleator.reporting import PAGE, Table, save_study
from aleator.studies._study import AbstractStudy
from aleator.studies.clutch._facts import (
    allocation_table,
    analysis_table,
    contributions_table,
    counts_table,
    methods_table,
)
from aleator.studies.clutch._page import write_page
from aleator.studies.clutch._run import QUICK, STAGES, ClutchResults, Effort, run_stage
from aleator.studies.clutch._store import analysis_dataset, counts_dataset, methods_dataset
from aleator.studies.clutch._verdict import verdict


@final
class ClutchStudy(AbstractStudy):
    """Table 7.2, the tolerance analysis and the allocation of the one-way clutch."""

    def __init__(self, effort: Effort):
        self._results = ClutchResults(effort)

    @property
    @override
    def stages(self) -> Mapping[str, float]:
        return {name: stage.share for name, stage in STAGES.items()}

    @override
    def run(self, stage: str, progress: Progress) -> None:
        run_stage(stage, self._results, progress)

    @override
    def save(self, folder: Path) -> list[Path]:
        done = self._results
        paths = save_study(
            folder,
            methods=methods_dataset(done.methods) if done.methods else None,
            analyses={name: analysis_dataset(one) for name, one in done.analyses.items()},
            counts=counts_dataset(done.counts) if done.counts else None,
            allocation=done.allocation,
            evidence=done.evidence,
            front=done.front,
        )
        return list(paths)

    @override
    def write_page(self, folder: Path) -> Path:
        return write_page(self._results, folder / PAGE)

    @override
    def tables(self) -> list[Table]:
        done = self._results
        shown = [methods_table(done)] if done.methods else []
        shown += [contributions_table(done), analysis_table(done)] if done.analyses else []
        shown += [allocation_table(done)] if done.allocation is not None else []
        return [*shown, counts_table(done)] if done.counts else shown

    @override
    def headline(self) -> str:
        said = verdict(self._results)
        return f"{said.word}: {said.headline}"


def make(quick: bool) -> ClutchStudy:
    """The study, at full or at quick effort."""
    return ClutchStudy(QUICK if quick else Effort())
