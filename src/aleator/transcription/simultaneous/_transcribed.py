"""A problem as a simultaneous program: the states of every realisation are variables, tied by a scheme.

Nothing is simulated while it is solved (dissertation, section 3.3; SimNLP, equations 95 and 123): so systems that are
unstable, stiff or held within bounds can be designed that cannot be simulated at every decision on the way.
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple, final

import jax
import numpy as np
from jaxtyping import Float, Int
from typing_extensions import override

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator.design import (
    AbstractFunctional,
    Problem,
    expanded_functionals,
    functionals_of,
    integrated_paths,
    statistics_in,
)
from aleator.dynamics import AbstractCollocation, Grid
from aleator.ensemble import inputs_at
from aleator.nlp import HELD
from aleator.solution import Costates, MeshError, States, Switching
from aleator.statistics import Constants, Mean, Std, Variance
from aleator.transcription._abstract import AbstractTranscribed, Meaning, Remembered
from aleator.transcription._discretised import Discretised
from aleator.transcription._expansions import ExpansionScope
from aleator.transcription._scenarios import Scenarios
from aleator.transcription.simultaneous._assembly import Fixed
from aleator.transcription.simultaneous._costates import adjoint
from aleator.transcription.simultaneous._layout import Layout, Plan, are_affine
from aleator.transcription.simultaneous._mesh import Mesh, followed, whole_parts
from aleator.transcription.simultaneous._pointwise import Pointwise, apart
from aleator.transcription.simultaneous._program import Assembled, program_of, scales
from aleator.transcription.simultaneous._refinement import (
    Drift,
    Goal,
    Rates,
    drift_of,
    refinement,
    segment_drift,
    segment_states,
    state_rates,
    states_on,
)
from aleator.transcription.simultaneous._starts import Start, started, state_shapes

# Steps of a simulation for each step in an interval of a mesh, if it has no more points inside.
_FINER = 2
# So many meshes at most, and variables of the last: where something jumps inside, no mesh would ever be fine enough.
_MOST_MESHES, _MOST_VARIABLES = 8, 1_000_000


def _taken(problem: Problem, constants: Constants, coefficients: list[jax.Array]) -> tuple[jax.Array, ...]:
    """Every statistic that stands in a problem, from the coefficients of its expansions."""
    each = zip(expanded_functionals(problem.expressions), coefficients, strict=True)
    scope = ExpansionScope(dict(each), constants, {})
    scope.take_together(problem.expressions)
    return tuple(scope.statistic(one.functionals, one.kind) for one in statistics_in(problem.expressions))


TAKEN = Compiled(_taken, use=Use.ONCE)


class Recipe(NamedTuple):
    """What a program is made from, beside a mesh.

    - `traced`: the problem with its numbers as arrays; `equations`: the same as it is on the first mesh, with its rates
      and outputs, which are compiled once;
    - `goal`: what is asked of meshes; `begins`: where programs of the problem start.
    """

    problem: Problem
    traced: Problem
    equations: Problem
    discretised: Discretised
    scenarios: Scenarios | None
    goal: Goal
    begins: Start

    def on(self, mesh: Mesh, start: tuple[np.ndarray, np.ndarray] | None = None) -> "SimultaneouslyTranscribed":
        """The program on a mesh, starting at some decisions and states, or where all programs of the problem do."""
        problem, scenarios = self.problem, self.scenarios
        _, collocation, constants = self.discretised
        points, fit = np.asarray(collocation.points), np.asarray(collocation.pseudo_inverse)
        every = points if scenarios is None else np.concatenate([points, scenarios.points])
        pointwise = Pointwise.of(problem)
        is_everywhere = np.isfinite(self.goal.error) and any(one.is_path for one in problem.constraints)
        counts = len(points), len(every) - len(points), len(fit)
        plan = Plan(mesh, self.goal.schemes[0], *counts, is_everywhere, are_affine(pointwise, mesh))
        layout, fixed = Layout.of(problem, plan), Fixed.of(pointwise)
        assembled = Assembled.of(layout, self.traced, self.equations, constants, every, fit, fixed)
        if start is None:
            decisions = self.begins.decisions(problem)
            start = decisions, self.begins.states(problem, mesh.fractions, every, decisions)
        first = started(self.traced, layout, assembled, every, *start)
        program, sizes = program_of(problem, scenarios, layout, assembled, fixed, first)
        return SimultaneouslyTranscribed(
            problem,
            self.traced,
            self.discretised,
            program,
            assembled.rows.own,
            sizes,
            scenarios,
            layout=layout,
            assembled=assembled,
            recipe=self,
        )


@final
@dataclass(frozen=True, kw_only=True)
class SimultaneouslyTranscribed(AbstractTranscribed):
    """A problem as a sparse program in its decisions and in the states of all realisations at the points of a mesh.

    - `recipe`: what it is made from on any mesh; `meshes`: those before.
    """

    layout: Layout
    assembled: Assembled
    recipe: Recipe
    meshes: tuple[MeshError, ...] = ()

    @property
    @override
    def decided(self) -> Int[np.ndarray, " n"]:
        return self.layout.numbers.decisions

    @override
    def point(self, decisions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " variables"]:
        states = self.recipe.begins.states(self.problem, self.layout.plan.mesh.fractions, self.points, decisions)
        return started(self.traced, self.layout, self.assembled, self.points, decisions, states)

    @override
    def at(self, point: Float[np.ndarray, " variables"]) -> Meaning:
        return self._remembered(point)

    @cached_property
    def _remembered(self) -> Remembered[Meaning]:
        return Remembered(self._meaning)

    def _meaning(self, point: Float[np.ndarray, " variables"]) -> Meaning:
        evaluation, variables = self.assembled(point), self.layout.view(point)
        every, numbers = (self._at_instants(self.layout.samples(one)) for one in (variables, self.layout.numbers))
        count, expressions = len(self.collocation.points), self.problem.expressions
        sizes = self._sizes(point)
        samples = {one: self._apart(values, numbers[one], sizes) for one, values in every.items()}
        fitted = [
            self.collocation.coefficients(jax_array(samples[one][:count])) for one in expanded_functionals(expressions)
        ]
        # NumPy computes moments, so that only other statistics take a program.
        known = all(isinstance(one.kind, Mean | Variance | Std) for one in statistics_in(expressions))
        taken = (_taken if known else TAKEN)(self.traced, self.constants, fitted)
        functionals = functionals_of(expressions)
        return Meaning(
            decisions=variables.decisions.copy(),
            objective=evaluation.objective,
            constraints=[evaluation.constraints[one] for one in self.rows],
            samples=tuple(samples[one][:count] for one in functionals),
            tangents=(None,) * len(functionals),
            statistics=tuple(np.asarray(one) for one in taken),
        )

    @override
    def times(self, point: Float[np.ndarray, " variables"]) -> Float[np.ndarray, " instants"]:
        assert isinstance(self.problem.grid, Grid)
        return self._instants(point, self.problem.grid.fractions)

    @override
    def limited(self, path: str) -> Float[np.ndarray, " limited"]:
        del path
        return self.layout.plan.recorded(self.layout.pointwise.grid)

    def _at_instants(self, samples: dict[AbstractFunctional, Any]) -> dict[AbstractFunctional, Any]:
        """Functionals on every realisation, paths at the instants of the grid alone."""
        return {one: values[:, self.declared(one.place)] if one.is_path else values for one, values in samples.items()}

    @staticmethod
    def _apart(samples: np.ndarray, numbers: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """Samples without what their equations leave open: realisations that differ by less are the same."""
        open_ = HELD * sizes[numbers].max(axis=0)
        middle = samples.mean(axis=0)
        return np.where(np.abs(samples - middle).max(axis=0) <= open_, middle, samples)

    @override
    def at_scenarios(self, scenarios: Scenarios) -> "SimultaneouslyTranscribed":
        discretised = self.discretised.at_scenarios(scenarios)
        recipe = self.recipe._replace(discretised=discretised, scenarios=scenarios)
        return replace(recipe.on(self.layout.plan.mesh), meshes=self.meshes)

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
        scheme, parts = refinement(self.recipe.goal, mesh.scheme, drift)
        finer = mesh.refined(scheme, whole_parts(self.problem, parts))
        if self.layout.count * len(finer.fractions) > _MOST_VARIABLES * len(mesh.fractions):
            return None
        values = self.layout.view(point)
        states = self._states_on(point, finer.fractions)
        problem, decisions = followed(self.problem, values.decisions, finer.nodes)
        traced = numbers_to_arrays(problem)
        equations = self.recipe.equations if _has_same_equations(problem, self.layout.pointwise) else traced
        recipe = self.recipe._replace(problem=problem, traced=traced, equations=equations)
        transcribed = recipe.on(finer, (decisions, states))
        return replace(transcribed, meshes=(*self.meshes, error)), transcribed.program.start

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
        duals, mesh = adjoint(self.layout, self.assembled, point, multipliers), self.layout.plan.mesh
        states, signals = state_shapes(self.problem), self.layout.pointwise.signals.shapes
        nodes, weighed = (self._instants(point, at) for at in (np.array(mesh.nodes), mesh.places[mesh.weighed, 0]))
        by_state = dict(zip(states, apart(duals.states, list(states.values())), strict=True))
        # What an integral over time of a statistic adds stands in no rate.
        is_whole = not integrated_paths(self.problem.expressions)
        by_signal = dict(zip(signals, apart(duals.signals, list(signals.values())), strict=True)) if is_whole else {}
        return Costates(nodes, self.points, by_state), Switching(weighed, by_signal)

    def _instants(
        self, point: Float[np.ndarray, " variables"], fractions: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Fractions of the duration as times, s."""
        return float(self.layout.pointwise.grid.t_start) + fractions * float(self.layout.view(point).duration[0])

    def _rates(self, point: Float[np.ndarray, " variables"]) -> Float[np.ndarray, "realisations asked rates"]:
        return self.assembled.blocks(point)[0][self.assembled.rates]

    def _rates_at(self, point: Float[np.ndarray, " variables"]) -> Rates:
        return partial(state_rates, self.traced, self.layout, self.assembled, self.points, self.layout.view(point))

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
        return segment_states(layout, self._rates_at(point), point, fractions)

    @cached_property
    def _drift(self) -> Remembered[Drift]:
        # Whether the last mesh is fine enough is asked before it is told.
        return Remembered(self._drift_at)

    def _drift_at(self, point: Float[np.ndarray, " variables"]) -> Drift:
        layout, sizes = self.layout, self._sizes(point)
        if isinstance(layout.plan.mesh.scheme, AbstractCollocation):
            return drift_of(layout, self._rates_at(point), self._rates(point), point, sizes)
        return segment_drift(layout, self._rates_at(point), point, sizes)

    def _reported(self, drift: Drift, point: Float[np.ndarray, " variables"]) -> MeshError:
        drifts, mesh, goal = drift.errors.max(axis=2, initial=0.0), self.layout.plan.mesh, self.recipe.goal.error
        worst, _ = np.unravel_index(np.argmax(drifts), drifts.shape)
        numbers = inputs_at(self.places, self.points[worst], jax_array(self.decisions(point)))
        return MeshError(self._instants(point, np.array(mesh.nodes)), mesh.scheme, drifts, goal, numbers)


def _has_same_equations(problem: Problem, before: Pointwise) -> bool:
    """Whether a problem with other controls has the rates and outputs of the one before, of signals as told."""
    pointwise = Pointwise.of(problem)
    return not pointwise.is_random and pointwise.direct.size == before.direct.size
