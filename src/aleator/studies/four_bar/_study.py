"""The study of the four-bar linkage."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, final

from typing_extensions import override

import aleator as al
from aleator.reporting import Section, Table, Verdict, given
from aleator.studies._shared import collocated
from aleator.studies._study import AbstractStudy, Stage
from aleator.studies.four_bar import HEIGHT, STROKE, ZONE, _page, _run
from aleator.studies.four_bar._facts import counts_dataset, counts_table, designs_table
from aleator.studies.four_bar._run import MEAN, Effort, FourBarResults
from aleator.studies.four_bar._verdict import verdict


@final
class FourBarStudy(AbstractStudy):
    """Three designs of a straight-line linkage, their evidence, and the cost of a narrower zone."""

    title = "Four-bar linkage on a straight line: robust lengths and the cheapest tolerances"
    subtitle = (
        f"Hoeken's linkage: a stroke of {given(STROKE, 'mm')} at a height of {given(HEIGHT, 'mm')}, within "
        f"±{given(ZONE, 'mm')}; eleven uncertain numbers; inverse dynamics of a closed loop"
    )
    glossary = _page.GLOSSARY
    full, quick = _run.FULL, _run.QUICK

    def __init__(self, effort: Effort):
        self.found = FourBarResults(effort)

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
        if self.found.effort.front_points:
            return ""
        return "the mean linkage by direct collocation, and the cost of a narrower zone"

    @override
    def results(self) -> Mapping[str, Any]:
        found = self.found
        return {
            "designs": found.designs,
            "evidence": found.evidence,
            "counts": counts_dataset(found.counts) if found.counts else None,
            "front": found.front,
            "collocated": collocated(MEAN, found.second_way),
        }

    @override
    def verdict(self) -> Verdict:
        return verdict(self.found)

    @override
    def sections(self) -> Sequence[Section]:
        return _page.sections(self.found)

    @override
    def cut_short(self) -> Iterator[str]:
        front = self.found.front
        if front is not None and front.interrupted:
            done = len(front.values)
            yield f"Of the front {done} of {self.found.effort.front_points} points are finished and shown."

    @override
    def tables(self) -> list[Table]:
        found = self.found
        shown = [designs_table(found)] if found.designs else []
        return [*shown, counts_table(found)] if found.counts else shown
