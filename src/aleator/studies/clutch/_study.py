"""The clutch study."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, final

from typing_extensions import override

import aleator as al
from aleator.reporting import Section, Table, Verdict
from aleator.studies._study import AbstractStudy, Stage
from aleator.studies.clutch import _page, _run, allocation_problem
from aleator.studies.clutch._facts import (
    allocation_table,
    analysis_table,
    contributions_table,
    counts_table,
    methods_table,
)
from aleator.studies.clutch._run import ClutchResults, Effort
from aleator.studies.clutch._store import analysis_dataset, counts_dataset, methods_dataset
from aleator.studies.clutch._verdict import verdict


@final
class ClutchStudy(AbstractStudy):
    """Table 7.2, the tolerance analysis and the allocation of the one-way clutch."""

    title = "One-way clutch: tolerance analysis and allocation"
    subtitle = "Pressure angle of a roller clutch from its vector loop; dissertation, section 7.2"
    glossary = _page.GLOSSARY
    full, quick = _run.FULL, _run.QUICK

    def __init__(self, effort: Effort):
        self.found = ClutchResults(effort)

    @property
    @override
    def problems(self) -> Mapping[str, al.Problem]:
        return {"allocation": allocation_problem()}

    @property
    @override
    def stages(self) -> Mapping[str, Stage]:
        return _run.stages(self.found)

    @override
    def results(self) -> Mapping[str, Any]:
        found = self.found
        return {
            "methods": methods_dataset(found.methods) if found.methods else None,
            "analyses": {name: analysis_dataset(one) for name, one in found.analyses.items()},
            "counts": counts_dataset(found.counts) if found.counts else None,
            "allocation": found.allocation,
            "evidence": found.evidence,
            "front": found.front,
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
        shown = [methods_table(found)] if found.methods else []
        shown += [contributions_table(found), analysis_table(found)] if found.analyses else []
        shown += [allocation_table(found)] if found.allocation is not None else []
        return [*shown, counts_table(found)] if found.counts else shown
