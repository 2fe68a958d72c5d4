"""`Simulation`: a system with everything needed to simulate it."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library, jax_array, numbers_to_arrays
from aleator._core.compilation import Use, evaluate
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractPlanned, transparent
from aleator.dynamics._algebraic import AlgebraicSystem, explain_failure, history_alone
from aleator.dynamics._closing import closed
from aleator.dynamics._equations import Equations, Start, TracedSystem
from aleator.dynamics._evaluation import initial_state
from aleator.dynamics._explained import explain_cycle, refuse_unknown_event
from aleator.dynamics._extended import AbstractExtended
from aleator.dynamics._grid import AbstractGrid, Grid, Inputs, Instant, check_signals, inputs_on, sampled
from aleator.dynamics._integrators import AbstractFixedStep, AbstractIntegrator, RungeKutta4
from aleator.dynamics._phases import LinkedSystems, Phases, asked_within, joined, phase_of, within
from aleator.dynamics._record import ONLY_STATES, STATES, Asked, History, Occurrence, Record, chosen, observed
from aleator.dynamics._steps import LookedUp, tables_looked_up
from aleator.dynamics._system import AbstractSystem, End, System, check_variables, refuse_unrealised
from aleator.trajectories import AbstractSignal, least_steps


@final
@transparent("system", "grid", "numbers")
class Simulation(AbstractPlanned):
    """What is simulated: a system with its inputs, a grid, and an integrator.

    Any of its numbers may be a distribution or a decision; once realised, it can be recorded. Only here are kinds of
    systems told apart. `numbers`, by name, are in no system: what is made of its outputs may depend on them. `begun`:
    the states, side by side, with which it begins; None for those that its equations tell. `looked_up`: see
    `with_tables_looked_up`.
    """

    system: AbstractSystem
    inputs: dict[str, AbstractSignal]
    grid: AbstractGrid
    integrator: AbstractIntegrator
    numbers: dict[str, Any] = eqx.field(default_factory=dict)
    equations: Equations | None = eqx.field(static=True, default=None)
    begun: Float[Array, " states"] | None = None
    looked_up: dict[str, LookedUp] = eqx.field(default_factory=dict)

    @override
    def beside(self, means: Callable[[], Any]) -> "Simulation":
        system = self.system
        is_surrounded = isinstance(system, LinkedSystems) and system.surroundings is not None
        if not (isinstance(system, AbstractExtended) or is_surrounded):
            return self
        known = means()
        uncertain = tuple(name for name, signal in known.inputs.items() if jax.tree.leaves(signal))
        inputs = eqx.combine(known.inputs, self.inputs)
        return replace(self, system=system.with_plan(known.system.plain, inputs, uncertain))  # type: ignore[union-attr]

    @property
    def traced(self) -> AbstractSystem:
        """The realised system as programs evaluate it: by the equations that were declared, if they were."""
        if isinstance(self.system, LinkedSystems):
            if self.equations is not None:
                self.equations.complete(self.system, replace(self, equations=None).traced_equations)
            return self.system
        system = self.system if self.equations is None else self.equations.applied(self.system, self.start)
        return system if self.begun is None else system.beginning(self.begun)  # type: ignore[attr-defined]

    def traced_equations(self) -> Equations:
        """The equations of its realised system, traced now."""
        if isinstance(self.system, LinkedSystems):
            starts = {name: start for name, one in self.phases.items() if (start := one.start()) is not None}
            return Equations.linked(self.system, starts)
        return Equations.of(self.system, self.start())

    @property
    def phases(self) -> "dict[str, Simulation]":
        """The simulation of each phase by name, in order; itself, without a name, if there are none."""
        if not isinstance(self.system, LinkedSystems):
            return {"": self}
        return {name: self.of(f"{name}.") for name in self.system.phases}

    def of(self, name: str) -> "Simulation":
        """The simulation of the phase that a name is in; itself if there are none."""
        if not isinstance(self.system, LinkedSystems):
            return self
        phase, equations = phase_of(name), self.equations
        inputs = {key: self.inputs[wire] for key, wire in self.system.wires(phase) if wire in self.inputs}
        own = None if equations is None else equations.phases.get(phase)
        return Simulation(self.system.phases[phase], inputs, self.grid.of(name), self.integrator, {}, own)

    def start(self) -> Start | None:
        """The first instant, and the inputs there; None without time."""
        if not (isinstance(self.system, System) and isinstance(self.grid, Grid)):
            return None
        signals = {**self.system.signals(), **self.inputs}
        values = sampled(signals, self.grid, self.grid.fractions[:1])
        _, times, values = in_library(self.grid.times, values)
        return Start(jax_array(times[0]), {name: jax_array(rows[0]) for name, rows in values.items()})

    def record(self, asked: Asked) -> Record:
        """Simulate with known numbers, recording what is asked for. Raises `ProblemError` if parts do not match."""
        refuse_unrealised(system=self.system, grid=self.grid, inputs=self.inputs)
        system = self.traced
        if isinstance(system, LinkedSystems):
            system.refuse_unknown(asked)
            declared = self.declared() if self.equations is None else self
            return joined(declared._in_order(asked), asked)
        if isinstance(system, AlgebraicSystem):
            history = history_alone(system, self.grid, self.inputs)
            return Record(chosen(system, history, asked.instants), {}, (), grid=self.grid)
        assert isinstance(system, System)
        grid = self._checked_grid(system)
        parts = self._parts(grid)
        if parts > 1:
            return self.on(grid.finer(parts)).record(asked).thinned(parts)
        inputs = self.signals(system)
        if asked.outputs is not None:
            system = system.focused(asked.outputs)
        if asked.courses is not None:
            assert isinstance(system, TracedSystem)
            course, asked = asked.courses[""], asked._replace(courses=None)
            if grid.until is not None:
                return replace(self, begun=course[0]).record(asked)
            return self._in_parts(system, grid, inputs, asked, course)._replace(grid=grid)
        if not system.states:
            return observed(system, grid, inputs, asked)._replace(grid=grid)
        if grid.until is None and not grid.periodic:
            return self.integrator.record(system, grid, inputs | self.looked_up, asked)._replace(grid=grid)
        if grid.periodic and self.equations is None:
            return self.declared().record(asked)
        if grid.until is None or grid.until not in asked.events:
            return self._closed(system, grid, inputs, asked)
        # The event that ends the grid is at its end.
        instants = None if asked.instants is None else asked.instants | asked.at_events
        record = self._closed(system, grid, inputs, asked._replace(instants=instants))
        end = Occurrence(record.grid.t_final, {name: values[-1] for name, values in record.history.items()})
        return record._replace(events={**(record.events or {}), grid.until: end})

    def _closed(self, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> Record:
        """The record of a grid that an event ends, or that repeats."""
        ending = partial(closed, self.integrator.record) if grid.periodic else self.integrator.ending
        if not isinstance(self.system, AbstractExtended):
            return ending(system, grid, inputs, asked)
        record = ending(system, grid, inputs, asked._replace(states=True))
        end = self._end(record)
        record = self.system.at_end(record, end)
        history = {name: rows for name, rows in record.history.items() if asked.states or name != STATES}
        if asked.multipliers:  # of the realisation, which its plan and its covariance do not move
            n = sum(map(jnp.size, self.system.plain_states(end.z)))
            record = record._replace(monodromy=record.monodromy[:n, :n])
        return record._replace(history=history)

    def _in_order(self, asked: Asked) -> dict[str, Record]:
        """The record of each phase, which begins with the states that the one before ends with, or that are told."""
        records, before, phases = dict[str, Record](), None, self.phases
        for name, one in phases.items():
            if before is not None and asked.courses is None:
                one = self._begun(name, one, before, next(reversed(records.values())))
            states = asked.states or len(records) + 1 < len(phases)
            records[name] = one.record(asked_within(name, asked)._replace(states=states))
            before = one
        return records

    def _begun(self, name: str, one: "Simulation", before: "Simulation", record: Record) -> "Simulation":
        """A phase with the states that it begins with, from the record of the one before."""
        equations, system, plan = self.equations, one.system, before.plan
        assert equations is not None
        assert isinstance(system, System)
        end = before._end(record)
        end = end._replace(plan=end if plan is None else plan._end(plan.record(ONLY_STATES)))
        states = system.continuing(equations[name], before.system, end)
        begun = jnp.concatenate([jnp.zeros(0), *(jnp.ravel(states[state]) for state in system.states)])
        return replace(one, begun=begun)

    def _end(self, record: Record) -> End:
        """The end of a phase."""
        system, grid = self.traced, record.grid
        assert isinstance(system, System)
        last = self.unravelled(record.history.get(STATES, jnp.zeros((1, 0)))[-1])
        return End(system, grid.t_final, last, lambda t: inputs_on(grid, self.signals(system))(t))

    @property
    def plan(self) -> "Simulation | None":
        """The same up to the event at which its plan ends; None if it has no plan, or this ends at the same time."""
        system, grid = self.system, self.grid
        if not (isinstance(system, AbstractExtended) and isinstance(grid, Grid)):
            return None
        planned = system.planned_events.get(grid.until or "")
        return None if planned is None else self.on(grid.ending_at(planned))

    def resting(self) -> list[Float[Array, " _"]]:
        """The states, side by side, with which each phase begins if those before it end as they began."""
        assert self.traced is not None  # the equations of all phases are known
        begun, before = list[Float[Array, " states"]](), None
        for name, one in self.phases.items():
            system, start = one.traced, one.start()
            assert isinstance(system, System)
            assert start is not None
            if before is None:
                states = ravel_pytree(initial_state(system, *start))[0]
            else:
                ended = Record({STATES: begun[-1][None]}, {}, (), grid=before.grid)
                states = self._begun(name, one, before, ended).begun
                assert states is not None
            begun.append(states)
            before = one
        return begun

    def unravelled(self, states: Float[Array, " states"]) -> Any:
        """The states as the system names them, from these side by side."""
        system, start = self.traced, self.start()
        assert isinstance(system, System)
        assert start is not None
        return ravel_pytree(initial_state(system, *start))[1](states)

    def signals(self, system: System) -> Inputs:
        """All signals, the system's own ones too: on a grid that ends by an event, the same functions of time in all
        realisations.
        """
        grid, signals = self.grid, {**system.signals(), **self.inputs}
        if not isinstance(grid, Grid) or grid.until is None:
            return signals
        return {name: signal.over(grid.t_start, grid.t_final) for name, signal in signals.items()}

    def _in_parts(
        self, system: TracedSystem, grid: Grid, inputs: Inputs, asked: Asked, course: Float[Array, "parts states"]
    ) -> Record:
        """The record of equal parts of the time, each simulated from states of its own."""
        steps = grid.steps // len(course)
        whole = {name: signal.over(grid.t_start, grid.t_final) for name, signal in inputs.items()}

        def part(states: Array, first: Array, last: Array) -> Record:
            own = eqx.tree_at(lambda one: (one.t_start, one.t_final), grid.divided(steps), (first, last))
            return self.integrator.record(system.beginning(states), own, whole, asked)

        def joined(rows: Float[Array, "parts ends ..."]) -> Float[Array, "instants ..."]:
            return jnp.concatenate([rows[0, :1], rows[:, 1:].reshape(-1, *rows.shape[2:])])

        ends = grid.times[::steps]
        parts = jax.vmap(part)(course, ends[:-1], ends[1:])
        history, nodes = jax.tree.map(joined, (parts.history, parts.nodes))
        return Record(history, nodes, tuple(one.sum(axis=0) for one in parts.integrals))

    @property
    def folds(self) -> bool:
        """Whether outputs can be folded instant by instant while they are simulated (see `Asked`)."""
        system, grid = self.system, self.grid
        if not (isinstance(system, System) and system.states and isinstance(grid, Grid)) or grid.until or grid.periodic:
            return False
        return isinstance(self.integrator, AbstractFixedStep) and self._parts(grid) == 1

    def _parts(self, grid: Grid) -> int:
        """Steps that are taken in the place of each: none may cross a node of a control, where order would be lost.

        Where an event ends the grid, nodes divide steps.
        """
        if grid.until is not None:
            return 1
        return math.lcm(least_steps((self.system, self.inputs)), grid.steps) // grid.steps

    def declared(self) -> "Simulation":
        """The same simulation with the equations of its realised system, traced now."""
        numbers, static = eqx.partition(numbers_to_arrays(self), eqx.is_array)
        equations = list[Equations]()

        def traced(numbers: Any) -> list[Any]:
            equations.append(eqx.combine(numbers, static).traced_equations())
            return []

        jax.eval_shape(traced, numbers)
        return replace(self, equations=equations[0])

    def history(self) -> History:
        """All outputs at every instant, by name, with known numbers: shape (instants, ...)."""
        return self.record(Asked()).history

    def explain(self, events: frozenset[str] = frozenset()) -> str:
        """Why it has no solution, as far as its equations or its integrator can tell; empty if there is one.

        - `events`: those without which nothing is known of it.
        """
        repeats = isinstance(self.grid, Grid) and self.grid.periodic
        if self.equations is None and (repeats or isinstance(self.system, LinkedSystems)):
            return self.declared().explain(events)
        system = self.traced
        if isinstance(system, LinkedSystems):
            return self._explain_phases(events)
        if isinstance(system, AlgebraicSystem):
            return explain_failure(system)
        if not (isinstance(system, System) and isinstance(self.grid, Grid) and system.states):
            return ""
        why = self.integrator.explain(system, self.grid, self.signals(system), events)
        if why or not self.grid.periodic:
            return why
        rows = evaluate(lambda: self.record(ONLY_STATES).history[STATES], use=Use.ONCE)
        if np.isfinite(np.asarray(rows)).all():
            return ""
        assert isinstance(system, TracedSystem)
        return explain_cycle(self.integrator.record, system, self.grid, self.signals(system))

    def _explain_phases(self, events: frozenset[str]) -> str:
        """The same of the first phase that has no solution."""
        before: tuple[Simulation, Record] | None = None
        for name, one in self.phases.items():
            one = one if before is None else self._begun(name, one, *before)
            own = within(name, events)
            if why := one.explain(own) or (one.plan.explain() if one.plan else ""):
                return f"In the phase '{name}', {why}"
            asked = ONLY_STATES._replace(events=own)
            before = one, evaluate(lambda one=one, asked=asked: one.record(asked), use=Use.ONCE)
        return ""

    def on(self, grid: AbstractGrid, integrator: AbstractIntegrator | None = None) -> "Simulation":
        """The same simulation on another grid, by another integrator if one is given."""
        return replace(self, grid=grid, integrator=integrator or self.integrator, looked_up={})

    def finer(self, factor: int, integrator: AbstractIntegrator) -> "Simulation":
        """The same on a grid with more steps, by another integrator, as is what is simulated inside the model."""
        equations = self.equations
        inside = equations if equations is None or equations.finer is None else equations.finer
        return replace(self.on(self.grid.finer(factor), integrator), equations=inside)

    def with_tables_looked_up(self, *, middles: bool) -> "Simulation":
        """The same with the tables among its inputs looked up for all steps, if nothing in them or in the grid is
        uncertain or decided: a search of a table in each program takes as long to compile as many equations.

        - `middles`: whether outputs are recorded at the middles of steps too.
        """
        grid, nodes = self.grid, self.integrator.nodes(middles=middles)
        if not (isinstance(grid, Grid) and isinstance(grid.t_final, float) and grid.until is None and nodes):
            return self
        return replace(self, looked_up=tables_looked_up(grid, self.inputs, nodes))

    def narrower(self) -> "Simulation | None":
        """The same with half the widths of `al.smooth`; None without any."""
        equations = self.equations
        narrower = None if equations is None else equations.narrower
        return None if narrower is None else replace(self, equations=narrower)

    def refuse_at_start(self, system: System) -> None:
        """Raise `ProblemError` for what can be told of the start with known numbers, without tracing any rate.

        A start that is solved for by a program of its own is left to `refuse_no_start`.
        """
        refuse_unrealised(system=system, grid=self.grid, inputs=self.inputs)
        self._checked_grid(system)
        if not system.solves_start:
            self.refuse_no_start(system)

    def refuse_no_start(self, system: System) -> None:
        """Raise `ProblemError` for a start that is not finite, with known numbers."""
        # Signals are evaluated only for a start that follows from them.
        grid = self._checked_grid(system)
        start = (None, {}) if type(system).starting is System.starting else self.start()
        assert start is not None
        try:
            initial_state(system, *start)
        except ProblemError as error:
            raise ProblemError(system.diagnose(grid) or f"{error}") from error

    def _checked_grid(self, system: System) -> Grid:
        """The grid, once it is certain that system and inputs go with it."""
        if not isinstance(self.grid, Grid):
            raise ProblemError(
                f"{system.title} evolves in time: expected a grid, such as al.Grid(t_final, steps); received "
                f"{type(self.grid).__name__}."
            )
        if self.equations is None:
            check_variables(system)
            check_signals(system, self.grid, self.inputs)
        refuse_unknown_event(system, self.grid.until)
        return self.grid


def simulation_of(
    system: AbstractSystem | Phases,
    grid: AbstractGrid | None,
    inputs: Mapping[str, AbstractSignal] | None,
    integrator: AbstractIntegrator | None,
    numbers: Mapping[str, Any] = MappingProxyType({}),
) -> Simulation:
    """A simulation from the given parts, with the defaults of its kind: one instant, no inputs, `RungeKutta4`."""
    if isinstance(system, Phases):
        if grid is not None or inputs is not None:
            raise ProblemError("Phases have grids and inputs of their own: expected no others; received some.")
        system, grid, inputs = system.parts()
    has_time = not isinstance(system, AbstractSystem) or system.has_time
    instants = Instant() if grid is None and not has_time else grid
    integrator = RungeKutta4() if integrator is None else integrator
    return Simulation(system, dict(inputs or {}), instants, integrator, dict(numbers))  # type: ignore[arg-type]
