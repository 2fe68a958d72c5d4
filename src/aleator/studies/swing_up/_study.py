"""The study of the swing-up of a double pendulum."""

from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, final

from typing_extensions import override

import aleator as al
from aleator._core.border import Progress
from aleator.reporting import Card, Schematic, Section, Table, given
from aleator.studies._motion.build import CALIBRATED
from aleator.studies._motion.family import Family
from aleator.studies._motion.results import Effort
from aleator.studies._motion.study import AbstractMotionStudy
from aleator.studies._study import Stage
from aleator.studies.swing_up import MASS_2, TORQUE, _page, _run, _verdict
from aleator.studies.swing_up._facts import published_table
from aleator.studies.swing_up._run import ENERGY, EXPECTED, MEAN


@final
class SwingUp(AbstractMotionStudy):
    """The swing-ups of minimum energy for the mean pendulum and for all pendulums."""

    title = "Swing-up of a double pendulum: hybrid dynamics"
    subtitle = (
        f"Driven at the first joint alone, within ±{given(TORQUE)} N m; mass of the second link in kg: {MASS_2};"
        " dissertation, section 5.5.3"
    )
    glossary = _page.GLOSSARY
    full, quick = _run.FULL, _run.QUICK
    names = (MEAN, ENERGY, EXPECTED, CALIBRATED)
    spared = (ENERGY, CALIBRATED)
    only_whole = (
        "the calibration of the margin, the plan of minimum expected energy, finer steps, the effect of friction, and "
        "the motion of the systems drawn between instants"
    )
    sigmas: ClassVar = {EXPECTED: 1.0}
    limits = ("torque",)
    who = "pendulums"
    measures: ClassVar = {
        MEAN: "energy exchanged, J",
        EXPECTED: "energy of the expected torque, J",
        ENERGY: "expected energy, J",
        CALIBRATED: "energy of the expected torque, J",
    }
    unit = "J"

    def __init__(self, effort: Effort):
        super().__init__(effort)
        self.finer: dict[str, Family] = {}
        self.frictionless: dict[str, Family] = {}

    @property
    @override
    def problems(self) -> Mapping[str, al.Problem]:
        return _run.problems()

    @override
    def find_plans(self, progress: Progress) -> None:
        _run.search_plans(self.done, self.planned, progress)

    @override
    def margin_problem(self) -> al.Problem:
        return _run.margin_problem(self.done.plans[EXPECTED])

    @override
    def more_stages(self) -> Mapping[str, Stage]:
        return {"finer steps": Stage(self.refine, 0.1)} if self.done.effort.whole else {}

    def refine(self, progress: Progress) -> None:
        """The same pendulums once more with smaller steps, and once more without friction."""
        count = self.done.effort.family
        for i, (name, plan) in enumerate(self.done.plans.items()):
            progress(f"finer steps, {name}", i, len(self.done.plans))
            self.finer[name] = _run.flown_finer(name, plan, count)
            self.frictionless[name] = _run.flown_frictionless(name, plan, count)

    @override
    def published(self) -> Table:
        return published_table(self.done)

    @override
    def beside(self) -> str:
        return _verdict.left_below(self.done)

    @override
    def sentences(self) -> Iterator[str]:
        return _verdict.sentences(self.done, self.frictionless)

    @override
    def cards(self) -> Iterator[Card]:
        return _verdict.cards(self.done)

    @override
    def schematic(self) -> Schematic:
        return _page.schematic()

    @override
    def chapters(self) -> Sequence[Section]:
        families = self.done.families
        mean, robust = families.get(MEAN), families.get(EXPECTED)
        return [
            Section("The motion", list(_page.motion(families, self.names))),
            Section("The deterministic plan on the family", list(_page.histories(mean, "5.10", "5.11"))),
            Section("The robust plan", list(_page.histories(robust, "5.13", "5.14"))),
            Section("Accuracy of the steps", list(_page.finer_steps(families, self.finer))),
            Section("The effect of friction", list(_page.friction(families, self.frictionless))),
        ]
