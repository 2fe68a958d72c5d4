"""What the equations of a phase say at one mesh point of one realisation: rates, integrands, outputs, their shapes.

Time runs by the fraction of the grid's duration: multiplied by the duration, rates and integrands are those by the
fraction, so that a free final time stands in them and the scheme stays linear. Where an event ends the grid, each
realisation has a duration of its own, and so signals, functions of time, are evaluated in the blocks.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.arrays import in_library
from aleator.design import (
    AbstractFunctional,
    AbstractIntegral,
    At,
    Path,
    Problem,
    Taken,
    Terminal,
    frozen,
    functionals_of,
    grid_at,
    has_random_signals,
    integrated_paths,
    numbers_of,
)
from aleator.dynamics import (
    AbstractExtended,
    AbstractGrid,
    AbstractMeanRate,
    Asked,
    End,
    Grid,
    Known,
    Occurrence,
    Record,
    Simulation,
    System,
    TracedSystem,
    after_events,
    algebraic_residuals,
    completed,
    event_levels,
    guessed_algebraic,
    initial_state,
    known_at,
    named,
    observation,
    phase_of,
    solved_algebraic,
    with_algebraic,
    within,
)
from aleator.trajectories import has_jumps
from aleator.transcription.simultaneous._shapes import Shapes, Signals, apart, flat, taken_by
from aleator.uncertainty import realise

# How far from a jump its sides are told, as a part of the duration: more than rounding of times.
_BESIDE = 1e-11


def functionals_in(phase: str, problem: Problem) -> tuple[AbstractFunctional, ...]:
    """The functionals of a phase; all of a problem without phases."""
    every = functionals_of(problem.expressions)
    return tuple(one for one in every if not phase or phase_of(one.place) == phase)


def grid_in(phase: str, grid: AbstractGrid) -> Grid:
    """The grid of a phase; the only one of a problem without phases."""
    own = grid.of(f"{phase}.")
    assert isinstance(own, Grid)
    return own


@final
@dataclass(frozen=True)
class Pointwise:
    """The equations of one phase of a problem, taken apart: made anew wherever they are traced.

    - `phase`: its name; empty for a problem without phases, which is one;
    - `frozen`: the problem without the decisions of its signals; `direct`: where the others are among all;
    - `has_signals_inside`: whether signals are evaluated in the blocks, with all decisions: where they are uncertain,
      or each realisation has a duration of its own;
    - `integrals`: functionals that are integrated; `paths`, `ends`: outputs that are recorded at every instant, and at
      the last one alone, by name; `nodes`: outputs whose statistics are integrated over time, and so recorded in the
      middles between instants too; `composed`: functionals of these.
    """

    problem: Problem
    phase: str
    frozen: Problem
    direct: Int[np.ndarray, " direct"]
    has_signals_inside: bool
    integrals: tuple[AbstractIntegral, ...]
    paths: tuple[str, ...]
    ends: tuple[str, ...]
    nodes: tuple[str, ...]
    composed: tuple[AbstractFunctional, ...]

    @classmethod
    def each(cls, problem: Problem) -> "tuple[Pointwise, ...]":
        """Those of all phases of a problem that moves in time, in order."""
        return tuple(cls.of(problem, phase) for phase in problem.simulation.phases)

    @classmethod
    def of(cls, problem: Problem, phase: str = "") -> "Pointwise":
        """Those of a phase."""
        functionals = functionals_in(phase, problem)
        is_inside = grid_in(phase, problem.grid).until is not None or has_random_signals(problem)
        fixed, direct = (problem, np.arange(problem.placements.size)) if is_inside else frozen(problem)
        whole = [one for one in functionals if not isinstance(one, AbstractIntegral | Terminal | At)]
        at_end = [one for one in functionals if isinstance(one, Terminal | At)]
        return cls(
            problem,
            phase,
            fixed,
            direct,
            is_inside,
            tuple(one for one in functionals if isinstance(one, AbstractIntegral)),
            tuple(dict.fromkeys(name for one in whole for name in one.outputs)),
            tuple(dict.fromkeys(name for one in at_end for name in one.outputs)),
            tuple(dict.fromkeys(name for one in integrated_paths(problem.expressions) for name in one.outputs)),
            tuple(one for one in functionals if not isinstance(one, Path) and not (one in at_end and one.outputs)),
        )

    @cached_property
    def signals(self) -> Signals:
        """What signals a realisation has: nothing is computed."""
        answers: list[Signals] = []

        def realised(decisions: Array) -> Array:
            simulation, system = self._known_parts(decisions)
            own, grid = system.signals(), grid_in(self.phase, simulation.grid)
            every = {**own, **simulation.inputs}
            shapes = {} if self.has_signals_inside else dict(known_at(every, grid, np.zeros(1)).inputs)
            follow_states = system.system.signals_from(own, jnp.zeros(0)) is not own
            answers.append(Signals(shapes, bool(own), has_jumps(every), follow_states))
            return decisions

        jax.eval_shape(realised, _numbers(self.problem.placements.size))
        return answers[0]

    @property
    def grid(self) -> Grid:
        """The grid as it is declared."""
        return grid_in(self.phase, self.problem.grid)

    @property
    def is_open(self) -> bool:
        """Whether each realisation has a duration of its own."""
        return self.grid.until is not None

    def known(
        self,
        places: Any,
        decisions: Float[Array, " n"],
    ) -> Float[Array, "places signals"]:
        """All signals at some places, see `Mesh.places`, side by side; none where they are evaluated in the blocks."""
        if self.has_signals_inside:
            return jnp.zeros((len(places), 0))
        simulation, system = self._known_parts(decisions)
        every = {**system.signals(), **simulation.inputs}
        return known_at(every, grid_in(self.phase, simulation.grid), self._told_at(places)).rows[:, 1:]

    def _told_at(self, places: Any) -> Any:
        """Places as fractions of the duration; where signals jump, a little off on the side that is theirs."""
        if not self.signals.have_jumps:
            return places[..., 0]
        xp, places = in_library(places)
        beside = xp.where(places[..., 1] > 0, -_BESIDE, _BESIDE)
        return xp.clip(places[..., 0] + beside, 0.0, 1.0)

    def duration(self, decisions: Float[Array, " n"]) -> Float[Array, "..."]:
        """From the first instant to the last, s; nothing where each realisation has its own."""
        if self.is_open:
            return jnp.zeros(0)
        return jnp.asarray(grid_in(self.phase, grid_at(self.problem, decisions)).duration, dtype=float)

    def initial(self, germ: Array, place: Array, shared: Array, signals: Array) -> Float[Array, " states"]:
        """The initial states of one realisation, side by side, at the first mesh point: see `rates`."""
        return flat(initial_state(*self._now(germ, place, shared, signals)))

    def onward(self, phase: str, germ: Array, place: Array, shared: Array, own: Array) -> Float[Array, " states"]:
        """The states with which the phase after it begins, from those at its last mesh point: see `rates`."""
        end, equations = self._end(germ, place, shared, own), self.problem.simulation.equations
        following = self.problem.simulation.of(f"{phase}.").system
        assert equations is not None
        assert isinstance(following, System)
        states = following.continuing(equations[phase], end.system.system, end)
        return flat([states[name] for name in following.states])

    def again(self, germ: Array, place: Array, shared: Array, own: Array) -> Float[Array, " states"]:
        """The states with which a cycle repeats, from those at its last mesh point: after the event that ends it."""
        system, t, z, now = self._at(germ, place, shared, own)
        return flat(z) if self.grid.until is None else after_events(system, t, z, now)[self._ending(system)]

    def level(self, germ: Array, place: Array, shared: Array, own: Array) -> Float[Array, " 1"]:
        """The function of the event that ends the grid: see `rates`."""
        system, t, z, now = self._at(germ, place, shared, own)
        return event_levels(system, t, z, now)[self._ending(system)][None]

    def _ending(self, system: System) -> int:
        """The number of the event that ends the grid."""
        return list(system.declared_events).index(self.grid.until or "")

    def rates(self, germ: Array, place: Array, shared: Array, own: Array) -> Float[Array, " rates"]:
        """The rates of the states, then the integrands, both by the fraction of the duration.

        - `place`: the fraction, then 1 for signals as they are before a jump there, else 0;
        - `shared`: the decisions of the model itself, then the duration; `own`: the signals, the duration if it is not
          shared, the states, and the algebraic variables unless these are to be solved for.
        """
        system, t, z, now = self._at(germ, place, shared, own)
        z = completed(system, t, z, now)
        integrated, duration = self._integrated, self._own_duration(shared, own)
        if not system.states:
            return duration * flat(integrated.rates(system, t, z, now))
        return duration * flat(integrated.slopes(system, t, z, now))

    def mean_rates(
        self, rate: AbstractMeanRate, germ: Array, places: Array, shared: Array, own: Array
    ) -> Float[Array, " rates"]:
        """What a block of a scheme says: see `rates`.

        - `places`: one or more, shape (places, 2); `own`: the signals at each of them, then the rest at the first.
        """
        signals, rest = jnp.split(own, [len(places) * self.signals.size])
        duration, rest = ([rest[:1]], rest[1:]) if self.is_open else ([], rest)

        def at(place: Array, signal: Array, rest: Array) -> Array:
            return self.rates(germ, place, shared, jnp.concatenate([signal, *duration, rest]))

        return rate(at, places, signals.reshape(len(places), self.signals.size), rest)

    def residuals(self, germ: Array, place: Array, shared: Array, own: Array) -> Float[Array, " algebraic"]:
        """What is left of the equations of the algebraic variables: see `rates`."""
        return algebraic_residuals(*self._at(germ, place, shared, own))

    def algebraic(self, germ: Array, place: Array, shared: Array, own: Array) -> Float[Array, " algebraic"]:
        """The algebraic variables that follow from signals and states, `own`.

        Where none are found they begin at their guess, but not at the first instant: there is no other state to try.
        """
        here = self._at(germ, place, shared, own)
        root, guess = solved_algebraic(*here)[0], flat(guessed_algebraic(*here))
        return jnp.where(root.converged, root.point, jnp.where(place[0] > 0, guess, jnp.nan))

    def outputs(self, names: tuple[str, ...], germ: Array, place: Array, shared: Array, own: Array) -> Array:
        """Some outputs, side by side; at the end of a realisation those that vary with its time too."""
        system, t, z, now = self._at(germ, place, shared, own)
        outputs, around = observation(system, t, z, now), system.system
        if self.is_open and isinstance(around, AbstractExtended):
            end, history = self._end(germ, place, shared, own), {name: one[None] for name, one in outputs.items()}

            def ended(history: dict[str, Array]) -> dict[str, Array]:
                return around.at_end(Record(history, {}, (), grid=self.grid), end).history

            # A choice of values would have no derivatives where those of `ended` are infinite.
            history = jax.lax.cond(place[0] < 1, lambda history: history, ended, history)
            outputs = {name: rows[0] for name, rows in history.items()}
        outputs = named({self.phase: outputs})
        return flat([outputs[name] for name in names])

    def composites(self, shapes: Shapes, duration: Array, integrals: Array, paths: Array) -> Float[Array, " rows"]:
        """The functionals of integrals and of whole histories of one realisation, side by side."""
        totals: dict[AbstractFunctional, Array] = dict(
            zip(self.integrals, apart(integrals, shapes.integrals), strict=True)
        )
        history = shapes.by_name(self.paths, paths.reshape(-1, max(shapes.size(self.paths), 1)))
        grid = eqx.tree_at(lambda one: one.t_final, self.grid, self.grid.t_start + duration)
        events = {} if grid.until is None else named({self.phase: {grid.until: Occurrence(grid.t_final, {})}})
        return flat(list(numbers_of(self.composed, Taken(history, totals, events), grid)))

    def shapes(self) -> Shapes:
        """The shapes of what is recorded: nothing is computed."""
        germ, place = _numbers(len(self.problem.placements.germ_names)), _numbers(2)
        signals, before = self.signals.size, self.signals.size + self.is_open
        shared, first = _numbers(self.direct.size + (not self.is_open)), _numbers(before)
        states = jax.eval_shape(self.initial, germ, place, shared, first).size

        def recorded(germ: Array, place: Array, shared: Array, own: Array) -> tuple[Any, ...]:
            system, t, z, now = self._at(germ, place, shared, own)
            outputs = named({self.phase: observation(system, t, z, now)})
            names = (*self.paths, *self.ends)
            algebraic = guessed_algebraic(system, t, z, now) if system.algebraic else ()
            return algebraic, self._integrated.rates(system, t, z, now), {name: outputs[name] for name in names}

        own = _numbers(before + states)
        algebraic, integrals, outputs = jax.eval_shape(recorded, germ, place, shared, own)
        return Shapes(
            states,
            sum(one.size for one in algebraic),
            signals,
            tuple(one.shape for one in integrals),
            {name: one.shape for name, one in outputs.items()},
        )

    def _known_parts(self, decisions: Float[Array, " n"]) -> tuple[Simulation, TracedSystem]:
        germ = jnp.zeros(len(self.problem.placements.germ_names))
        return self._realised(self.problem, germ, decisions)

    @property
    def _integrated(self) -> Asked:
        each = (lambda now, one=one: one.integrand(named({self.phase: now})) for one in self.integrals)
        every = (frozenset(one.outputs) for one in self.integrals)
        own = (within(self.phase, names) if self.phase else names for names in every)
        return Asked(frozenset(), integrands=tuple(each), integrated=tuple(own))

    def _own_duration(self, shared: Array, own: Array) -> Float[Array, ""]:
        """That of a realisation: see `rates`."""
        return own[self.signals.size] if self.is_open else shared[-1]

    def _realised(self, problem: Problem, germ: Array, decisions: Array) -> tuple[Simulation, TracedSystem]:
        """The simulation of one realisation, and its system for what is asked of it."""
        whole = realise(problem.simulation, germ, decisions)
        names = frozenset(name for one in functionals_of(self.problem.expressions) for name in one.outputs)
        system, simulation = whole.traced, whole
        if self.phase:  # What is traced of the whole are the equations of all phases.
            simulation, names = whole.of(f"{self.phase}."), within(self.phase, names)
            system = simulation.traced
        assert isinstance(system, TracedSystem)
        return simulation, system.focused(names)

    def _now(self, germ: Array, place: Array, shared: Array, own: Array) -> tuple[TracedSystem, Array, dict[str, Any]]:
        """A realised system with its time and inputs at one mesh point; states are left alone."""
        direct, duration = shared if self.is_open else shared[:-1], self._own_duration(shared, own)
        simulation, system = self._realised(self.frozen, germ, direct)
        t = jnp.asarray(self.grid.t_start + place[0] * duration)
        if not self.has_signals_inside:
            # Their values are not needed: a spline would be evaluated in every block.
            known = Known(jnp.zeros((0, 1)), tuple(self.signals.shapes.items()))
            return system, t, known.unpack(jnp.concatenate([t[None], own]))[1]
        each, span = simulation.signals(system), (self.grid.t_start, self.grid.t_start + duration)
        told_at = jnp.asarray(self.grid.t_start + self._told_at(place) * duration)
        return system, t, {name: one.over(*span)(told_at) for name, one in each.items()}

    def _at(
        self, germ: Array, place: Array, shared: Array, own: Array
    ) -> tuple[TracedSystem, Array, Any, dict[str, Any]]:
        """A realised system with its time, states (and algebraic variables, if given) and inputs at one mesh point."""
        system, t, now = self._now(germ, place, shared, own)
        z, rest = taken_by(lambda: initial_state(system, t, now), own[self.signals.size + self.is_open :])
        if rest.size:
            z = with_algebraic(system, z, taken_by(lambda: guessed_algebraic(system, t, z, now), rest)[0])
        return system, t, z, now

    def _end(self, germ: Array, place: Array, shared: Array, own: Array) -> End:
        """The end of a realisation, with its inputs at other times where its duration is its own."""
        system, t, z, _ = self._at(germ, place, shared, own)

        def inputs(t: Any) -> dict[str, Any]:
            fraction = (t - self.grid.t_start) / self._own_duration(shared, own)
            return self._now(germ, place.at[0].set(fraction), shared, own)[2]

        return End(system, t, z, inputs)


def _numbers(count: int) -> jax.ShapeDtypeStruct:
    """So many numbers, for functions of which the shapes alone are asked."""
    return jax.ShapeDtypeStruct((count,), float)
