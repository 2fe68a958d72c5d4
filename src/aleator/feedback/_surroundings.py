"""Feedback and white noise in phases: plans and covariances that go on from one phase to the next."""

from dataclasses import replace
from typing import Any, NamedTuple, final

import equinox as eqx
from typing_extensions import override

from aleator.dynamics import (
    AbstractExtended,
    AbstractSurroundings,
    Inputs,
    LinkedSystems,
    Phases,
    Simulation,
    System,
    Wires,
    placed,
)
from aleator.feedback._closed_loop import OPEN, ClosedLoop, Feedback, Means, closed_loop
from aleator.feedback._noisy import Noisy, is_noisy, parted, refuse_driven_events
from aleator.trajectories import WhiteNoise


class _Phase(NamedTuple):
    """What is put around the system of a phase.

    - `until`: the event that ends it; `feedback`: by the first phase that has it, None if no phase has any; `of`, `to`:
      what it measures and commands.
    """

    name: str
    until: str | None
    feedback: str | None = None
    of: tuple[str, ...] = ()
    to: tuple[str, ...] = ()


@final
class Surroundings(AbstractSurroundings):
    """The feedback and the white noise of phases.

    - `feedback`: by the first phase of each: if any has feedback, the plan goes on in all of them; `inputs`: those that
      are white noise; `phases`: what is put around each; `is_noisy`: whether all of them carry a covariance; `plan`:
      what loops know of the means, None until they are realised.
    """

    feedback: dict[str, Feedback]
    inputs: dict[str, WhiteNoise]
    phases: tuple[_Phase, ...] = eqx.field(static=True)
    is_noisy: bool = eqx.field(static=True)
    plan: Means | None = None

    @override
    def with_plan(self, means: Any, inputs: Inputs, uncertain: tuple[str, ...]) -> "Surroundings":
        return replace(self, plan=Means(means, inputs, uncertain))

    @override
    def around(self, system: System, wires: Wires) -> System:
        phase, plan = next(one for one in self.phases if one.name == wires.phase), self.plan
        if phase.feedback is not None:
            feedback, taken = self.feedback[phase.feedback], tuple(key for key, _ in wires.inputs)
            system = ClosedLoop(own=system, feedback=feedback, taken=taken, of=phase.of, to=phase.to)
        if self.is_noisy:
            white = {key: self.inputs[wire] for key, wire in wires.inputs if wire in self.inputs}
            taken = tuple(key for key, _ in wires.inputs if key not in white)
            system = Noisy(own=system, inputs=white, taken=taken, until=phase.until)
        if plan is None or not isinstance(system, AbstractExtended):
            return system
        inputs = {key: plan.inputs[wire] for key, wire in wires.inputs if wire in plan.inputs}
        uncertain = tuple(key for key, wire in wires.inputs if wire in plan.uncertain)
        return system.with_plan(plan.system[wires.system], inputs, uncertain)


def surrounded(simulation: Simulation, phases: Phases) -> Simulation:
    """The simulation of phases with the feedback and the white noise of each. Raises `ProblemError` as these do."""
    feedback, parts, are_noisy = dict[str, Feedback](), list[_Phase](), list[bool]()
    has_plan = any(phase.feedback is not None for phase in phases.phases.values())
    for name, phase in phases.phases.items():
        system, part = phase.system, _Phase(name, phase.grid.until)
        if has_plan:
            own = OPEN if phase.feedback is None else phase.feedback
            system = loop = closed_loop(phase.system, phase.inputs, own, phase.grid)
            part = part._replace(feedback=placed(feedback, name, own), of=loop.of, to=loop.to)
        parts.append(part)
        are_noisy.append(is_noisy(system, phase.inputs))
    if not (has_plan or any(are_noisy)):
        return simulation
    for phase in phases.phases.values() if any(are_noisy) else ():
        refuse_driven_events(phase.system, phase.grid)
    white, others = parted(simulation.inputs)
    around = Surroundings(feedback, white, tuple(parts), any(are_noisy))
    assert isinstance(simulation.system, LinkedSystems)
    return replace(simulation, system=replace(simulation.system, surroundings=around), inputs=others)
