"""A problem as a simultaneous program: the states of every realisation are variables, tied by a scheme.

Each phase has a mesh, and the states with which it begins are tied to those with which the phase before it ends.

Nothing is simulated while it is solved (dissertation, section 3.3; SimNLP, equations 95 and 123): so systems that are
unstable, stiff or held within bounds can be designed that cannot be simulated at every decision on the way.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Float, Int
from typing_extensions import override

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator.design import (
    AbstractFunctional,
    Problem,
    expanded_functionals,
    functionals_of,
    integrated_paths,
    statistics_in,
)
from aleator.dynamics import AbstractCollocation, named
from aleator.ensemble import inputs_at, listed
from aleator.nlp import HELD
from aleator.solution import Costates, MeshError, States, Switching
from aleator.statistics import Mean
from aleator.transcription._abstract import AbstractTranscribed, Meaning, Remembered
from aleator.transcription._discretised import Discretised, Scenarios
from aleator.transcription._expansions import ExpansionScope
from aleator.transcription.simultaneous._costates import adjoint
from aleator.transcription.simultaneous._evaluations import affine_signals, first_crossing
from aleator.transcription.simultaneous._layout import Layout, PhaseLayout, Plan
from aleator.transcription.simultaneous._magnitudes import scales
from aleator.transcription.simultaneous._mesh import Mesh, followed, joined, whole_parts
from aleator.transcription.simultaneous._pointwise import Pointwise
from aleator.transcription.simultaneous._program import Assembled, program_of
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
from aleator.transcription.simultaneous._shapes import apart
from aleator.transcription.simultaneous._starts import (
    Course,
    Start,
    direction_of,
    levels_at,
    started,
    state_shapes,
)

# Steps of a simulation for each step in an interval of a mesh, if it has no more points inside.
_FINER = 2
# So many meshes at most, and variables of the last: where something jumps inside, no mesh would ever be fine enough.
_MOST_MESHES, _MOST_VARIABLES = 8, 1_000_000
# A realisation that lasts for a smaller part of the latest time has not left its start.
_SHORTEST = 1e-6


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

    def on(
        self,
        meshes: tuple[Mesh, ...],
        start: tuple[np.ndarray, Sequence[Course]] | None = None,
        before: Assembled | None = None,
    ) -> "SimultaneouslyTranscribed":
        """The program on meshes, starting at some decisions and states, or where all programs of the problem do.

        - `before`: that of the same equations on other meshes.
        """
        problem, scenarios = self.problem, self.scenarios
        _, collocation, constants = self.discretised
        points, fit = np.asarray(collocation.points), np.asarray(collocation.pseudo_inverse)
        every = points if scenarios is None else np.concatenate([points, scenarios.points])
        is_everywhere = np.isfinite(self.goal.error) and any(one.is_path for one in problem.constraints)
        counts = len(points), len(every) - len(points), len(fit)
        signals = [affine_signals(*each) for each in zip(Pointwise.each(problem), meshes, strict=True)]
        affine = [one for one in signals if one is not None]
        is_affine = len(affine) == len(signals)
        layout = Layout.of(problem, Plan(meshes, self.goal.schemes[0], *counts, is_everywhere, is_affine))
        affine = affine if is_affine else []
        assembled = Assembled.of(layout, self.traced, self.equations, constants, every, fit, affine, before)
        if start is None:
            decisions = self.begins.decisions(problem)
            start = decisions, self.begins.courses(problem, _fractions(layout), every, decisions)
        first = started(self.traced, layout, assembled, every, *start)
        program, sizes = program_of(problem, scenarios, layout, assembled, first)
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
        courses = self.recipe.begins.courses(self.problem, _fractions(self.layout), self.points, decisions)
        return started(self.traced, self.layout, self.assembled, self.points, decisions, courses)

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
        fitted = {one: self.collocation.coefficients(samples[one][:count]) for one in expanded_functionals(expressions)}
        scope = ExpansionScope(fitted, self.constants, dict)
        functionals = functionals_of(expressions)
        return Meaning(
            decisions=variables.decisions.copy(),
            objective=evaluation.objective,
            constraints=[evaluation.constraints[one] for one in self.rows],
            samples=tuple(samples[one][:count] for one in functionals),
            tangents=(None,) * len(functionals),
            statistics=tuple(np.asarray(one.evaluate(scope)) for one in statistics_in(expressions)),
        )

    @override
    def times(self, point: Float[np.ndarray, " variables"]) -> Float[np.ndarray, " instants"]:
        return self._times(point, [one.pointwise.grid.fractions for one in self.layout.phases])

    @override
    def limited(self, path: str) -> Float[np.ndarray, " limited"]:
        return self.layout.phase(path).recorded

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
        return replace(recipe.on(self.layout.plan.meshes), meshes=self.meshes)

    @property
    @override
    def fineness(self) -> int:
        phases = self.layout.phases
        scheme = phases[0].mesh.scheme
        steps = max(_FINER * scheme.rate.steps, len(scheme.points) - 2)
        return steps * max(round(1 / (one.mesh.lengths.min() * one.pointwise.grid.steps)) for one in phases)

    @override
    def meshes_at(self, point: Float[np.ndarray, " variables"]) -> tuple[MeshError, ...]:
        return *self.meshes, self._reported(self._drifts(point), point)

    @override
    def crossed_at(self, point: Float[np.ndarray, " variables"]) -> str:
        values = self.layout.view(point)
        for phase, own in zip(self.layout.phases, values.phases, strict=True):
            if not phase.pointwise.is_open:
                continue
            fractions, grid = phase.mesh.fractions, phase.pointwise.grid
            course, direction = Course(own.states, own.duration), direction_of(self.problem, phase.name)
            levels = levels_at((self.traced, phase.name), self.points, values.decisions, fractions, course)
            for germ, (lasts,), one in zip(self.points, own.duration, levels, strict=True):
                before = first_crossing(one[:-1], fractions[:-1], direction)
                lasts_at_all = lasts > _SHORTEST * float(grid.duration)
                if before is None and direction * one[-2] <= 0 and lasts_at_all:
                    continue
                numbers = listed(inputs_at(self.places, germ, jax_array(values.decisions)))
                first, last = (float(grid.t_start) + share * lasts for share in (before or 0.0, 1.0))
                said = "is crossed the other way there" if lasts_at_all else "is where it starts"
                said = said if before is None else f"first happens at t = {first:.4g} s"
                return (
                    f"the realisation{' with ' if numbers else ''}{numbers} ends at t = {last:.4g} s, and "
                    f"'{grid.until}' {said}: start nearer to its first crossing, al.Simultaneous(guess=...), or "
                    "simulate, al.Sequential()"
                )
        return ""

    @override
    def refined(
        self, point: Float[np.ndarray, " variables"]
    ) -> "tuple[SimultaneouslyTranscribed, Float[np.ndarray, ' variables']] | None":
        drifts, meshes = self._drifts(point), self.layout.plan.meshes
        error = self._reported(drifts, point)
        if error.is_met or len(self.meshes) + 1 == _MOST_MESHES:
            return None
        scheme, parts = refinement(self.recipe.goal, meshes[0].scheme, drifts)
        each = zip(meshes, parts, strict=True)
        finer = joined(self.problem, [one.refined(scheme, whole_parts(self.problem, some)) for one, some in each])
        points, before = (sum(len(one.fractions) for one in some) for some in (finer, meshes))
        if self.layout.count * points > _MOST_VARIABLES * before:
            return None
        values = self.layout.view(point)
        courses = [self._course_on(point, i, one.fractions) for i, one in enumerate(finer)]
        problem, decisions = followed(self.problem, values.decisions, finer)
        traced = numbers_to_arrays(problem)
        is_same = _has_same_equations(problem, self.layout.phases)
        equations, before = (self.recipe.equations, self.assembled) if is_same else (traced, None)
        recipe = self.recipe._replace(problem=problem, traced=traced, equations=equations)
        transcribed = recipe.on(finer, (decisions, courses), before)
        return replace(transcribed, meshes=(*self.meshes, error)), transcribed.program.start

    @override
    def states_at(self, point: Float[np.ndarray, " variables"]) -> States:
        values, durations = dict[str, np.ndarray](), dict[str, np.ndarray]()
        for phase, own in zip(self.layout.phases, self.layout.view(point).phases, strict=True):
            values |= self._by_state(phase, own.states)
            durations |= {phase.name: own.duration.copy()} if phase.pointwise.is_open else {}
        fractions = _fractions(self.layout)
        return States(self._times(point, fractions), self.points, values, self._places(fractions), durations)

    @override
    def costates_at(
        self, point: Float[np.ndarray, " variables"], multipliers: Float[np.ndarray, " rows"]
    ) -> tuple[Costates, Switching] | tuple[None, None]:
        by_state, by_signal = dict[str, np.ndarray](), dict[str, np.ndarray]()
        for i, phase in enumerate(self.layout.phases):
            duals, signals = adjoint(self.layout, self.assembled, point, multipliers, i), phase.pointwise.signals.shapes
            by_state |= self._by_state(phase, duals.states)
            # What an integral over time of a statistic adds stands in no rate.
            if not integrated_paths(self.problem.expressions):
                each = zip(signals, apart(duals.signals, list(signals.values())), strict=True)
                by_signal |= named({phase.name: dict(each)})
        meshes = self.layout.plan.meshes
        nodes, weighed = [np.array(one.nodes) for one in meshes], [one.places[one.weighed, 0] for one in meshes]
        return (
            Costates(self._times(point, nodes), self.points, by_state, self._places(nodes)),
            Switching(self._times(point, weighed), by_signal, self._places(weighed)),
        )

    def _by_state(self, phase: PhaseLayout, rows: Float[np.ndarray, "realisations places states"]) -> dict[str, Any]:
        """States side by side, or what there is one of for each, by the names of the states."""
        shapes = state_shapes(self.problem, phase.name)
        return named({phase.name: dict(zip(shapes, apart(rows, list(shapes.values())), strict=True))})

    def _places(self, fractions: Sequence[Float[np.ndarray, " _"]]) -> dict[str, slice]:
        """Where those of each phase are if all stand one after the other; empty if there are no phases."""
        ends = np.cumsum([0, *map(len, fractions)]).tolist()
        each = zip(self.layout.phases, ends, ends[1:], strict=False)
        return {phase.name: slice(first, last) for phase, first, last in each if phase.name}

    def _times(
        self, point: Float[np.ndarray, " variables"], fractions: Sequence[Float[np.ndarray, " _"]]
    ) -> Float[np.ndarray, " times"]:
        """Fractions of the durations of all phases, one after the other, as times, s: means of the realisations."""
        begin, every = float(self.layout.phases[0].pointwise.grid.t_start), []
        for phase, own, some in zip(self.layout.phases, self.layout.view(point).phases, fractions, strict=True):
            duration = own.duration[0, 0]
            if phase.pointwise.is_open:
                coefficients = self.collocation.coefficients(jax_array(own.duration[: len(self.collocation.points), 0]))
                duration = Mean().of(coefficients, ())
            every.append(begin + some * float(duration))
            begin += float(duration)
        return np.concatenate(every)

    def _rates(
        self, point: Float[np.ndarray, " variables"], phase: int
    ) -> Float[np.ndarray, "realisations asked rates"]:
        return self.assembled.blocks(point)[0][self.assembled.rates[phase]]

    def _rates_at(self, point: Float[np.ndarray, " variables"], phase: int) -> Rates:
        return partial(state_rates, self.traced, self.layout, self.assembled, self.points, point, phase)

    def _sizes(self, point: Float[np.ndarray, " variables"]) -> Float[np.ndarray, " variables"]:
        """How large each kind of variable is at a point."""
        typical = self.program.variable_scale[self.decided]
        return scales(self.layout, self.assembled.rows.ties, point, self.assembled(point), typical)

    def _course_on(self, point: Float[np.ndarray, " variables"], phase: int, at: Float[np.ndarray, " n"]) -> Course:
        """The states of a phase at some fractions of its duration."""
        mesh, own = self.layout.phases[phase].mesh, self.layout.view(point).phases[phase]
        if isinstance(mesh.scheme, AbstractCollocation):
            states = states_on(mesh, at, own.states, self._rates(point, phase))
        else:
            states = segment_states(mesh, self._rates_at(point, phase), own.states, at)
        return Course(states, own.duration)

    @cached_property
    def _drifts(self) -> Remembered[list[Drift]]:
        # Whether the last mesh is fine enough is asked before it is told.
        return Remembered(self._drifts_at)

    def _drifts_at(self, point: Float[np.ndarray, " variables"]) -> list[Drift]:
        """The drift of each phase."""
        drifts, values, sizes = [], self.layout.view(point).phases, self.layout.view(self._sizes(point)).phases
        for i, (phase, own, size) in enumerate(zip(self.layout.phases, values, sizes, strict=True)):
            known = phase.mesh, self._rates_at(point, i)
            if isinstance(phase.mesh.scheme, AbstractCollocation):
                drifts.append(drift_of(*known, self._rates(point, i), own.states, size.states))
            else:
                drifts.append(segment_drift(*known, own.states, size.states))
        return drifts

    def _reported(self, drifts: Sequence[Drift], point: Float[np.ndarray, " variables"]) -> MeshError:
        every, meshes = np.concatenate([one.worst for one in drifts], axis=1), self.layout.plan.meshes
        worst, _ = np.unravel_index(np.argmax(every), every.shape)
        numbers = inputs_at(self.places, self.points[worst], jax_array(self.decisions(point)))
        # One phase ends where the next one begins.
        nodes = [np.array(one.nodes[-len(one.lengths) - (i == 0) :]) for i, one in enumerate(meshes)]
        return MeshError(self._times(point, nodes), meshes[0].scheme, every, self.recipe.goal.error, numbers)


def _fractions(layout: Layout) -> list[Float[np.ndarray, " _"]]:
    """The mesh points of all phases, as fractions of their durations."""
    return [one.fractions for one in layout.plan.meshes]


def _has_same_equations(problem: Problem, before: Sequence[PhaseLayout]) -> bool:
    """Whether a problem with other controls has the rates and outputs of the one before, of signals as told."""
    return all(
        (one.is_open or not one.has_signals_inside) and one.direct.size == phase.pointwise.direct.size
        for one, phase in zip(Pointwise.each(problem), before, strict=True)
    )
