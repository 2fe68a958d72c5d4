"""`aleator run STUDY` for three small studies, two of them those of the package at least effort.

`python interrupted_studies.py run STUDY --out FOLDER`.
"""

import signal

import aleator_command

# As a terminal starts it, wherever the tests are started from.
signal.signal(signal.SIGINT, signal.default_int_handler)
aleator_command.mind_signals()
print("begun", flush=True)

from collections.abc import Mapping  # noqa: E402
from pathlib import Path  # noqa: E402

import aleator as al  # noqa: E402
from aleator import cli  # noqa: E402
from aleator._core.progress import Progress  # noqa: E402
from aleator.report import PAGE, Table, report, save_study  # noqa: E402
from aleator.studies import STUDIES, AbstractStudy, Entry, _suspension_run  # noqa: E402
from aleator.studies import _pick_and_place_time_study as motion  # noqa: E402
from aleator.studies._suspension_study import SuspensionStudy  # noqa: E402
from tiny_models import Decay  # noqa: E402


class DecayStudy(AbstractStudy):
    """One design, its evidence and a front."""

    stages: Mapping[str, float] = {"design": 1.0, "evidence": 1.0, "front": 1.0}

    def __init__(self) -> None:
        self.found: dict[str, object] = {}

    def run(self, stage: str, progress: Progress) -> None:
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
            if front.interrupted:
                raise KeyboardInterrupt
            self.found[stage] = front

    def save(self, folder: Path) -> list[Path]:
        return list(save_study(folder, **self.found))

    def write_page(self, folder: Path) -> Path:
        return report(self.found["design"], self.found.get("evidence"), path=folder / PAGE)

    def tables(self) -> list[Table]:
        return [Table("Found", ["stage"], [[name] for name in self.found])] if self.found else []

    def headline(self) -> str:
        return "Done."


MADE = {
    "decay": lambda quick: DecayStudy(),
    "suspension": lambda quick: SuspensionStudy(_suspension_run.Effort(2, 500, 2_000)),
    "pick-and-place-time": lambda quick: motion.PickAndPlaceTime(motion.Effort(1, 500, 50, 2, 2_000)),
}


if __name__ == "__main__":
    for stage in ("calibration", "fronts over travel", "fronts over holding"):
        del _suspension_run.STAGES[stage]
    STUDIES["decay"] = Entry("A decay", "")
    cli.load = lambda name, *, quick: MADE[name](quick)
    aleator_command.main()
