"""Phases of one motion: systems one after the other, each from the states that the one before it ends with.

Names within a phase are preceded by its own: the output `m` of the phase `ascent` is `ascent.m`. So histories,
functionals and reports need to know no more of phases than which instants are a name's.
"""

import abc
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from types import MethodType
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Scalar
from aleator._core.border import meant, one_of, refusal, traceable
from aleator._core.errors import ProblemError
from aleator._core.functions import returned
from aleator._core.leaves import Module, transparent
from aleator.dynamics._grid import AbstractGrid, Grid, Inputs
from aleator.dynamics._record import STATES, Asked, Integrand, Occurrence, Record
from aleator.dynamics._system import AbstractSystem, System

Link = Callable[..., Any]


@final
class Phase:
    """One phase of a motion: what a `Problem` takes, without an objective. It begins where the one before it ends.

    - `system`: its physics; `grid`: its instants, from zero, or until an event; `inputs`: a signal for each input;
    - `subject_to`: constraints, whose functionals are those of this phase; `feedback`: an `al.Feedback`.

    Raises `ProblemError` for anything but a `System`, a `Grid` and signals by name.
    """

    def __init__(
        self,
        system: System,
        grid: Grid,
        inputs: Mapping[str, Any] | None = None,
        subject_to: Iterable[Any] = (),
        feedback: Any = None,
    ):
        self.system = one_of("Phase: system", system, System)
        self.grid = one_of("Phase: grid", grid, Grid, "al.Grid(10.0, 40)")
        if grid.periodic:
            raise ProblemError(
                "Phase: a phase begins where the one before it ends, so that it does not repeat: expected a grid "
                "without periodic=True. Let one system with events repeat instead."
            )
        if not isinstance(inputs, Mapping | None):
            raise refusal("Phase: inputs", "signals by name, such as {'thrust': ...}", inputs)
        if not isinstance(subject_to, Iterable) or isinstance(subject_to, str):
            raise refusal("Phase: subject_to", "constraints, such as [al.path('h').mean <= 1.0]", subject_to)
        if not isinstance(feedback, Module | None):
            raise refusal("Phase: feedback", "an al.Feedback, such as al.Feedback(gains=[4.0, 2.0])", feedback)
        self.inputs, self.subject_to, self.feedback = dict(inputs or {}), tuple(subject_to), feedback


@final
class Phases:
    """Phases by name, in order: a system of a `Problem`, or of `simulate`, that has grids and inputs of its own.

        al.Phases(
            ascent=al.Phase(stage_1, al.Grid(until="burnout", at_most=200.0, steps=40)),
            coast=al.Phase(stage_2, al.Grid(al.Decision(20.0, 0.0, 60.0), 10)),
            link={"coast": lambda self, t, z: {"m": z.m - self.dry}},
        )

    In each realisation a phase begins with the states of the same names that the one before it ends with, but for those
    that `link` gives, by the name of the phase that begins: a function of the system, the time and the states that end,
    as the `jump` of an `Event`. Its `initial` counts in the first phase alone. The time `t` of a phase is that of its
    own grid, from zero: what has to go on counting is a state. Durations are numbers, decisions, or end by an event.

    A system, or a signal, that stands in several phases is one, with the same numbers in all of them.

    Raises `ProblemError` for what is no `Phase`, and for a link to none. That each state of a phase is given by a link
    or the phase before is checked where the problem is declared.
    """

    def __init__(self, *, link: Mapping[str, Link] | None = None, **phases: Phase):
        if not isinstance(link, Mapping | None):
            raise refusal("Phases: link", "functions by the phase that begins, such as {'coast': ...}", link)
        if not phases:
            raise ProblemError("Phases: expected phases by name, such as ascent=al.Phase(system, grid); received none.")
        for name, phase in phases.items():
            one_of(f"Phases: {name}", phase, Phase, "al.Phase(system, grid)")
        later = list(phases)[1:]
        for name, function in (link or {}).items():
            if name not in later:
                raise ProblemError(
                    f"Phases: link: expected the name of a phase that begins after another, one of {later}; received "
                    f"{name!r}.{meant(name, later)}"
                )
            if not callable(function):
                raise refusal(f"Phases: link['{name}']", "a function such as lambda self, t, z: {'m': z.m}", function)
        self.phases, self.link = phases, dict(link or {})

    def parts(self) -> "tuple[LinkedSystems, LinkedGrid, Inputs]":
        """System, grid and inputs of a simulation."""
        systems, inputs, wiring = dict[str, System](), Inputs(), []
        for name, phase in self.phases.items():
            own = placed(systems, name, phase.system)
            wires = ((key, placed(inputs, f"{name}.{key}", signal)) for key, signal in phase.inputs.items())
            wiring.append(Wires(name, own, tuple(wires)))
        grids = {name: phase.grid for name, phase in self.phases.items()}
        return LinkedSystems(systems, tuple(wiring), (*self.link.items(),)), LinkedGrid(grids, grids), inputs


def placed(known: dict[str, Any], name: str, one: Any) -> str:
    """The name under which something stands among what is known; where it is new, this one."""
    for other, value in known.items():
        if value is one:
            return other
    known[name] = one
    return name


class Wires(NamedTuple):
    """What belongs to a phase: its name, that of its system, and of each input the name among those of all phases."""

    phase: str
    system: str
    inputs: tuple[tuple[str, str], ...]


class AbstractSurroundings(Module):
    """What is put around the systems of phases: plans with their controllers, noise."""

    @abc.abstractmethod
    def around(self, system: System, wires: Wires) -> System:
        """The system of a phase with what is around it."""

    @abc.abstractmethod
    def with_plan(self, means: Any, inputs: Inputs, uncertain: tuple[str, ...]) -> "AbstractSurroundings":
        """See `AbstractExtended.with_plan`: `means` are those of all systems by name, `inputs` those of all phases."""


@final
@transparent("systems", "surroundings")
class LinkedSystems(AbstractSystem):
    """The systems of phases.

    - `systems`: by the first phase of each; `wiring`: of each phase, in order; `links`: what begins phases, by name;
      `surroundings`: None where nothing is put around systems.
    """

    has_time: ClassVar[bool] = True
    systems: dict[str, System]
    wiring: tuple[Wires, ...] = eqx.field(static=True)
    links: tuple[tuple[str, Link], ...] = eqx.field(static=True)
    surroundings: AbstractSurroundings | None = None

    @property
    def phases(self) -> dict[str, System]:
        """The system of each phase, in order."""
        around = None if self.surroundings is None else self.surroundings.around
        each = ((one, self.systems[one.system]) for one in self.wiring)
        return {one.phase: system if around is None else around(system, one) for one, system in each}

    def wires(self, phase: str) -> tuple[tuple[str, str], ...]:
        """The inputs of a phase, each with its name among those of the simulation."""
        return next(one.inputs for one in self.wiring if one.phase == phase)

    def with_plan(self, means: Any, inputs: Inputs, uncertain: tuple[str, ...]) -> "LinkedSystems":
        """Itself, in whose phases plans are followed: see `AbstractSurroundings`."""
        assert self.surroundings is not None
        return replace(self, surroundings=self.surroundings.with_plan(means.systems, inputs, uncertain))

    def refuse_unknown(self, asked: Asked) -> None:
        """Raise `ProblemError` for names of no phase."""
        if unknown := [name for name in asked.instants or () if phase_of(name) not in self.phases]:
            first = f"{next(iter(self.phases))}.{unknown[0]}"
            raise ProblemError(
                f"{self.title}: expected outputs with the names of their phases, such as '{first}'; received {unknown}."
            )

    @property
    @override
    def title(self) -> str:
        return f"Phases({', '.join(self.phases)})"

    @property
    @override
    def is_integrated(self) -> bool:
        return any(system.is_integrated for system in self.systems.values())

    @property
    def states(self) -> tuple[str, ...]:
        """The states of all phases."""
        return tuple(f"{name}.{state}" for name, system in self.phases.items() for state in system.states)

    @property
    @override
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        return {f"{name}.{key}": one for name, system in self.phases.items() for key, one in system.units.items()}

    @property
    @override
    def rates_of(self) -> Mapping[str, str]:  # type: ignore[override]
        every = ((name, key, one) for name, system in self.phases.items() for key, one in system.rates_of.items())
        return {f"{name}.{key}": f"{name}.{one}" for name, key, one in every}

    @override
    def diagnose(self, grid: Any) -> str:
        # What is around a system is judged where it begins, which is known of the first phase alone.
        (name, first), *later = self.phases.items()
        each = ((name, first), *((name, system.plain) for name, system in later))
        return next(filter(None, (system.diagnose(grid.grids[name]) for name, system in each)), "")

    @override
    def destabilised(self, grid: Any) -> str:
        name, first = next(iter(self.phases.items()))
        return first.destabilised(grid.grids[name])


@final
@transparent("grids")
class LinkedGrid(AbstractGrid):
    """The grids of phases, whose instants stand one after the other: a phase ends at the time that the next one begins.

    - `grids`: by phase; `order`: that of the phases.
    """

    grids: dict[str, Grid]
    order: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, grids: Mapping[str, Grid], order: Iterable[str]):
        self.grids, self.order = dict(grids), tuple(order)

    @property
    def steps(self) -> int:  # type: ignore[override]
        """One less than there are instants."""
        return sum(one.steps + 1 for one in self.grids.values()) - 1

    @override
    def finer(self, factor: int) -> "LinkedGrid":
        return LinkedGrid({name: one.finer(factor) for name, one in self.grids.items()}, self.order)

    @override
    def divided(self, steps: int) -> "LinkedGrid":
        # As many times as many in each phase.
        grids = {name: one.divided(-(-one.steps * steps // self.steps)) for name, one in self.grids.items()}
        return LinkedGrid(grids, self.order)

    @override
    def coarser(self, parts: int) -> "LinkedGrid":
        return LinkedGrid({name: one.coarser(parts) for name, one in self.grids.items()}, self.order)

    @property
    def until(self) -> str | None:
        """An event that ends a phase."""
        return next((f"{name}.{one.until}" for name, one in self.grids.items() if one.until is not None), None)

    @property
    def duration(self) -> Scalar:
        """That of all phases, s."""
        return sum(one.duration for one in self.grids.values())

    @property
    @override
    def step(self) -> Scalar:
        return self.duration / self.steps

    @property
    @override
    def times(self) -> Float[Array, " instants"]:
        every, begin = [], self.grids[self.order[0]].t_start
        for name in self.order:
            grid = self.grids[name]
            every.append(begin + (grid.times - grid.t_start))
            begin = begin + grid.duration
        return jnp.concatenate(every)

    @override
    def of(self, name: str) -> Grid:
        return self.grids[phase_of(name)]

    @override
    def where(self, name: str) -> slice:
        ends = np.cumsum([0, *(self.grids[phase].steps + 1 for phase in self.order)])
        place = self.order.index(phase_of(name))
        return slice(int(ends[place]), int(ends[place + 1]))

    @property
    @override
    def times_told(self) -> dict[str, Float[Array, " instants"]]:
        return named({name: self.grids[name].times_told for name in self.order})


def phase_of(name: str) -> str:
    """The phase that a name is in."""
    return name.partition(".")[0]


def named(parts: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """What phases have by name, in one mapping; what a motion without phases has, whose phase has no name, as it is."""
    every = ((f"{phase}." if phase else "", own) for phase, own in parts.items())
    return {f"{before}{key}": value for before, own in every for key, value in own.items()}


def within(phase: str, names: frozenset[str]) -> frozenset[str]:
    """Those of some names that are in a phase, by their names there."""
    return frozenset(name.partition(".")[2] for name in names if phase_of(name) == phase)


def asked_within(phase: str, asked: Asked) -> Asked:
    """What is asked of one phase."""
    which = _integrated_in(phase, asked)
    return asked._replace(
        instants=asked.instants and within(phase, asked.instants),
        nodes=within(phase, asked.nodes),
        integrands=tuple(_named_within(phase, asked.integrands[i]) for i in which),
        integrated=tuple(within(phase, asked.integrated[i]) for i in which),
        events=within(phase, asked.events),
        at_events=within(phase, asked.at_events),
        courses=asked.courses and {"": asked.courses[phase]},
    )


def _integrated_in(phase: str, asked: Asked) -> list[int]:
    """Which integrands are those of a phase."""
    return [i for i, names in enumerate(asked.integrated) if phase in map(phase_of, names)]


def _named_within(phase: str, integrand: Integrand) -> Integrand:
    """An integrand of outputs by their names in a phase."""
    return lambda now: integrand(named({phase: now}))


def joined(records: Mapping[str, Record], asked: Asked) -> Record:
    """The records of all phases in one."""
    integrals = dict[int, Array]()
    for phase, record in records.items():
        integrals |= zip(_integrated_in(phase, asked), record.integrals, strict=True)
    events = {
        phase: {name: Occurrence(one.t, named({phase: one.outputs})) for name, one in (record.events or {}).items()}
        for phase, record in records.items()
    }
    aside = set() if asked.states else {f"{phase}.{STATES}" for phase in records}
    history = named({phase: record.history for phase, record in records.items()})
    return Record(
        history={name: values for name, values in history.items() if name not in aside},
        nodes=named({phase: record.nodes for phase, record in records.items()}),
        integrals=tuple(integrals[i] for i in range(len(integrals))),
        events=named(events),
        grid=LinkedGrid({phase: record.grid for phase, record in records.items()}, records),
    )


def linked_states(
    name: str, system: System, before: str, link: Link | None, ended: System, t: Any, z: Any
) -> dict[str, Array]:
    """The states with which a phase begins, by the link to it and the states with which the phase before it ends.

    - `name`, `system`: of the phase that begins; `before`, `ended`: of the one that ends, with its time and states.

    Raises `ProblemError` for a state that neither gives, and for values of a link that are no states.
    """
    who = f"Phases: link['{name}']"
    values = {} if link is None else returned(who, MethodType(link, ended.formulated), t, z)
    if not isinstance(values, Mapping) or not set(values) <= set(system.states):
        raise ProblemError(
            f"{who}: expected values by the names of some of the states {system.states} of {system.title}, as a dict; "
            f"received {values!r}."
        )
    if missing := [one for one in system.states if one not in values and one not in ended.states]:
        raise ProblemError(
            f"Phases: '{name}' has the state '{missing[0]}', which '{before}' does not have, and no link gives it: "
            f"write link={{'{name}': lambda self, t, z: {{'{missing[0]}': ...}}}}."
        )
    return {
        one: traceable(f"{who}, '{one}'", values[one]) if one in values else getattr(z, one) for one in system.states
    }
