"""The suspension study as the command line runs it."""

from collections.abc import Mapping
from pathlib import Path
from typing import final

from aleator._core.progress import Progress
from aleator.reporting import PAGE, Table, save_study
from aleator.studies._study import AbstractStudy
from aleator.studies._suspension_built import built_table
from aleator.studies._suspension_facts import designs_table
from aleator.studies._suspension_page import write_page
from aleator.studies._suspension_published import published_table
from aleator.studies._suspension_run import QUICK, Effort, SuspensionResults, run_stage, stages_of
from aleator.studies._suspension_verdict import verdict


@final
class SuspensionStudy(AbstractStudy):
    """Three designs, their evidence, calibration and fronts."""

    def __init__(self, effort: Effort):
        self._results = SuspensionResults(effort)

    @property
    def stages(self) -> Mapping[str, float]:
        """See `AbstractStudy.stages`."""
        return {name: stage.share for name, stage in stages_of(self._results.effort).items()}

    def run(self, stage: str, progress: Progress) -> None:
        """See `AbstractStudy.run`."""
        run_stage(stage, self._results, progress)

    def save(self, folder: Path) -> list[Path]:
        """See `AbstractStudy.save`."""
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

    def write_page(self, folder: Path) -> Path:
        """See `AbstractStudy.write_page`."""
        return write_page(self._results, folder / PAGE)

    def tables(self) -> list[Table]:
        """See `AbstractStudy.tables`."""
        done = self._results
        shown = [designs_table(done)] if done.designs else []
        shown += [built_table(done)] if done.built else []
        return [*shown, published_table(done)] if done.designs else shown

    def headline(self) -> str:
        """See `AbstractStudy.headline`."""
        said = verdict(self._results)
        return f"{said.word}: {said.headline}"


def make(quick: bool) -> SuspensionStudy:
    """The study, at full or at quick effort."""
    return SuspensionStudy(QUICK if quick else Effort())
