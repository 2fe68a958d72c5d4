"""`aleator run decay`: a small study of three stages.

`python interrupted_studies.py run STUDY --out FOLDER`.
"""

import signal

import aleator_command

# As a terminal starts it, wherever the tests are started from.
signal.signal(signal.SIGINT, signal.default_int_handler)
aleator_command.mind_signals()
print("begun", flush=True)

from collections.abc import Mapping, Sequence  # noqa: E402
from functools import partial  # noqa: E402
from pathlib import Path  # noqa: E402

import aleator as al  # noqa: E402
from aleator import studies  # noqa: E402
from aleator._core.progress import Progress  # noqa: E402
from aleator.reporting import PAGE, Section, Table, Verdict, report  # noqa: E402
from aleator.studies import STUDIES, AbstractStudy, Entry, Stage, stop_if_interrupted  # noqa: E402
from zoo import Decay  # noqa: E402


class DecayStudy(AbstractStudy):
    """One design, its evidence and a front."""

    def __init__(self) -> None:
        self.found: dict[str, object] = {}

    @property
    def stages(self) -> Mapping[str, Stage]:
        return {name: Stage(partial(self.work, name), 1.0) for name in ("design", "evidence", "front")}

    def work(self, stage: str, progress: Progress) -> None:
        limit = al.terminal("x").at_most(0.4, sigmas=1.0)
        problem = al.Problem(
            Decay(rate=al.Uniform(al.Decision(1.2, 0.5, 2.0), half_width=0.1)),
            grid=al.Grid(1.0, steps=200),
            minimize=al.value("rate.mean"),
            subject_to=[limit],
        )
        if stage == "design":
            self.found[stage] = al.solve(problem)
        elif stage == "evidence":
            self.found[stage] = al.validate(self.found["design"], 20_000, progress=progress)
        else:
            front = al.pareto(problem, "x", [0.4, 0.35, 0.3], progress=progress)
            stop_if_interrupted(front)
            self.found[stage] = front

    def results(self) -> Mapping[str, object]:
        return self.found

    def write_page(self, folder: Path) -> Path:
        return report(self.found["design"], self.found.get("evidence"), path=folder / PAGE)

    def tables(self) -> list[Table]:
        return [Table("Found", ["stage"], [[name] for name in self.found])] if self.found else []

    def sections(self) -> Sequence[Section]:
        return []

    def verdict(self) -> Verdict:
        return Verdict("good", "Done", "to its end.")


if __name__ == "__main__":
    STUDIES["decay"] = Entry("A decay", "")
    studies.load = lambda name, *, quick: DecayStudy()
    aleator_command.main()
