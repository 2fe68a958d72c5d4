"""The variables of a simultaneous program: what they are, and where they stand.

Beside the decisions they are, of each phase, the duration, the signals, the states and algebraic variables at the mesh
points of each realisation, and what is recorded of it; then the coefficients of the expansions. A problem without
phases is one. Realisations are coupled through the coefficients alone: every block depends on few variables, and no
entry of the Hessian on two realisations.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, final

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from aleator.design import (
    AbstractFunctional,
    AbstractIntegral,
    At,
    Expression,
    Path,
    Problem,
    Taken,
    expanded_functionals,
    integrated_paths,
    time_integrals,
)
from aleator.dynamics import AbstractScheme, phase_of
from aleator.transcription.simultaneous._mesh import Mesh
from aleator.transcription.simultaneous._pointwise import Pointwise, functionals_in
from aleator.transcription.simultaneous._shapes import Shapes, apart
from aleator.uncertainty import placements


class PhaseVariables(NamedTuple):
    """The variables of a phase by what they are: their numbers, or their values.

    - `duration`: shape (1, 1), or (realisations, 1) where an event ends each; `signals`: (sides of mesh points,
      signals);
    - `states`: (realisations, mesh points, states); `algebraic`: (realisations, sides of mesh points, algebraic
      variables);
    - `integrals`: from the beginning to the end of each interval, shape (realisations, intervals, ...): summed one by
      one, because a row of all would couple all points, and a factorisation would fill;
    - `paths`, `ends`, `composed`: what is recorded of each realisation, the first axis; of `paths` the second is that
      of `PhaseLayout.recorded`;
    - `nodes`: what is recorded of each realisation at instants and in the middles between, the second axis.
    """

    duration: Any
    signals: Any
    states: Any
    algebraic: Any
    integrals: Any
    paths: Any
    ends: Any
    composed: Any
    nodes: Any


class Variables(NamedTuple):
    """The variables of a program by what they are: their numbers, or their values.

    - `decisions`: shape (n,); `phases`: those of each; `totals`: of expressions that are integrated over time;
    - `coefficients`: of each functional that is expanded, shape (terms, ...), then of those whose statistics are
      integrated over time, shape (terms, nodes, ...).
    """

    decisions: Any
    phases: list[PhaseVariables]
    totals: Any
    coefficients: list[Any]


@final
@dataclass(frozen=True)
class Plan:
    """What the layout of a program follows from, beside its problem.

    - `meshes`: of each phase, all of one scheme; `scheme`: of the first meshes;
    - `points`, `scenarios`: how many collocation points there are, and realisations at which the worst case is held;
    - `terms`: of the expansions;
    - `is_everywhere`: whether limits over time hold at all points of the meshes, or at the instants of the grid alone;
    - `is_affine`: whether signals and durations depend on the decisions in an affine way.
    """

    meshes: tuple[Mesh, ...]
    scheme: AbstractScheme
    points: int
    scenarios: int
    terms: int
    is_everywhere: bool
    is_affine: bool

    @property
    def realisations(self) -> int:
        """How many there are: the collocation points, then the scenarios."""
        return self.points + self.scenarios


@final
@dataclass(frozen=True)
class PhaseLayout:
    """A phase on its mesh, and what is recorded of it.

    - `composed`: the shapes of functionals of histories and integrals;
    - `recorded`: where paths are recorded, as fractions of the duration.
    """

    mesh: Mesh
    pointwise: Pointwise
    shapes: Shapes
    composed: tuple[tuple[int, ...], ...]
    recorded: Float[np.ndarray, " recorded"]

    @classmethod
    def of(cls, pointwise: Pointwise, mesh: Mesh, is_everywhere: bool) -> "PhaseLayout":
        """That of a phase; `is_everywhere`: see `Plan`."""
        shapes = pointwise.shapes()
        if not mesh.scheme.has_algebraic_variables:
            shapes = replace(shapes, algebraic=0)
        composed = tuple(_shape(one, pointwise, shapes) for one in pointwise.composed)
        return cls(mesh, pointwise, shapes, composed, mesh.fractions if is_everywhere else pointwise.grid.fractions)

    @property
    def name(self) -> str:
        """That of the phase; empty for a problem without phases."""
        return self.pointwise.phase

    def sizes(self, every: int) -> PhaseVariables:
        """The shapes of its variables, for so many realisations."""
        mesh, shapes, pointwise = self.mesh, self.shapes, self.pointwise
        return PhaseVariables(
            duration=(every if pointwise.is_open else 1, 1),
            signals=(len(mesh.sides), shapes.signals),
            states=(every, len(mesh.fractions), shapes.states),
            algebraic=(every, len(mesh.sides), shapes.algebraic),
            integrals=(every, len(mesh.lengths), sum(map(math.prod, shapes.integrals))),
            paths=(every, len(self.recorded), shapes.size(pointwise.paths)),
            ends=(every, shapes.size(pointwise.ends)),
            composed=(every, sum(map(math.prod, self.composed))),
            nodes=(every, 2 * pointwise.grid.steps + 1, shapes.size(pointwise.nodes)),
        )


@final
@dataclass(frozen=True)
class Layout:
    """Where the variables of a program stand, and what is recorded of its problem."""

    plan: Plan
    phases: tuple[PhaseLayout, ...]
    sizes: Variables

    @classmethod
    def of(cls, problem: Problem, plan: Plan) -> "Layout":
        """That of a problem."""
        each = zip(Pointwise.each(problem), plan.meshes, strict=True)
        phases = tuple(PhaseLayout.of(pointwise, mesh, plan.is_everywhere) for pointwise, mesh in each)
        sizes = Variables(
            decisions=(problem.placements.size,),
            phases=[one.sizes(plan.realisations) for one in phases],
            totals=(len(integrals_over_time(problem)),),
            coefficients=[],
        )
        layout = cls(plan, phases, sizes)
        samples = layout.samples(layout.numbers)
        every = [*(samples[one] for one in layout.expanded), *layout.integrated(layout.numbers).values()]
        terms = [(plan.terms, *one.shape[1:]) for one in every]
        return cls(plan, phases, sizes._replace(coefficients=terms))

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.phases[0].pointwise.problem

    def phase(self, name: str) -> PhaseLayout:
        """That of the phase that a name is in; the only one of a problem without phases."""
        return next(one for one in self.phases if one.name in ("", phase_of(name)))

    @property
    def expanded(self) -> tuple[AbstractFunctional, ...]:
        """The functionals whose coefficients are variables."""
        return expanded_functionals(self.problem.expressions)

    @property
    def count(self) -> int:
        """How many variables there are."""
        return sum(map(math.prod, _leaves(self.sizes)))

    @cached_property
    def numbers(self) -> Variables:
        """The numbers of all variables."""
        return self.view(np.arange(self.count))

    def view(self, variables: Any) -> Variables:
        """The variables of a point by what they are."""
        structure = jax.tree.structure(self.sizes, is_leaf=_is_shape)
        return jax.tree.unflatten(structure, apart(variables, _leaves(self.sizes)))

    @cached_property
    def known(self) -> Int[np.ndarray, " known"]:
        """The numbers of the variables that follow from the decisions alone: of each phase the signals, then the
        duration, unless each realisation has its own.
        """
        parts = []
        for phase, one in zip(self.phases, self.numbers.phases, strict=True):
            parts += [one.signals.ravel(), *([] if phase.pointwise.is_open else [one.duration.ravel()])]
        return np.concatenate(parts)

    @cached_property
    def fixed(self) -> Int[np.ndarray, " fixed"]:
        """Those of them that are the same at all decisions, and so no variables of the program. Conditions on
        derivatives of signals depend on the duration.
        """
        parts = [np.zeros(0, dtype=int)]
        for phase, one in zip(self.phases, self.numbers.phases, strict=True):
            own = self.problem.simulation.of(f"{phase.name}.")
            is_timed = phase.pointwise.is_open or bool(placements(own.grid).decisions)
            is_decided = phase.pointwise.signals.are_own or bool(placements((own.inputs, own.grid)).decisions)
            parts += [] if is_decided else [one.signals.ravel()]
            parts += [] if is_timed else [one.duration.ravel()]
        return np.concatenate(parts)

    @cached_property
    def stages(self) -> tuple[np.ndarray, ...]:
        """The numbers of the variables that follow from others: signals and durations; then, from states and integrals,
        what is recorded; functionals composed of that; coefficients; integrals over time.
        """
        one = self.numbers
        recorded = [part.ravel() for phase in one.phases for part in (phase.paths, phase.ends, phase.nodes)]
        return (
            self.known,
            np.concatenate(recorded),
            np.concatenate([phase.composed.ravel() for phase in one.phases]),
            np.concatenate([np.zeros(0, dtype=int), *map(np.ravel, one.coefficients)]),
            one.totals,
        )

    def samples(self, variables: Variables) -> dict[AbstractFunctional, Any]:
        """Each functional on every realisation, shape (realisations, ...)."""
        samples = dict[AbstractFunctional, Any]()
        for phase, own in zip(self.phases, variables.phases, strict=True):
            pointwise, shapes = phase.pointwise, phase.shapes
            samples |= zip(pointwise.composed, apart(own.composed, phase.composed), strict=True)
            paths, ends = shapes.by_name(pointwise.paths, own.paths), shapes.by_name(pointwise.ends, own.ends)
            for one in functionals_in(phase.name, self.problem):
                if one not in samples:
                    samples[one] = (paths if isinstance(one, Path) else ends)[one.output]
        return samples

    def integrated(self, variables: Variables) -> dict[AbstractFunctional, Any]:
        """The paths whose statistics are integrated over time, of a problem without phases: their values, shape
        (realisations, nodes, ...).
        """
        (first, *_), (own, *_) = self.phases, variables.phases
        nodes = first.shapes.by_name(first.pointwise.nodes, own.nodes)
        return {one: nodes[one.output] for one in integrated_paths(self.problem.expressions)}

    def between(self, variables: Variables) -> dict[AbstractFunctional, Any]:
        """The coefficients of these paths, shape (terms, nodes, ...)."""
        paths = integrated_paths(self.problem.expressions)
        return dict(zip(paths, variables.coefficients[len(self.expanded) :], strict=True))

    def coefficients(self, variables: Variables) -> dict[AbstractFunctional, Any]:
        """The coefficients of each functional that is expanded, shape (terms, ...)."""
        return dict(zip(self.expanded, variables.coefficients, strict=False))


def _is_shape(node: Any) -> bool:
    return type(node) is tuple


def _leaves(sizes: Variables) -> list[tuple[int, ...]]:
    return jax.tree.leaves(sizes, is_leaf=_is_shape)


def integrals_over_time(problem: Problem) -> tuple[Expression, ...]:
    """The expressions that are integrated over time in a problem's, in the order of evaluation."""
    return tuple(inner for one in problem.expressions for inner in time_integrals(one))


def _shape(functional: AbstractFunctional, pointwise: Pointwise, shapes: Shapes) -> tuple[int, ...]:
    """The shape of a functional that is composed of others."""
    if isinstance(functional, At):
        return ()
    if isinstance(functional, AbstractIntegral):
        return shapes.integrals[pointwise.integrals.index(functional)]
    instants = pointwise.grid.steps + 1

    def evaluated(history: dict[str, Float[Array, "instants ..."]]) -> Array:
        return functional.evaluate(Taken(history, {}), pointwise.grid)

    histories = {name: jax.ShapeDtypeStruct((instants, *shapes.outputs[name]), float) for name in functional.outputs}
    return jax.eval_shape(evaluated, histories).shape
