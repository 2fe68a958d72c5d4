"""The suspension study as the command line runs it."""

from collections.abc import Mapping
from pathlib import Path
from typing import final

from typing_extensions import override

from aleator._core.progress import Progress
from aleator.reporting import PAGE, Table, save_study
from aleator.studies._study import AbstractStudy
from aleator.studies.suspension._built import built_table
from aleator.studies.suspension._facts import designs_table
from aleator.studies.suspension._page import write_page
from aleator.studies.suspension._published import published_table
from aleator.studies.suspension._run import QUICK, Effort, SuspensionResults, run_stage, stages_of
from aleator.studies.suspension._verdict import verdict


@final
class SuspensionStudy(AbstractStudy):
    """Three designs, their evidence, calibration and fronts."""

    def __init__(self, effort: Effort):
        self._results = SuspensionResults(effort)

    @property
    @override
    def stages(self) -> Mapping[str, float]:
        return {name: stage.share for name, stage in stages_of(self._results.effort).items()}

    @override
    def run(self, stage: str, progress: Progress) -> None:
        run_stage(stage, self._results, progress)

    @override
    def save(self, folder: Path) -> list[Path]:
        done = self._results
        paths = save_study(
            folder,
            designs=done.designs,
            evidence=done.evidence,
            built={name: one.solution for name, one in done.built.items()},
            built_evidence={name: one.evidence for name, one in done.built.items() if one.evidence is not None},
            margins=done.built,
            narrow=done.narrow,
            narrow_evidence=done.narrow_evidence,
            calibration=done.calibration,
            travel_fronts=done.travel_fronts,
            holding_fronts=done.holding_fronts,
            boxes=done.boxes,
        )
        return list(paths)

    @override
    def write_page(self, folder: Path) -> Path:
        return write_page(self._results, folder / PAGE)

    @override
    def tables(self) -> list[Table]:
        done = self._results
        shown = [designs_table(done)] if done.designs else []
        shown += [built_table(done)] if done.built else []
        return [*shown, published_table(done)] if done.designs else shown

    @override
    def headline(self) -> str:
        said = verdict(self._results)
        return f"{said.word}: {said.headline}"


def make(quick: bool) -> SuspensionStudy:
    """The study, at full or at quick effort."""
    return SuspensionStudy(QUICK if quick else Effort())
