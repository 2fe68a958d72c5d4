"""Evaluate a problem: values and exact derivatives from one compiled function, with the latest points remembered."""

from typing import Any, NamedTuple, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.compilation import Compiled, Use
from aleator._core.parallel import over_devices
from aleator.design import Problem, functionals_of, grid_at
from aleator.expansion import Collocation
from aleator.nlp import Evaluation
from aleator.statistics import Constants
from aleator.transcription._remembered import Remembered
from aleator.transcription._scope import Terms
from aleator.transcription.sequential._affine import Anchors
from aleator.transcription.sequential._instantaneous import instantaneous, instantaneous_rows
from aleator.transcription.sequential._shares import Combined, Part, Share, added, combined, parts_of, share_of


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
    found = dict(zip(rest, zip(*parts, strict=True), strict=True))
    if which:
        rows = instantaneous_rows(problem, which, collocation, constants, anchors, decisions)
        found |= dict(zip(which, zip(rows.values, rows.derivatives, rows.statistics, strict=True), strict=True))
        samples |= rows.samples
    parts = Combined(*zip(*(found[i] for i in range(len(problem.expressions))), strict=True))
    ordered = tuple(samples[one] for one in functionals_of(problem.expressions))
    finite = jnp.array([jnp.isfinite(one).all() for one in ordered]).all()
    looked_at = tuple(tangents.get(one) for one in functionals_of(problem.expressions))
    return *_told(problem, parts, finite, decisions), (ordered,), (looked_at,)


def _contribute(
    problem: Problem, points: Float[Array, "points variables"], fit: Float[Array, "terms points"], decisions: Array
) -> Share:
    return share_of(problem, functionals_of(problem.expressions), points, fit, None, decisions)


class _Given(NamedTuple):
    """The shares of all parts: `terms` and `slopes` of each, whether it is `finite`, and the `decisions`."""

    terms: tuple[Terms, ...]
    slopes: tuple[Terms, ...]
    finite: tuple[Array, ...]
    decisions: Float[Array, " n"]


def _combine(problem: Problem, constants: Constants, given: _Given) -> tuple[Any, ...]:
    terms, slopes, finite, decisions = given
    parts = combined(problem, problem.expressions, constants, added(terms), added(slopes), decisions)
    return _told(problem, parts, jnp.array(finite).all(), decisions)


def _told(problem: Problem, parts: Combined, finite: Array, decisions: Float[Array, " n"]) -> tuple[Any, ...]:
    """The first parts of `Blocks`, those of all points together."""
    # A statistic may hide a failed simulation: the probability of a rare event is zero if that system gives NaN.
    every = jnp.where(finite, jnp.concatenate(parts.values), jnp.nan)
    sizes = jnp.array([one.size for one in parts.values])
    statistics = tuple(one for part in parts.statistics for one in part)
    return every, jnp.concatenate(parts.derivatives), sizes, statistics, grid_at(problem, decisions).times


def _use(problem: Problem, *_: Any) -> Use:
    return Use.LOOPS if problem.is_integrated else Use.ROWS


EVALUATE = Compiled(_evaluate, use=_use)
CONTRIBUTE = Compiled(_contribute)
COMBINE = Compiled(_combine, use=Use.ROWS)


@final
class _AtOnce:
    """A whole problem in one program, for small problems, whose time is mostly overhead per call."""

    def __init__(self, traced: Problem, collocation: Collocation, constants: Constants, anchors: Anchors | None):
        self._evaluate, self._points = EVALUATE.bound(traced, collocation, constants, anchors), len(collocation.points)

    def is_known(self, decisions: Float[np.ndarray, " n"]) -> bool:
        """Whether a problem of the same structure has been compiled before."""
        return self._evaluate.is_known(decisions)

    def __call__(self, decisions: Float[np.ndarray, " n"]) -> Blocks:
        """The problem at a point."""
        return Blocks._make((*self._evaluate(decisions), self._points))


@final
class _InParts:
    """A problem whose points are simulated in parts, on all cores and devices."""

    def __init__(self, traced: Problem, constants: Constants, parts: tuple[Part, ...], points: int):
        self._parts = [CONTRIBUTE.bound(traced, *map(jnp.asarray, one), packed=False) for one in parts]
        self._combine, self._points = COMBINE.bound(traced, constants), points

    def is_known(self, decisions: Float[np.ndarray, " n"]) -> bool:
        """Whether a problem of the same structure has been compiled before."""
        return self._parts[0].is_known(decisions)

    def __call__(self, decisions: Float[np.ndarray, " n"]) -> Blocks:
        """The problem at a point."""
        # The calling thread traces a user's code before other threads start.
        for part in self._parts:
            part.prepare(decisions)
        shares: tuple[Share, ...] = tuple(over_devices(lambda part: part(decisions), self._parts))
        terms, slopes, finite = (
            tuple(each) for each in zip(*((one.terms, one.slopes, one.finite) for one in shares), strict=True)
        )
        given = _Given(terms, slopes, finite, jnp.asarray(decisions))
        samples, tangents = (tuple(each) for each in zip(*((one.samples, one.tangents) for one in shares), strict=True))
        return Blocks._make((*self._combine(given), samples, tangents, self._points))


@final
class Evaluator:
    """A compiled problem that remembers its two latest points.

    So neither the start, which sets the scales, nor the solution, which needs moments, is computed twice.
    """

    def __init__(self, traced: Problem, collocation: Collocation, constants: Constants, anchors: Anchors | None):
        self._given = traced, collocation, anchors
        parts = parts_of(traced, collocation, constants)
        self._evaluate = (
            _InParts(traced, constants, parts, len(collocation.points))
            if len(parts) > 1
            else _AtOnce(traced, collocation, constants, anchors)
        )
        self._remembered: Remembered[Blocks] = Remembered(self._evaluate)

    def is_known(self, decisions: Float[np.ndarray, " n"]) -> bool:
        """Whether a problem of the same structure has been compiled before."""
        return self._evaluate.is_known(decisions)

    def with_constants(self, constants: Constants) -> "Evaluator":
        """The same problem with other constants, such as other scenarios."""
        traced, collocation, anchors = self._given
        return Evaluator(traced, collocation, constants, anchors)

    def __call__(self, decisions: Float[np.ndarray, " n"]) -> Blocks:
        return self._remembered(decisions)


def evaluation_of(blocks: Blocks) -> Evaluation:
    """A point in the solver's terms."""
    return Evaluation(
        objective=float(blocks.values[0]),
        gradient=blocks.derivatives[0],
        constraints=blocks.values[1:],
        jacobian=blocks.derivatives[1:],
    )
