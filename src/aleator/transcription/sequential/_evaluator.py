"""Evaluate a problem: values and exact derivatives from compiled functions, with the latest points remembered.

Simulation takes almost all the time of an evaluation, and points are independent until coefficients are formed, which
are sums over the points. So a large problem is simulated in parts, one per core, each of which gives its share of the
coefficients, with derivatives; the rest of the work is small. A small problem is one program.
"""

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from aleator._core.arrays import jax_array
from aleator._core.compilation import Compiled, Use
from aleator._core.parallel import over_devices
from aleator.design import (
    AbstractFunctional,
    Expression,
    Problem,
    divides_steps,
    ends_by_event,
    functionals_of,
    grid_at,
)
from aleator.expansion import Collocation
from aleator.nlp import Evaluation
from aleator.statistics import Constants
from aleator.transcription._abstract import Remembered
from aleator.transcription._expansions import Terms, scope_from, seen, simulated
from aleator.transcription.sequential._affine import Anchors
from aleator.transcription.sequential._instantaneous import instantaneous, instantaneous_rows

# Fewest points per part that are worth the overhead of a time step, and fewest numbers worth that of threads.
_FEWEST_POINTS, _FEWEST_NUMBERS = 16, 200_000
# Numbers of simulations up to events that take longer to compile well than to run a few dozen times.
_FEW_NUMBERS = 20_000
# Two parts, unless there are points enough for more.
_POINTS_OF_A_PART, _MOST_PARTS = 128, 8


class Share(NamedTuple):
    """The contribution of some points.

    - `samples`: each functional at the points; `finite`: whether all of these are;
    - `tangents`: the derivatives of samples (of a path at a few instants) by the decisions that are parameters of
      distributions; None if there are no such decisions;
    - `terms`: the points' share of the terms of expressions; `slopes`: its derivatives by the decisions, along a first
      axis of each array.
    """

    samples: tuple[Float[Array, "points ..."], ...]
    finite: Bool[Array, ""]
    tangents: tuple[Float[Array, "points ... parameters"] | None, ...]
    terms: Terms
    slopes: Terms


class Combined(NamedTuple):
    """Some expressions: their values, flattened, the derivatives of these, and the statistics in each, in order."""

    values: tuple[Float[Array, " rows"], ...]
    derivatives: tuple[Float[Array, "rows n"], ...]
    statistics: tuple[tuple[Float[Array, "..."], ...], ...]


def share_of(
    problem: Problem,
    functionals: tuple[AbstractFunctional, ...],
    points: Float[Array, "points variables"],
    fit: Float[Array, "terms points"],
    scenarios: Float[Array, "scenarios variables"] | None,
    decisions: Float[Array, " n"],
) -> Share:
    """The contribution of some points, and of the scenarios of the worst case, to expressions of some functionals.

    Derivatives are computed in forward mode: few decisions, thousands of rows.
    """
    parameters = tuple(problem.placements.of_distributions.values())

    def contributed(x: Array) -> tuple[tuple[Terms, tuple], tuple]:
        samples, terms = simulated(problem, functionals, points, fit, scenarios, x)
        looked_at = [seen(values, one.is_path) for one, values in zip(functionals, samples, strict=True)]
        return (terms, tuple(looked_at) if parameters else ()), samples

    def along(direction: Array) -> tuple[Any, Any, Any]:
        return jax.jvp(contributed, (decisions,), (direction,), has_aux=True)

    # Tangents along the first axis: along the last one, inner loops would run over the shortest of all axes.
    (terms, _), (slopes, looked_at), samples = jax.vmap(along, out_axes=(None, 0, None))(jnp.eye(decisions.size))
    of_distributions = tuple(jnp.moveaxis(one, 0, -1)[..., jnp.array(parameters)] for one in looked_at)
    finite = jnp.array([jnp.isfinite(one).all() for one in samples]).all()
    return Share(samples, finite, of_distributions or (None,) * len(functionals), terms, slopes)


def combined(
    problem: Problem,
    expressions: tuple[Expression, ...],
    constants: Constants,
    terms: Terms,
    slopes: Terms,
    decisions: Float[Array, " n"],
) -> Combined:
    """Expressions from the terms of all points, with derivatives by the chain rule."""
    functionals = functionals_of(expressions)

    def rows(terms: Terms, x: Array) -> tuple[tuple[Array, ...], tuple]:
        return scope_from(problem, functionals, terms, constants, x).evaluated(expressions)

    def along(slope: Terms, direction: Array) -> tuple[Any, Any, Any]:
        return jax.jvp(rows, (terms, decisions), (slope, direction), has_aux=True)

    every = jnp.eye(decisions.size)
    values, derivatives, taken = jax.vmap(along, out_axes=(None, 0, None))(slopes, every)
    return Combined(values, tuple(one.T for one in derivatives), taken)


def parts_of(
    problem: Problem, collocation: Collocation, constants: Constants
) -> list[tuple[Float[np.ndarray, "points variables"], Float[np.ndarray, "terms points"]]]:
    """The collocation points in parts of one size if simulating them takes long enough, else one part; each with the
    columns of the pseudo-inverse that belong to it.

    The number of parts follows from the problem alone, so that digits do not depend on the number of cores. The last
    part is filled up with copies of its last point, which contribute nothing.
    """
    points, fit = np.asarray(collocation.points), np.asarray(collocation.pseudo_inverse)
    grid, count = problem.grid, len(points)
    tangents = 1 + problem.placements.size
    whole = not problem.is_integrated or constants.scenarios is not None
    if whole or count < 2 * _FEWEST_POINTS or count * grid.steps * tangents < _FEWEST_NUMBERS:
        return [(points, fit)]
    number = min(max(2, count // _POINTS_OF_A_PART), _MOST_PARTS)
    size = -(-count // number)
    missing = size * number - count
    points = np.concatenate([points, np.repeat(points[-1:], missing, axis=0)])
    fit = np.concatenate([fit, np.zeros((len(fit), missing))], axis=1)
    return list(zip(np.split(points, number), np.split(fit, number, axis=1), strict=True))


class Blocks(NamedTuple):
    """A problem at one point.

    - `values`, `derivatives`: the objective, then the rows of each constraint, and their derivatives by the decisions:
      shapes (rows,) and (rows, n);
    - `sizes`: the number of rows of each;
    - `statistics`: all statistics in the expressions, in the order of `statistics_in`;
    - `times`: the instants of the grid;
    - `samples_in_parts`, `tangents_in_parts`: `samples` and `tangents` in the parts in which they were simulated; only
      the first `points` of them count.
    """

    values: Float[np.ndarray, " rows"]
    derivatives: Float[np.ndarray, "rows n"]
    sizes: Int[np.ndarray, " expressions"]
    statistics: tuple[Float[np.ndarray, "..."], ...]
    times: Float[np.ndarray, " instants"]
    samples_in_parts: tuple[tuple[Any, ...], ...]
    tangents_in_parts: tuple[tuple[Any, ...], ...]
    points: int

    @property
    def samples(self) -> tuple[Float[np.ndarray, "points ..."], ...]:
        """Each functional at the collocation points."""
        return tuple(self._whole(parts) for parts in zip(*self.samples_in_parts, strict=True))

    @property
    def tangents(self) -> tuple[Float[np.ndarray, "points ... parameters"] | None, ...]:
        """The derivatives of each functional's samples by the decisions that are parameters of distributions.

        Those of a path at a few instants; None if they are not computed.
        """
        every = zip(*self.tangents_in_parts, strict=True)
        return tuple(None if parts[0] is None else self._whole(parts) for parts in every)

    def _whole(self, parts: tuple[Any, ...]) -> np.ndarray:
        return np.asarray(parts[0]) if len(parts) == 1 else np.concatenate(parts)[: self.points]

    def by_constraint(self, rows: np.ndarray) -> list[np.ndarray]:
        """An array of rows, such as `derivatives`, split by constraint."""
        return np.split(rows, np.cumsum(self.sizes)[:-1])[1:]


def _evaluate(
    problem: Problem,
    collocation: Collocation,
    constants: Constants,
    anchors: Anchors | None,
    decisions: Float[Array, " n"],
) -> tuple[Any, ...]:
    """The parts of `Blocks`, with exact derivatives.

    Expressions with rows of one instant each are differentiated instant by instant.
    """
    which = instantaneous(problem)
    rest = tuple(i for i in range(len(problem.expressions)) if i not in which)
    expressions = tuple(problem.expressions[i] for i in rest)
    functionals, points = functionals_of(expressions), (collocation.points, collocation.pseudo_inverse)
    share = share_of(problem, functionals, *points, constants.scenarios, decisions)
    parts = combined(problem, expressions, constants, share.terms, share.slopes, decisions)
    tangents = dict(zip(functionals, share.tangents, strict=True))
    samples = dict(zip(functionals, share.samples, strict=True))
    by_expression = dict(zip(rest, zip(*parts, strict=True), strict=True))
    if which:
        rows = instantaneous_rows(problem, which, collocation, constants, anchors, decisions)
        by_expression |= dict(zip(which, zip(rows.values, rows.derivatives, rows.statistics, strict=True), strict=True))
        samples |= rows.samples
    parts = Combined(*zip(*(by_expression[i] for i in range(len(problem.expressions))), strict=True))
    ordered = tuple(samples[one] for one in functionals_of(problem.expressions))
    finite = jnp.array([jnp.isfinite(one).all() for one in ordered]).all()
    ordered_tangents = tuple(tangents.get(one) for one in functionals_of(problem.expressions))
    return *_points_together(problem, parts, finite, decisions), (ordered,), (ordered_tangents,)


def _contribute(
    problem: Problem, points: Float[Array, "points variables"], fit: Float[Array, "terms points"], decisions: Array
) -> Share:
    return share_of(problem, functionals_of(problem.expressions), points, fit, None, decisions)


class _Shares(NamedTuple):
    """The shares of all parts: `terms` and `slopes` of each, whether it is `finite`, and the `decisions`."""

    terms: tuple[Terms, ...]
    slopes: tuple[Terms, ...]
    finite: tuple[Array, ...]
    decisions: Float[Array, " n"]


def _combine(problem: Problem, constants: Constants, shares: _Shares) -> tuple[Any, ...]:
    first, *others = zip(shares.terms, shares.slopes, strict=True)
    terms, slopes = reduce(lambda one, other: jax.tree.map(jnp.add, one, other), others, first)
    finite, decisions = shares.finite, shares.decisions
    parts = combined(problem, problem.expressions, constants, terms, slopes, decisions)
    return _points_together(problem, parts, jnp.array(finite).all(), decisions)


def _points_together(
    problem: Problem, parts: Combined, finite: Array, decisions: Float[Array, " n"]
) -> tuple[Any, ...]:
    """The first parts of `Blocks`, those of all points together."""
    # A statistic may hide a failed simulation: the probability of a rare event is zero if that system gives NaN.
    every = jnp.where(finite, jnp.concatenate(parts.values), jnp.nan)
    sizes = jnp.array([one.size for one in parts.values])
    statistics = tuple(one for part in parts.statistics for one in part)
    return every, jnp.concatenate(parts.derivatives), sizes, statistics, grid_at(problem, decisions).times


def use_of(problem: Problem, collocation: Collocation, *_: Any) -> Use:
    """The use of programs that simulate a problem: loops over time, or equations of every instant by itself.

    Where events divide steps, or a grid repeats, a step has many equations of single numbers: full optimisation takes
    longer than it saves, and for the derivatives of a monodromy matrix it takes minutes. A few short simulations up to
    an event are over before any optimisation is.
    """
    if not problem.is_integrated:
        return Use.BRIEF
    if not divides_steps(problem):
        return Use.LOOPS
    numbers = problem.grid.steps * len(collocation.points) * (1 + problem.placements.size)
    return Use.BRIEF if ends_by_event(problem) and numbers < _FEW_NUMBERS else Use.ONCE


EVALUATE = Compiled(_evaluate, use=use_of)
CONTRIBUTE = Compiled(_contribute)
COMBINE = Compiled(_combine, use=Use.BRIEF)


@final
class Evaluator:
    """A compiled problem that remembers its two latest points.

    So neither the start, which sets the scales, nor the solution, which needs moments, is computed twice. A small
    problem, whose time is mostly overhead per call, is one program; the points of a large one are simulated in parts,
    on all cores and devices.
    """

    def __init__(self, traced: Problem, collocation: Collocation, constants: Constants, anchors: Anchors | None):
        self._made_of = traced, collocation, anchors
        self._points, parts = len(collocation.points), parts_of(traced, collocation, constants)
        self._combine = None if len(parts) == 1 else COMBINE.bound(traced, constants)
        self._programs = (
            [EVALUATE.bound(traced, collocation, constants, anchors)]
            if self._combine is None
            else [CONTRIBUTE.bound(traced, *map(jax_array, part), packed=False) for part in parts]
        )
        self._remembered: Remembered[Blocks] = Remembered(self._evaluate)

    def is_known(self, decisions: Float[np.ndarray, " n"]) -> bool:
        """Whether a problem of the same structure has been compiled before."""
        return self._programs[0].is_known(decisions)

    def begin(self, decisions: Float[np.ndarray, " n"], meanwhile: Callable[[], object]) -> None:
        """Begin to compile what simulates, on another core; it is traced here and now, and the rest is meanwhile."""
        share = self._programs[0].begin(decisions)
        meanwhile()
        if self._combine is not None and share is not None:
            every = [share] * len(self._programs)
            _, finite, _, terms, slopes = zip(*every, strict=True)
            self._combine.prepare(_Shares(terms, slopes, finite, jax_array(decisions)))

    def with_constants(self, constants: Constants) -> "Evaluator":
        """The same problem with other constants, such as other scenarios."""
        traced, collocation, anchors = self._made_of
        return Evaluator(traced, collocation, constants, anchors)

    def __call__(self, decisions: Float[np.ndarray, " n"]) -> Blocks:
        return self._remembered(decisions)

    def _evaluate(self, decisions: Float[np.ndarray, " n"]) -> Blocks:
        if self._combine is None:
            return Blocks._make((*self._programs[0](decisions), self._points))
        # The calling thread traces a user's code before other threads start.
        for program in self._programs:
            program.prepare(decisions)
        shares: tuple[Share, ...] = tuple(over_devices(lambda program: program(decisions), self._programs))
        samples, finite, tangents, terms, slopes = zip(*shares, strict=True)
        sums = self._combine(_Shares(terms, slopes, finite, jax_array(decisions)))
        return Blocks._make((*sums, samples, tangents, self._points))


def evaluation_of(blocks: Blocks) -> Evaluation:
    """A point in the solver's terms."""
    return Evaluation(
        objective=float(blocks.values[0]),
        gradient=blocks.derivatives[0],
        constraints=blocks.values[1:],
        jacobian=blocks.derivatives[1:],
    )
