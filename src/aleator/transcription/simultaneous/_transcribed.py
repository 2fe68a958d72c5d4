"""A problem as a simultaneous program: the states of every realisation are variables, tied by a scheme.

Nothing is simulated while it is solved (dissertation, section 3.3; SimNLP, equations 95 and 123): so systems that are
unstable, stiff or held within bounds can be designed that cannot be simulated at every decision on the way.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from typing_extensions import override

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator.design import (
    Problem,
    expanded_functionals,
    extreme_functionals,
    functionals_of,
    integrated_paths,
)
from aleator.dynamics import AbstractCollocation, Grid
from aleator.ensemble import inputs_at
from aleator.nlp import HELD
from aleator.solution import Costates, MeshError, States, Switching
from aleator.statistics import Constants
from aleator.transcription._abstract import AbstractTranscribed, Meaning, Remembered, Texts
from aleator.transcription._expansions import Between, Discretised, ExpansionScope
from aleator.transcription._scenarios import Scenarios
from aleator.transcription.simultaneous._controls import followed, whole_parts
from aleator.transcription.simultaneous._costates import adjoint
from aleator.transcription.simultaneous._first_point import started
from aleator.transcription.simultaneous._guess import state_shapes
from aleator.transcription.simultaneous._layout import Layout, Plan
from aleator.transcription.simultaneous._mesh import Mesh
from aleator.transcription.simultaneous._mesh_error import Drift, drift_of, states_on
from aleator.transcription.simultaneous._nonlinear import program_of
from aleator.transcription.simultaneous._pointwise import Pointwise
from aleator.transcription.simultaneous._program import Assembled
from aleator.transcription.simultaneous._refinement import Goal, refinement
from aleator.transcription.simultaneous._rows import Given
from aleator.transcription.simultaneous._scales import scales
from aleator.transcription.simultaneous._segments import segment_drift, segment_states_on
from aleator.transcription.simultaneous._shapes import apart
from aleator.transcription.simultaneous._signals import are_affine
from aleator.transcription.simultaneous._start import AbstractStart
from aleator.uncertainty import named_numbers

# Steps of a simulation for each step in an interval of a mesh, if it has no more points inside.
_FINER = 2
# So many meshes at most, and variables of the last: where something jumps inside, no mesh would ever be fine enough.
_MOST_MESHES, _MOST_VARIABLES = 8, 1_000_000


def _told(problem: Problem, constants: Constants, at: tuple[Any, ...]) -> tuple[jax.Array, ...]:
    """Every statistic that stands in a problem, from decisions, coefficients, and values on the scenarios."""
    decisions, coefficients, realised = at
    scope = ExpansionScope(
        {},
        dict(zip(expanded_functionals(problem.expressions), coefficients, strict=True)),
        constants,
        named_numbers(problem.simulation, decisions),
        # Statistics are told at the instants alone, and integrals are known.
        between=Between({}, jnp.zeros(problem.grid.steps + 1), instants=1),
        realised=dict(zip(extreme_functionals(problem.expressions), realised, strict=True)),
    )
    _, taken = scope.evaluated(problem.expressions)
    return tuple(one for some in taken for one in some)


TOLD = Compiled(_told, use=Use.ONCE)


@final
@dataclass(frozen=True, kw_only=True)
class SimultaneouslyTranscribed(AbstractTranscribed):
    """A problem as a sparse program in its decisions and in the states of all realisations at the points of a mesh.

    - `goal`: what is asked of meshes; `meshes`: those before;
    - `begins`: where programs of the problem start;
    - `equations`: the problem, traced, as it is on the first mesh: with its rates and outputs, which are compiled once.
    """

    layout: Layout
    assembled: Assembled
    goal: Goal
    begins: AbstractStart
    equations: Problem
    meshes: tuple[MeshError, ...] = ()

    @property
    @override
    def decided(self) -> Int[np.ndarray, " n"]:
        return self.layout.numbers.decisions

    @override
    def point(self, decisions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " variables"]:
        states = self.begins.states(self.problem, self.layout.plan.mesh.fractions, self.points, decisions)
        return started(self.traced, self.layout, self.assembled, self.points, decisions, states)

    @override
    def at(self, point: Float[np.ndarray, " variables"]) -> Meaning:
        return self._remembered(point)

    @cached_property
    def _remembered(self) -> Remembered[Meaning]:
        return Remembered(self._meaning)

    def _meaning(self, point: Float[np.ndarray, " variables"]) -> Meaning:
        evaluation, variables = self.assembled(point), self.layout.view(point)
        every, numbers = self.layout.samples(variables), self.layout.samples(self.layout.numbers)
        count, expressions = len(self.collocation.points), self.problem.expressions
        sizes = self._sizes(point)
        samples = {one: self._apart(values, numbers[one], sizes) for one, values in every.items()}
        fitted = [
            self.collocation.coefficients(jnp.asarray(samples[one][:count]))
            for one in expanded_functionals(expressions)
        ]
        realised = [jnp.asarray(samples[one][count:]) for one in extreme_functionals(expressions)]
        taken = TOLD(self.traced, self.constants, (jnp.asarray(variables.decisions), fitted, realised))
        functionals, grid = functionals_of(expressions), self.problem.grid
        assert isinstance(grid, Grid)
        return Meaning(
            decisions=variables.decisions.copy(),
            objective=evaluation.objective,
            constraints=[evaluation.constraints[one] for one in self.rows],
            samples=tuple(samples[one][:count] for one in functionals),
            tangents=(None,) * len(functionals),
            statistics=tuple(np.asarray(one) for one in taken),
            times=self._instants(point, grid.fractions),
        )

    @staticmethod
    def _apart(samples: np.ndarray, numbers: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """Samples without what their equations leave open: realisations that differ by less are the same."""
        open_ = HELD * sizes[numbers].max(axis=0)
        middle = samples.mean(axis=0)
        return np.where(np.abs(samples - middle).max(axis=0) <= open_, middle, samples)

    @override
    def at_scenarios(self, scenarios: Scenarios) -> "SimultaneouslyTranscribed":
        found = self.discretised.at_scenarios(scenarios)
        way = self._way._replace(found=found, scenarios=scenarios)
        return replace(way.transcribed(self.layout.plan.mesh), meshes=self.meshes)

    @property
    @override
    def fineness(self) -> int:
        mesh, grid = self.layout.plan.mesh, self.problem.grid
        steps = max(_FINER * mesh.scheme.rate.steps, len(mesh.scheme.points) - 2)
        return steps * round(1 / (mesh.lengths.min() * grid.steps))

    @override
    def meshes_at(self, point: Float[np.ndarray, " variables"]) -> tuple[MeshError, ...]:
        return *self.meshes, self._reported(self._drift(point), point)

    @override
    def refined(
        self, point: Float[np.ndarray, " variables"]
    ) -> "tuple[SimultaneouslyTranscribed, Float[np.ndarray, ' variables']] | None":
        drift, mesh = self._drift(point), self.layout.plan.mesh
        error = self._reported(drift, point)
        if error.is_met or len(self.meshes) + 1 == _MOST_MESHES:
            return None
        scheme, parts = refinement(self.goal, mesh.scheme, drift)
        finer = mesh.refined(scheme, whole_parts(self.problem, parts))
        if self.layout.count * len(finer.fractions) > _MOST_VARIABLES * len(mesh.fractions):
            return None
        values = self.layout.view(point)
        states = self._states_on(point, finer.fractions)
        problem, decisions = followed(self.problem, values.decisions, finer.nodes)
        traced = numbers_to_arrays(problem)
        equations = self.equations if _has_same_equations(problem, self.layout.asked) else traced
        way = self._way._replace(problem=problem, traced=traced, equations=equations)
        found = way.transcribed(finer, (decisions, states))
        return replace(found, meshes=(*self.meshes, error)), found.program.start

    @override
    def states_at(self, point: Float[np.ndarray, " variables"]) -> States:
        shapes = state_shapes(self.problem)
        parts = apart(self.layout.view(point).states, list(shapes.values()))
        times = self._instants(point, self.layout.plan.mesh.fractions)
        return States(times, self.points, dict(zip(shapes, parts, strict=True)))

    @override
    def costates_at(
        self, point: Float[np.ndarray, " variables"], multipliers: Float[np.ndarray, " rows"]
    ) -> tuple[Costates, Switching] | tuple[None, None]:
        found, mesh = adjoint(self.layout, self.assembled, point, multipliers), self.layout.plan.mesh
        states, signals = state_shapes(self.problem), self.layout.asked.signal_shapes
        nodes, asked = self._instants(point, np.array(mesh.nodes)), self._instants(point, mesh.places[mesh.weighed, 0])
        by_state = dict(zip(states, apart(found.states, list(states.values())), strict=True))
        # What an integral over time of a statistic adds stands in no rate.
        is_whole = not integrated_paths(self.problem.expressions)
        by_signal = dict(zip(signals, apart(found.signals, list(signals.values())), strict=True)) if is_whole else {}
        return Costates(nodes, self.points, by_state), Switching(asked, by_signal)

    @property
    def _way(self) -> "Way":
        return Way(self.problem, self.traced, self.equations, self.discretised, self.scenarios, self.goal, self.begins)

    def _instants(
        self, point: Float[np.ndarray, " variables"], fractions: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Fractions of the duration as times, s."""
        return float(self.layout.asked.grid.t_start) + fractions * float(self.layout.view(point).duration[0])

    def _rates(self, point: Float[np.ndarray, " variables"]) -> Float[np.ndarray, "realisations asked rates"]:
        return self.assembled.blocks(point)[0][self.assembled.rates]

    def _sizes(self, point: Float[np.ndarray, " variables"]) -> Float[np.ndarray, " variables"]:
        """How large each kind of variable is at a point."""
        typical = self.program.variable_scale[self.decided]
        return scales(self.layout, self.assembled.rows.ties, point, self.assembled(point), typical)

    def _states_on(
        self, point: Float[np.ndarray, " variables"], fractions: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "realisations n states"]:
        """The states at some fractions of the duration."""
        layout = self.layout
        if isinstance(layout.plan.mesh.scheme, AbstractCollocation):
            return states_on(layout.plan.mesh, fractions, layout.view(point).states, self._rates(point))
        return segment_states_on(self.traced, layout, self.points, point, fractions)

    @cached_property
    def _drift(self) -> Remembered[Drift]:
        # Whether the last mesh is fine enough is asked before it is told.
        return Remembered(self._drift_at)

    def _drift_at(self, point: Float[np.ndarray, " variables"]) -> Drift:
        layout, sizes = self.layout, self._sizes(point)
        if isinstance(layout.plan.mesh.scheme, AbstractCollocation):
            return drift_of(self.traced, layout, self.points, self._rates(point), point, sizes)
        return segment_drift(self.traced, layout, self.points, point, sizes)

    def _reported(self, drift: Drift, point: Float[np.ndarray, " variables"]) -> MeshError:
        drifts, mesh = drift.errors.max(axis=2, initial=0.0), self.layout.plan.mesh
        worst, _ = np.unravel_index(np.argmax(drifts), drifts.shape)
        numbers = inputs_at(self.places, self.points[worst], jnp.asarray(self.decisions(point)))
        return MeshError(self._instants(point, np.array(mesh.nodes)), mesh.scheme, drifts, self.goal.error, numbers)


def _has_same_equations(problem: Problem, before: Pointwise) -> bool:
    """Whether a problem with other controls has the rates and outputs of the one before, of signals as told."""
    asked = Pointwise.of(problem)
    return not asked.is_random and asked.direct.size == before.direct.size


class Way(NamedTuple):
    """What a program is made from, beside a mesh."""

    problem: Problem
    traced: Problem
    equations: Problem
    found: Discretised
    scenarios: Scenarios | None
    goal: Goal
    begins: AbstractStart

    def transcribed(self, mesh: Mesh, begun: tuple[np.ndarray, np.ndarray] | None = None) -> SimultaneouslyTranscribed:
        """The program on a mesh. It begins at given decisions and states, or where all begin."""
        problem, traced, found, scenarios = self.problem, self.traced, self.found, self.scenarios
        collocation, constants = found.collocation, found.constants
        points = np.asarray(collocation.points)
        every = points if scenarios is None else np.concatenate([points, scenarios.points])
        fit = np.asarray(collocation.pseudo_inverse)
        asked = Pointwise.of(problem)
        plan = Plan(
            mesh, self.goal.schemes[0], len(points), len(every) - len(points), len(fit), are_affine(asked, mesh)
        )
        layout, given = Layout.of(problem, plan), Given.of(asked)
        assembled = Assembled.of(layout, traced, self.equations, constants, every, fit, given)
        decisions, states = begun or self._first(mesh, every)
        start = started(traced, layout, assembled, every, decisions, states)
        program, sizes = program_of(problem, scenarios, layout, assembled, given, start)
        return SimultaneouslyTranscribed(
            problem,
            traced,
            found,
            program,
            assembled.rows.own,
            sizes,
            Texts.of(problem),
            scenarios,
            layout=layout,
            assembled=assembled,
            goal=self.goal,
            begins=self.begins,
            equations=self.equations,
        )

    def _first(self, mesh: Mesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        decisions = self.begins.decisions(self.problem)
        return decisions, self.begins.states(self.problem, mesh.fractions, points, decisions)
