"""The suspension study."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, final

from typing_extensions import override

import aleator as al
from aleator.reporting import Section, Table, Verdict
from aleator.studies._shared import collocated
from aleator.studies._study import AbstractStudy, Stage
from aleator.studies.suspension import _page, _run
from aleator.studies.suspension._built import built_table
from aleator.studies.suspension._facts import designs_table
from aleator.studies.suspension._published import published_table
from aleator.studies.suspension._run import HOLDING, RIDE, TRAVEL, Effort, SuspensionResults
from aleator.studies.suspension._verdict import verdict


@final
class SuspensionStudy(AbstractStudy):
    """Three designs, their evidence, calibration and fronts."""

    title = "Suspension of a quarter car: robust design and apportioned spreads"
    subtitle = (
        f"Travel within ±{TRAVEL:g} m, holding at most {HOLDING:g} m, ride at most {RIDE:g} m²/s³ (aOpt); "
        "five uncertain parameters; dissertation, sections 6.4 and 7.4"
    )
    glossary = _page.GLOSSARY
    full, quick = _run.FULL, _run.QUICK

    def __init__(self, effort: Effort):
        self.found = SuspensionResults(effort)

    @property
    @override
    def problems(self) -> Mapping[str, al.Problem]:
        return _run.problems()

    @property
    @override
    def stages(self) -> Mapping[str, Stage]:
        return _run.stages(self.found)

    @property
    @override
    def left_out(self) -> str:
        if self.found.effort.calibration_samples:
            return ""
        return "the margins to build with, and dOpt by direct collocation"

    @override
    def results(self) -> Mapping[str, Any]:
        found = self.found
        return {
            "designs": found.designs,
            "evidence": found.evidence,
            "built": {name: one.solution for name, one in found.built.items()},
            "built_evidence": {name: one.evidence for name, one in found.built.items()},
            "margins": found.built,
            "narrow": found.narrow,
            "narrow_evidence": found.narrow_evidence,
            "calibration": found.calibration,
            "travel_fronts": found.travel_fronts,
            "holding_fronts": found.holding_fronts,
            "boxes": found.boxes,
            "collocated": collocated("dOpt", found.second_way),
        }

    @override
    def verdict(self) -> Verdict:
        return verdict(self.found)

    @override
    def sections(self) -> Sequence[Section]:
        return _page.sections(self.found)

    @override
    def cut_short(self) -> Iterator[str]:
        return _page.cut_short(self.found)

    @override
    def tables(self) -> list[Table]:
        found = self.found
        shown = [designs_table(found)] if found.designs else []
        shown += [built_table(found)] if found.built else []
        return [*shown, published_table(found)] if found.designs else shown
