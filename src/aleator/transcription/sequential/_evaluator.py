"""Evaluate a problem: values and exact derivatives from compiled functions, with the latest points remembered.

Simulation takes almost all the time of an evaluation, and points are independent until coefficients are formed, which
are sums over the points. So a large problem is simulated in parts, one per core, each of which gives its share of the
coefficients, with derivatives; the rest of the work is small. A small problem is one program.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

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
from aleator.statistics import AbstractTail, Constants, sloped
from aleator.transcription._abstract import Meaning, Remembered
from aleator.transcription._discretised import Discretised
from aleator.transcription._expansions import Terms, scope_from, seen, simulated, tails_in
from aleator.transcription.sequential._affine import Anchors
from aleator.transcription.sequential._instantaneous import Block, instantaneous, instantaneous_rows

# Fewest points per part that are worth the overhead of a time step, and fewest numbers worth that of threads.
_FEWEST_POINTS, _FEWEST_NUMBERS = 16, 200_000
# Numbers of simulations up to events, and of integrals over time without states, that take longer to compile well than
# to run a few dozen times; of other simulations, that take longer to compile for loops than they gain in a search.
_FEW_NUMBERS, _LOOPING_NUMBERS = 20_000, 100_000
# Two parts, unless there are points enough for more.
_POINTS_OF_A_PART, _MOST_PARTS = 128, 8


class Share(NamedTuple):
    """The contribution of some points.

    - `samples`: each functional at the points;
    - `tangents`: the derivatives of samples (of a path at a few instants) by the decisions, along a first axis; None
      if no decision is a parameter of a distribution;
    - `terms`: the points' share of the terms of expressions; `slopes`: its derivatives by the decisions, along a first
      axis of each array.
    """

    samples: tuple[Float[Array, "points ..."], ...]
    tangents: tuple[Float[Array, "n points ..."] | None, ...]
    terms: Terms
    slopes: Terms


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
    has_parameters = bool(problem.placements.of_distributions)

    def contributed(x: Array) -> tuple[tuple[Terms, tuple], tuple]:
        samples, terms = simulated(problem, functionals, points, fit, scenarios, x)
        looked_at = [seen(values, one.is_path) for one, values in zip(functionals, samples, strict=True)]
        return (terms, tuple(looked_at) if has_parameters else ()), samples

    def along(direction: Array) -> tuple[Any, Any, Any]:
        return jax.jvp(contributed, (decisions,), (direction,), has_aux=True)

    # Tangents along the first axis: along the last one, inner loops would run over the shortest of all axes.
    (terms, _), (slopes, tangents), samples = jax.vmap(along, out_axes=(None, 0, None))(jnp.eye(decisions.size))
    return Share(samples, tangents or (None,) * len(functionals), terms, slopes)


def combined(
    problem: Problem,
    expressions: tuple[Expression, ...],
    constants: Constants,
    terms: Terms,
    slopes: Terms,
    decisions: Float[Array, " n"],
) -> list[Block]:
    """Expressions from the terms of all points, with derivatives by the chain rule."""
    functionals = functionals_of(expressions)

    def rows(terms: Terms, x: Array) -> tuple[tuple[Array, ...], tuple]:
        return scope_from(problem, functionals, terms, constants, x).evaluated(expressions)

    def along(slope: Terms, direction: Array) -> tuple[Any, Any, Any]:
        return jax.jvp(rows, (terms, decisions), (slope, direction), has_aux=True)

    every = jnp.eye(decisions.size)
    values, derivatives, taken = jax.vmap(along, out_axes=(None, 0, None))(slopes, every)
    return [Block(value, along.T, own) for value, along, own in zip(values, derivatives, taken, strict=True)]


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


@final
@dataclass(frozen=True)
class Evaluated:
    """A problem at some decisions.

    - `values`: of the objective, shape (1,), then of each constraint, shape (rows,); `derivatives`: theirs, (rows, n);
    - `statistics`: all in the expressions, in the order of `statistics_in`; `times`: the instants of the grid;
    - `samples`, `tangents`: see `Share`, in the parts in which they were simulated; only the first `points` count.
    """

    decisions: Float[np.ndarray, " n"]
    values: list[Float[np.ndarray, " _rows"]]
    derivatives: list[Float[np.ndarray, "_rows n"]]
    statistics: tuple[Float[np.ndarray, "..."], ...]
    times: Float[np.ndarray, " instants"]
    samples: tuple[tuple[Any, ...], ...]
    tangents: tuple[tuple[Any, ...], ...]
    points: int

    @cached_property
    def meaning(self) -> Meaning:
        """The point with all samples. A search, which looks at values alone, joins none."""
        samples = tuple(self._whole(parts, 0) for parts in zip(*self.samples, strict=True))
        tangents = tuple(self._whole(parts, 1) for parts in zip(*self.tangents, strict=True))
        objective, *constraints = self.values
        return Meaning(self.decisions, float(objective[0]), constraints, samples, tangents, self.statistics)

    def _whole(self, parts: tuple[Any, ...], axis: int) -> Any:
        """An array of all points, which are along an axis, or None."""
        if parts[0] is None:
            return None
        return np.concatenate(parts, axis)[(*[slice(None)] * axis, slice(self.points))]

    @property
    def evaluation(self) -> Evaluation:
        """The same in the solver's terms."""
        (objective, *values), (gradient, *jacobian) = self.values, self.derivatives
        rows = np.concatenate([np.zeros(0), *values])
        return Evaluation(float(objective[0]), gradient[0], rows, np.concatenate([gradient[:0], *jacobian]))


def _evaluate(
    problem: Problem,
    collocation: Collocation,
    constants: Constants,
    anchors: Anchors | None,
    decisions: Float[Array, " n"],
) -> tuple[tuple[list[Block], Array], tuple[Any, ...]]:
    """The blocks of a problem and the instants, then samples and their derivatives, see `Share`.

    Expressions with rows of one instant each are differentiated instant by instant.
    """
    which = instantaneous(problem)
    rest = [i for i in range(len(problem.expressions)) if i not in which]
    expressions = tuple(problem.expressions[i] for i in rest)
    functionals, points = functionals_of(expressions), (collocation.points, collocation.pseudo_inverse)
    share = share_of(problem, functionals, *points, constants.scenarios, decisions)
    blocks = dict(
        zip(rest, combined(problem, expressions, constants, share.terms, share.slopes, decisions), strict=True)
    )
    tangents = dict(zip(functionals, share.tangents, strict=True))
    samples = dict(zip(functionals, share.samples, strict=True))
    if which:
        rows, own = instantaneous_rows(problem, which, collocation, constants, anchors, decisions)
        blocks |= zip(which, rows, strict=True)
        samples |= own
    every, times = functionals_of(problem.expressions), grid_at(problem, decisions).times
    parts = tuple(samples[one] for one in every), tuple(map(tangents.get, every))
    return ([blocks[i] for i in sorted(blocks)], times), parts


def _contribute(
    problem: Problem,
    points: Float[Array, "points variables"],
    fit: Float[Array, "terms points"],
    scenarios: Float[Array, "scenarios variables"] | None,
    decisions: Array,
) -> Share:
    return share_of(problem, functionals_of(problem.expressions), points, fit, scenarios, decisions)


def _combine(
    problem: Problem,
    constants: Constants,
    shares: tuple[tuple[Terms, ...], tuple[Terms, ...], tuple[tuple[Array, ...], tuple[Array, ...]], Array],
) -> tuple[list[Block], Array]:
    """The blocks and the instants from terms and slopes of all parts, tails and their slopes, and the decisions."""
    *every, tails, decisions = shares
    terms, slopes = reduce(lambda one, other: jax.tree.map(jnp.add, one, other), zip(*every, strict=True))
    terms, slopes = (one._replace(tails=own) for one, own in zip((terms, slopes), tails, strict=True))
    blocks = combined(problem, problem.expressions, constants, terms, slopes, decisions)
    return blocks, grid_at(problem, decisions).times


def use_of(problem: Problem, points: int) -> Use:
    """The use of programs that simulate a problem: loops over time, or equations of every instant by itself.

    Where events divide steps, or a grid repeats, a step has many equations of single numbers: full optimisation takes
    longer than it saves, and for the derivatives of a monodromy matrix it takes minutes. A few short simulations up to
    an event are over before any optimisation is, as are rows of single instants, which depend on few numbers each.
    Other short simulations gain nothing by it.
    """
    numbers = problem.grid.steps * points * (1 + problem.placements.size)
    if not problem.is_integrated:
        which = instantaneous(problem)
        others = functionals_of(tuple(one for i, one in enumerate(problem.expressions) if i not in which))
        return Use.ROWS if others and numbers > _FEW_NUMBERS else Use.BRIEF
    if not divides_steps(problem):
        return Use.LOOPS if numbers > _LOOPING_NUMBERS else Use.ONCE
    return Use.BRIEF if ends_by_event(problem) and numbers < _FEW_NUMBERS else Use.ONCE


EVALUATE = Compiled(_evaluate, use=lambda problem, collocation, *_: use_of(problem, len(collocation.points)))
CONTRIBUTE = Compiled(_contribute, use=lambda problem, points, *_: use_of(problem, len(points)))
COMBINE = Compiled(_combine, use=Use.BRIEF)


@final
@dataclass(frozen=True)
class Tails:
    """The statistics of tails in a problem, which are computed between its programs.

    They follow from coefficients alone, by NumPy, and entries of a path are independent.

    - `which`: the functional of each among those of the problem.
    """

    kinds: tuple[AbstractTail, ...]
    which: tuple[int, ...]
    constants: Constants

    @classmethod
    def of(cls, problem: Problem, constants: Constants) -> "Tails":
        """Those of a problem."""
        atoms = tails_in(problem.expressions)
        functionals = functionals_of(problem.expressions)
        which = tuple(functionals.index(one.functionals[0]) for one in atoms)
        return cls(tuple(one.kind for one in atoms), which, constants)  # type: ignore[arg-type]

    def __call__(self, terms: Sequence[Terms], slopes: Sequence[Terms]) -> Any:
        """Their values, and the derivatives of these by the decisions, from the terms of all parts."""
        coefficients, tangents = (
            [np.sum([one.coefficients[i] for one in parts], axis=0) for i in self.which] for parts in (terms, slopes)
        )
        pairs = zip(self.kinds, coefficients, strict=True)
        every = [sloped(kind, terms, self.constants.of(kind)) for kind, terms in pairs]
        slopes = [np.sum(one.slopes * along, axis=1) for one, along in zip(every, tangents, strict=True)]
        return tuple(jax_array(one.values) for one in every), tuple(map(jax_array, slopes))

    def shapes(self, share: Any) -> Any:
        """The shapes of the result, for those of a part's share."""
        every, along = ([own.coefficients[i] for i in self.which] for own in (share.terms, share.slopes))
        shapes = [one.shape[1:] for one in every], [(one.shape[0], *one.shape[2:]) for one in along]
        return tuple(tuple(jax.ShapeDtypeStruct(shape, float) for shape in some) for some in shapes)


@final
class Evaluator:
    """A compiled problem that remembers its two latest points.

    So neither the start, which sets the scales, nor the solution, which needs moments, is computed twice. A small
    problem, whose time is mostly overhead per call, is one program; the points of a large one are simulated in parts,
    on all cores and devices.
    """

    def __init__(self, traced: Problem, discretised: Discretised, anchors: Anchors | None):
        _, collocation, constants = discretised
        self.anchors = anchors
        self._points, parts = len(collocation.points), parts_of(traced, collocation, constants)
        self._tails = Tails.of(traced, constants)
        self._combine = COMBINE.bound(traced, constants) if len(parts) > 1 or self._tails.kinds else None
        self._programs = (
            [EVALUATE.bound(traced, collocation, constants, anchors)]
            if self._combine is None
            else [CONTRIBUTE.bound(traced, *map(jax_array, part), constants.scenarios, packed=False) for part in parts]
        )
        self._remembered: Remembered[Evaluated] = Remembered(self._evaluate)

    def is_known(self, decisions: Float[np.ndarray, " n"]) -> bool:
        """Whether a problem of the same structure has been compiled before."""
        return self._programs[0].is_known(decisions)

    def begin(self, decisions: Float[np.ndarray, " n"], meanwhile: Callable[[], object]) -> None:
        """Begin to compile what simulates, on another core; it is traced here and now, and the rest is meanwhile."""
        share = self._programs[0].begin(decisions)
        meanwhile()
        if self._combine is not None and share is not None:
            *_, terms, slopes = zip(*[share] * len(self._programs), strict=True)
            self._combine.prepare((terms, slopes, self._tails.shapes(share), jax_array(decisions)))

    def __call__(self, decisions: Float[np.ndarray, " n"]) -> Evaluated:
        return self._remembered(decisions)

    def _evaluate(self, decisions: Float[np.ndarray, " n"]) -> Evaluated:
        if self._combine is None:
            (blocks, times), share = self._programs[0](decisions)
            samples, tangents = (share[0],), (share[1],)
        else:
            # The calling thread traces a user's code before other threads start.
            for program in self._programs:
                program.prepare(decisions)
            shares: tuple[Share, ...] = tuple(over_devices(lambda program: program(decisions), self._programs))
            samples, tangents, terms, slopes = zip(*shares, strict=True)
            blocks, times = self._combine((terms, slopes, self._tails(terms, slopes), jax_array(decisions)))
        # A statistic may hide a failed simulation: the probability of a rare event is zero if that system gives NaN.
        is_finite = all(np.isfinite(one).all() for part in samples for one in part)
        values = [one.values if is_finite else np.full_like(one.values, np.nan) for one in blocks]
        taken = tuple(statistic for one in blocks for statistic in one.statistics)
        derivatives = [one.derivatives for one in blocks]
        return Evaluated(decisions, values, derivatives, taken, times, samples, tangents, self._points)
