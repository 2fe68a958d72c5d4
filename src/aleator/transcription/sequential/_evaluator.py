"""A problem at one point: its values and their exact derivatives from one compiled function, remembered."""

import threading
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.compilation import Compiled, Use
from aleator.design import Problem, functionals_of, grid_at, refuse_changed_code
from aleator.expansion import Collocation
from aleator.nlp import Evaluation
from aleator.statistics import Constants
from aleator.transcription._resolution import seen
from aleator.transcription._scope import scope_of
from aleator.transcription.sequential._affine import Anchors
from aleator.transcription.sequential._instantaneous import instantaneous, instantaneous_rows


class Blocks(NamedTuple):
    """A problem at one point.

    - `values`, `derivatives`: the objective, then the rows of each constraint, and their derivatives by the decisions:
      shapes (rows,) and (rows, n);
    - `sizes`: how many rows each of them has;
    - `samples`: each functional at the collocation points;
    - `statistics`: each that stands in the expressions, in the order of `statistics_in`;
    - `times`: the instants of the grid;
    - `tangents`: the derivatives of each functional's samples (of a path at a few instants) by the decisions that are
      parameters of distributions; None where they are not taken.
    """

    values: Float[np.ndarray, " rows"]
    derivatives: Float[np.ndarray, "rows n"]
    sizes: Int[np.ndarray, " expressions"]
    samples: tuple[Float[np.ndarray, "points ..."], ...]
    statistics: tuple[Float[np.ndarray, "..."], ...]
    times: Float[np.ndarray, " instants"]
    tangents: tuple[Float[np.ndarray, "points ... parameters"] | None, ...]

    def by_constraint(self, rows: np.ndarray) -> list[np.ndarray]:
        """The rows of each constraint among all, such as those of `derivatives`."""
        return np.split(rows, np.cumsum(self.sizes)[:-1])[1:]


def _evaluate(
    problem: Problem,
    collocation: Collocation,
    constants: Constants,
    anchors: Anchors | None,
    decisions: Float[Array, " n"],
) -> tuple[Any, ...]:
    """The parts of `Blocks`, with exact derivatives, forward: few decisions, thousands of rows.

    Expressions whose rows depend on one instant each are differentiated instant by instant.
    """
    which = instantaneous(problem)
    rest = tuple(i for i in range(len(problem.expressions)) if i not in which)
    parameters = tuple(problem.survey.of_laws.values())
    expressions = tuple(problem.expressions[i] for i in rest)

    def values(x: Array) -> tuple[tuple[tuple[Array, ...], tuple[Array, ...]], tuple]:
        scope = scope_of(problem, functionals_of(expressions), collocation, constants, x)
        blocks, taken = scope.evaluated(expressions)
        looked_at = tuple(seen(of, one.is_path) for one, of in scope.samples.items()) if parameters else ()
        return (blocks, looked_at), (blocks, tuple(scope.samples.values()), taken)

    (derivatives, slopes), (blocks, values_at_points, taken) = jax.jacfwd(values, has_aux=True)(decisions)
    tangents = dict(zip(functionals_of(expressions), slopes, strict=False))
    samples = dict(zip(functionals_of(expressions), values_at_points, strict=True))
    found = dict(zip(rest, zip(blocks, derivatives, taken, strict=True), strict=True))
    if which:
        rows = instantaneous_rows(problem, which, collocation, constants, anchors, decisions)
        found |= dict(zip(which, zip(rows.values, rows.derivatives, rows.statistics, strict=True), strict=True))
        samples |= rows.samples
    blocks, derivatives, taken = zip(*(found[i] for i in range(len(problem.expressions))), strict=True)
    ordered = tuple(samples[one] for one in functionals_of(problem.expressions))
    sizes = jnp.array([one.size for one in blocks])
    statistics = tuple(one for part in taken for one in part)
    # A statistic may hide that a system came to no end: a rare event has no probability, whatever it would have been.
    finite = jnp.array([jnp.isfinite(one).all() for one in ordered]).all()
    every = jnp.where(finite, jnp.concatenate(blocks), jnp.nan)
    times = grid_at(problem, decisions).times
    looked_at = tuple(
        tangents[one][..., jnp.array(parameters)] if one in tangents else None
        for one in functionals_of(problem.expressions)
    )
    return every, jnp.concatenate(derivatives), sizes, ordered, statistics, times, looked_at


def _use(problem: Problem, *_: Any) -> Use:
    return Use.LOOPS if problem.is_integrated else Use.ROWS


EVALUATE = Compiled(_evaluate, use=_use, unchanged=refuse_changed_code)


@final
class Evaluator:
    """A compiled problem that remembers its two latest points.

    So the start, needed to find scales, and the solution, needed for its moments, are not computed twice.
    """

    def __init__(self, traced: Problem, collocation: Collocation, constants: Constants, anchors: Anchors | None):
        self._parts = traced, collocation, anchors
        self._evaluate = EVALUATE.bound(traced, collocation, constants, anchors)
        self._memory: dict[bytes, Blocks] = {}
        self._lock = threading.Lock()

    def is_known(self, decisions: Float[np.ndarray, " n"]) -> bool:
        """Whether a problem of the same structure has been compiled before."""
        return self._evaluate.is_known(decisions)

    def with_constants(self, constants: Constants) -> "Evaluator":
        """The same problem with other constants, such as other scenarios."""
        traced, collocation, anchors = self._parts
        return Evaluator(traced, collocation, constants, anchors)

    def __call__(self, decisions: Float[np.ndarray, " n"]) -> Blocks:
        key = decisions.tobytes()
        with self._lock:
            found = self._memory.get(key)
        if found is None:
            found = Blocks(*self._evaluate(decisions))
            with self._lock:
                while len(self._memory) > 1:
                    del self._memory[next(iter(self._memory))]
                self._memory[key] = found
        return found


def evaluation_of(blocks: Blocks) -> Evaluation:
    """A point in the solver's terms."""
    return Evaluation(
        objective=float(blocks.values[0]),
        gradient=blocks.derivatives[0],
        constraints=blocks.values[1:],
        jacobian=blocks.derivatives[1:],
    )
