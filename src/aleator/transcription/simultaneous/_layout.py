"""The variables of a simultaneous program: what they are, where they stand, and how signals depend on decisions.

Beside the decisions they are the duration, the signals, the states and algebraic variables at the mesh points of each
realisation, what is recorded of it, and the coefficients of the expansions. Realisations are coupled through the last
alone: every block depends on few variables, and no entry of the Hessian on two realisations.

Signals are nearly always affine in the decisions, as splines are in their control points: at an instant each depends on
few decisions, by constant derivatives. So long signals stay sparse. Whether they are affine follows from the traced
equations, never from values.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Float

from aleator._core.compilation import Compiled, Use
from aleator.design import (
    AbstractFunctional,
    AbstractIntegral,
    Expression,
    Path,
    Problem,
    Taken,
    expanded_functionals,
    functionals_of,
    integrated_paths,
    time_integrals,
)
from aleator.dynamics import AbstractScheme, Grid
from aleator.nlp import SparseMatrix
from aleator.transcription.simultaneous._mesh import Mesh
from aleator.transcription.simultaneous._pointwise import Pointwise, Shapes, apart

# Decisions by which signals are differentiated at once: all of them would take a dense matrix.
_AT_ONCE = 64
# Places at which the model is evaluated at once beside its blocks.
_PLACES = 256


class Variables(NamedTuple):
    """The variables of a program by what they are: their numbers, or their values.

    - `decisions`: shape (n,); `duration`: (1,); `signals`: (sides of mesh points, signals);
    - `states`: (realisations, mesh points, states); `algebraic`: (realisations, sides of mesh points, algebraic
      variables);
    - `integrals`: from the beginning to the end of each interval, shape (realisations, intervals, ...): summed one by
      one, because a row of all would couple all points, and a factorisation would fill;
    - `paths`, `ends`, `composed`: what is recorded of each realisation, the first axis; of `paths` the second is that
      of `Plan.recorded`;
    - `nodes`: what is recorded of each realisation at instants and in the middles between, the second axis;
    - `totals`: of expressions that are integrated over time;
    - `coefficients`: of each functional that is expanded, shape (terms, ...), then of those whose statistics are
      integrated over time, shape (terms, nodes, ...).
    """

    decisions: Any
    duration: Any
    signals: Any
    states: Any
    algebraic: Any
    integrals: Any
    paths: Any
    ends: Any
    composed: Any
    nodes: Any
    totals: Any
    coefficients: tuple[Any, ...]


# How many of the fields of `Variables` are one array.
_ALONE = Variables._fields.index("coefficients")


@final
@dataclass(frozen=True)
class Plan:
    """What the layout of a program follows from, beside its problem.

    - `scheme`: of the first mesh;
    - `points`, `scenarios`: how many collocation points there are, and realisations at which the worst case is held;
    - `terms`: of the expansions;
    - `is_everywhere`: whether limits over time hold at all points of the mesh, or at the instants of the grid alone;
    - `is_affine`: whether signals and duration depend on the decisions in an affine way.
    """

    mesh: Mesh
    scheme: AbstractScheme
    points: int
    scenarios: int
    terms: int
    is_everywhere: bool
    is_affine: bool

    def recorded(self, grid: Grid) -> Float[np.ndarray, " recorded"]:
        """Where paths are recorded, as fractions of the duration."""
        return self.mesh.fractions if self.is_everywhere else grid.fractions

    @property
    def realisations(self) -> int:
        """How many there are: the collocation points, then the scenarios."""
        return self.points + self.scenarios


@final
@dataclass(frozen=True)
class Layout:
    """Where the variables of a program stand, and what is recorded of its problem."""

    plan: Plan
    pointwise: Pointwise
    shapes: Shapes
    composed: tuple[tuple[int, ...], ...]
    sizes: Variables

    @classmethod
    def of(cls, problem: Problem, plan: Plan) -> "Layout":
        """That of a problem."""
        pointwise = Pointwise.of(problem)
        shapes = pointwise.shapes()
        if not plan.mesh.scheme.has_algebraic_variables:
            shapes = replace(shapes, algebraic=0)
        composed = tuple(_shape(one, pointwise, shapes) for one in pointwise.composed)
        every, points, instants = plan.realisations, len(plan.mesh.fractions), pointwise.grid.steps + 1
        recorded = len(plan.recorded(pointwise.grid))
        sizes = Variables(
            decisions=(problem.placements.size,),
            duration=(1,),
            signals=(len(plan.mesh.sides), shapes.signals),
            states=(every, points, shapes.states),
            algebraic=(every, len(plan.mesh.sides), shapes.algebraic),
            integrals=(every, len(plan.mesh.lengths), sum(map(math.prod, shapes.integrals))),
            paths=(every, recorded, shapes.size(pointwise.paths)),
            ends=(every, shapes.size(pointwise.ends)),
            composed=(every, sum(map(math.prod, composed))),
            nodes=(every, 2 * instants - 1, shapes.size(pointwise.nodes)),
            totals=(len(integrals_over_time(problem)),),
            coefficients=(),
        )
        layout = cls(plan, pointwise, shapes, composed, sizes)
        samples = layout.samples(layout.numbers)
        every = [*(samples[one] for one in layout.expanded), *layout.integrated(layout.numbers).values()]
        terms = tuple((plan.terms, *one.shape[1:]) for one in every)
        return cls(plan, pointwise, shapes, composed, sizes._replace(coefficients=terms))

    @property
    def expanded(self) -> tuple[AbstractFunctional, ...]:
        """The functionals whose coefficients are variables."""
        return expanded_functionals(self.pointwise.problem.expressions)

    @property
    def count(self) -> int:
        """How many variables there are."""
        return sum(map(math.prod, _shapes_of(self.sizes)))

    @cached_property
    def numbers(self) -> Variables:
        """The numbers of all variables."""
        return self.view(np.arange(self.count))

    def view(self, variables: Any) -> Variables:
        """The variables of a point by what they are."""
        parts = apart(variables, _shapes_of(self.sizes))
        return Variables(*parts[:_ALONE], coefficients=tuple(parts[_ALONE:]))

    @cached_property
    def stages(self) -> tuple[np.ndarray, ...]:
        """The numbers of the variables that follow from others: signals and duration; then, from states and integrals,
        what is recorded; functionals composed of that; coefficients; integrals over time.
        """
        one = self.numbers
        recorded = one.paths.ravel(), one.ends.ravel(), one.nodes.ravel()
        return (
            np.append(one.signals.ravel(), one.duration),
            np.concatenate(recorded),
            one.composed.ravel(),
            np.concatenate([np.zeros(0, dtype=int), *map(np.ravel, one.coefficients)]),
            one.totals,
        )

    def samples(self, variables: Variables) -> dict[AbstractFunctional, Any]:
        """Each functional on every realisation, shape (realisations, ...)."""
        pointwise, shapes = self.pointwise, self.shapes
        samples: dict[AbstractFunctional, Any] = dict(
            zip(pointwise.composed, apart(variables.composed, self.composed), strict=True)
        )
        paths = shapes.by_name(pointwise.paths, variables.paths)
        ends = shapes.by_name(pointwise.ends, variables.ends)
        for one in functionals_of(pointwise.problem.expressions):
            if one not in samples:
                samples[one] = (paths if isinstance(one, Path) else ends)[one.output]
        return samples

    def integrated(self, variables: Variables) -> dict[AbstractFunctional, Any]:
        """The paths whose statistics are integrated over time: their values, shape (realisations, nodes, ...)."""
        nodes = self.shapes.by_name(self.pointwise.nodes, variables.nodes)
        return {one: nodes[one.output] for one in integrated_paths(self.pointwise.problem.expressions)}

    def between(self, variables: Variables) -> dict[AbstractFunctional, Any]:
        """The coefficients of these paths, shape (terms, nodes, ...)."""
        paths = integrated_paths(self.pointwise.problem.expressions)
        return dict(zip(paths, variables.coefficients[len(self.expanded) :], strict=True))

    def coefficients(self, variables: Variables) -> dict[AbstractFunctional, Any]:
        """The coefficients of each functional that is expanded, shape (terms, ...)."""
        return dict(zip(self.expanded, variables.coefficients, strict=False))


def _shapes_of(sizes: Variables) -> Sequence[tuple[int, ...]]:
    return [*sizes[:_ALONE], *sizes.coefficients]


def integrals_over_time(problem: Problem) -> tuple[Expression, ...]:
    """The expressions that are integrated over time in a problem's, in the order of evaluation."""
    return tuple(inner for one in problem.expressions for inner in time_integrals(one))


def _shape(functional: AbstractFunctional, pointwise: Pointwise, shapes: Shapes) -> tuple[int, ...]:
    """The shape of a functional that is composed of others."""
    if isinstance(functional, AbstractIntegral):
        return shapes.integrals[pointwise.integrals.index(functional)]
    instants = pointwise.grid.steps + 1

    def evaluated(history: dict[str, Float[Array, "instants ..."]]) -> Array:
        return functional.evaluate(Taken(history, {}), pointwise.grid)

    histories = {name: jax.ShapeDtypeStruct((instants, *shapes.outputs[name]), float) for name in functional.outputs}
    return jax.eval_shape(evaluated, histories).shape


def known_numbers(pointwise: Pointwise, places: Any, decisions: Float[Array, " n"]) -> Float[Array, " known"]:
    """The signals at some places, one by one, then the duration."""
    return jnp.append(pointwise.known(places, decisions).ravel(), pointwise.duration(decisions))


def are_affine(pointwise: Pointwise, mesh: Mesh) -> bool:
    """Whether the derivatives of signals and duration are the same at all decisions: no equation of theirs needs these
    any more.
    """
    one = np.zeros(pointwise.problem.placements.size)
    told = partial(known_numbers, pointwise, mesh.places)
    closed = jax.make_jaxpr(lambda x, along: jax.jvp(told, (x,), (along,))[1])(one, one)
    _, is_needed = dce_jaxpr(closed.jaxpr, [True])
    return not is_needed[0]


def _told(
    problem: Problem,
    at: tuple[Float[Array, "places 2"], Float[Array, " n"], Float[Array, "directions n"]],
) -> Float[Array, "rows known"]:
    """The signals at some places one by one, then the duration; below, their derivatives along some directions."""
    places, decisions, directions = at
    pointwise = Pointwise.of(problem)
    values, along = jax.linearize(lambda x: known_numbers(pointwise, places, x), decisions)
    return jnp.concatenate([values[None], jax.vmap(along)(directions)])


TOLD = Compiled(_told, use=Use.ONCE)


def in_chunks(places: Float[np.ndarray, "places ..."]) -> list[tuple[np.ndarray, int]]:
    """The numbers of places, as many at once on every mesh, and how many of them are not told twice."""
    firsts = range(0, len(places), _PLACES)
    return [
        (np.minimum(np.arange(first, first + _PLACES), len(places) - 1), min(_PLACES, len(places) - first))
        for first in firsts
    ]


def _told_at(
    traced: Problem, places: Float[np.ndarray, "places 2"], decisions: np.ndarray, directions: np.ndarray
) -> Float[np.ndarray, "rows known"]:
    """See `_told`, for any number of places."""
    chunks = in_chunks(places)
    told = [np.asarray(TOLD(traced, (places[which], decisions, directions))) for which, _ in chunks]
    signals = told[0].shape[1] // _PLACES
    parts = [rows[:, : count * signals] for rows, (_, count) in zip(told, chunks, strict=True)]
    return np.concatenate([*parts, told[0][:, -1:]], axis=1)


def signals_at(
    traced: Problem, places: Float[np.ndarray, "places 2"], decisions: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "places signals"]:
    """The signals at some places of the duration."""
    nowhere = np.zeros((min(_AT_ONCE, decisions.size), decisions.size))
    return _told_at(traced, places, decisions, nowhere)[0, :-1].reshape(len(places), -1)


def affine_signals(traced: Problem, layout: Layout) -> tuple[Float[np.ndarray, " known"], SparseMatrix]:
    """The signals at all mesh points, then the duration, at zero decisions, and their derivatives by the decisions.

    Where they are not affine no numbers, and no derivatives.
    """
    (decisions,), known = layout.sizes.decisions, layout.numbers.signals.size + 1
    if not layout.plan.is_affine:
        return np.zeros(0), scipy.sparse.csr_array((known, decisions))
    constant, slopes = np.zeros(known), []
    for first in range(0, decisions, _AT_ONCE):
        directions = np.eye(min(_AT_ONCE, decisions), decisions, first)
        constant, *along = _told_at(traced, layout.plan.mesh.places, np.zeros(decisions), directions)
        slopes.append(scipy.sparse.csr_array(np.stack(along[: decisions - first], axis=1)))
    return constant, scipy.sparse.hstack(slopes, format="csr")
