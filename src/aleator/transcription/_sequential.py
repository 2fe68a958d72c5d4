"""Sequential transcription: simulate inside, optimise outside (SeqNLP, equations 93, 95 and 122).

The decisions are the only variables of the nonlinear program; the dynamics are solved exactly at every evaluation. The
values and the Jacobian of the objective and of all constraints come from one compiled function.
"""

import itertools
from dataclasses import dataclass
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled
from aleator._core.errors import ProblemError
from aleator.collocation import Basis, Collocation
from aleator.design import Problem, functionals_of, grid_at, history, statistics_in
from aleator.nlp import Evaluation, NonlinearProgram
from aleator.statistics import Constants
from aleator.transcription._discretisation import RESPOND, discretised
from aleator.transcription._instantaneous import instantaneous, instantaneous_rows
from aleator.transcription._resolution import RESOLVE, Resolved
from aleator.transcription._scope import scope_of
from aleator.transcription._settled import refuse_settled
from aleator.uncertainty import Survey


class Blocks(NamedTuple):
    """A problem at one point.

    - `values`, `derivatives`: the objective and each constraint, flattened, and their derivatives by the decisions:
      shapes (rows,) and (rows, n);
    - `samples`: each functional at the collocation points;
    - `statistics`: each that stands in the expressions, in the order of `statistics_in`.
    """

    values: tuple[Float[np.ndarray, " rows"], ...]
    derivatives: tuple[Float[np.ndarray, "rows n"], ...]
    samples: tuple[Float[Array, "points ..."], ...]
    statistics: tuple[Float[np.ndarray, "..."], ...]


def _evaluate(
    problem: Problem, collocation: Collocation, constants: Constants, decisions: Float[Array, " n"]
) -> tuple[tuple[Array, ...], ...]:
    """The parts of `Blocks`, with exact derivatives, forward: few decisions, thousands of rows.

    Expressions whose rows depend on one instant each are differentiated instant by instant.
    """
    which = instantaneous(problem)
    rest = tuple(i for i in range(len(problem.expressions)) if i not in which)
    expressions = tuple(problem.expressions[i] for i in rest)

    def values(x: Array) -> tuple[tuple[Array, ...], tuple]:
        scope = scope_of(problem, functionals_of(expressions), collocation, constants, x)
        blocks, taken = scope.evaluated(expressions)
        return blocks, (blocks, tuple(scope.samples.values()), taken)

    derivatives, (blocks, values_at_points, taken) = jax.jacfwd(values, has_aux=True)(decisions)
    samples = dict(zip(functionals_of(expressions), values_at_points, strict=True))
    found = dict(zip(rest, zip(blocks, derivatives, taken, strict=True), strict=True))
    if which:
        rows = instantaneous_rows(problem, which, collocation, constants, decisions)
        found |= dict(zip(which, zip(rows.values, rows.derivatives, rows.statistics, strict=True), strict=True))
        samples |= rows.samples
    blocks, derivatives, taken = zip(*(found[i] for i in range(len(problem.expressions))), strict=True)
    ordered = tuple(samples[one] for one in functionals_of(problem.expressions))
    return blocks, derivatives, ordered, tuple(one for part in taken for one in part)


def _outputs_at_points(problem: Problem, collocation: Collocation, decisions: Float[Array, " n"]) -> dict[str, Array]:
    return jax.vmap(lambda germ: history(problem, germ, decisions))(collocation.points)


EVALUATE = Compiled(_evaluate)
OUTPUTS_AT_POINTS = Compiled(_outputs_at_points)


def compile_seconds() -> float:
    """How long all compilations for solutions have taken so far, s."""
    return EVALUATE.seconds + RESOLVE.seconds + RESPOND.seconds


@final
class _Evaluator:
    """A compiled problem that remembers its two latest points.

    So the start, needed to find scales, and the solution, needed for its moments, are not computed twice.
    """

    def __init__(self, traced: Problem, collocation: Collocation, constants: Constants):
        self._evaluate = EVALUATE.bound(traced, collocation, constants)
        self._memory: dict[bytes, Blocks] = {}

    def __call__(self, decisions: Float[np.ndarray, " n"]) -> Blocks:
        key = decisions.tobytes()
        if key not in self._memory:
            values, derivatives, samples, statistics = self._evaluate(jnp.asarray(decisions))
            while len(self._memory) > 1:
                del self._memory[next(iter(self._memory))]
            values, derivatives, statistics = (
                tuple(map(np.asarray, part)) for part in (values, derivatives, statistics)
            )
            self._memory[key] = Blocks(values, derivatives, samples, statistics)
        return self._memory[key]


@final
@dataclass(frozen=True)
class Sequential:
    """A problem transcribed: its nonlinear program, and what leads back from the program's rows to the problem.

    `rows` and `scales` are those of each constraint.
    """

    problem: Problem
    traced: Problem
    places: Survey
    basis: Basis
    collocation: Collocation
    constants: Constants
    program: NonlinearProgram
    rows: tuple[slice, ...]
    scales: tuple[float, ...]
    evaluator: _Evaluator

    def outputs(self, decisions: Float[np.ndarray, " n"]) -> dict[str, Array]:
        """Histories of all outputs at all collocation points."""
        return OUTPUTS_AT_POINTS(self.traced, self.collocation, jnp.asarray(decisions))

    def times(self, decisions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " instants"]:
        """The instants of the grid."""
        return np.asarray(grid_at(self.problem, jnp.asarray(decisions)).times)

    def statistics(self, decisions: Float[np.ndarray, " n"]) -> dict[str, Float[np.ndarray, "..."]]:
        """Every statistic that stands in the problem, by its text."""
        texts = (one.text() for one in statistics_in(self.problem.expressions))
        return dict(zip(texts, self.evaluator(decisions).statistics, strict=True))

    def resolve(self, decisions: Float[np.ndarray, " n"]) -> dict[str, Resolved]:
        """The moments and the quality of each functional's expansion, by its text."""
        functionals = functionals_of(self.problem.expressions)
        found = RESOLVE(functionals, self.collocation, self.evaluator(decisions).samples)
        return dict(zip((one.text() for one in functionals), found, strict=True))


def transcribe(problem: Problem) -> Sequential:
    """Turn a declared problem into a nonlinear program, compiling it if no problem of its structure has been before.

    Raises `ProblemError` if the problem has no decisions.
    """
    places = problem.survey
    if places.size == 0:
        raise ProblemError(
            "The problem has no decisions: put al.Decision(initial, lower, upper) in the place of a number of it."
        )
    basis, collocation, constants = discretised(problem)
    traced = numbers_to_arrays(problem)
    evaluator = _Evaluator(traced, collocation, constants)
    start = places.vector("initial")
    at_start = evaluator(start)
    decision_scale = _decision_scale(start, places.vector("lower"), places.vector("upper"))
    scales = _scales(problem, at_start, decision_scale)
    rows = _rows(at_start)
    _refuse_settled(problem, places, evaluator, scales)
    program = NonlinearProgram(
        evaluate=lambda decisions: _evaluation(evaluator(decisions)),
        start=start,
        lower=places.vector("lower"),
        upper=places.vector("upper"),
        constraint_lower=_spread(rows, [float(one.lower) for one in problem.constraints]),
        constraint_upper=_spread(rows, [float(one.upper) for one in problem.constraints]),
        constraint_scale=_spread(rows, scales),
        decision_scale=decision_scale,
    )
    return Sequential(problem, traced, places, basis, collocation, constants, program, rows, tuple(scales), evaluator)


def _refuse_settled(problem: Problem, places: Survey, evaluator: _Evaluator, scales: list[float]) -> None:
    """Refuse constraints that no decision can meet; see `refuse_settled`."""
    start, lower, upper = (places.vector(name) for name in ("initial", "lower", "upper"))
    away = np.where(start + 1e-2 <= upper, start + 1e-2, np.maximum(start - 1e-2, lower))
    refuse_settled(
        problem,
        evaluator(start).values[1:],
        evaluator(start).derivatives[1:],
        scales,
        lambda: np.asarray(grid_at(problem, jnp.asarray(start)).times),
        lambda: evaluator(away).values[1:],
    )


def _evaluation(blocks: Blocks) -> Evaluation:
    """A point in the solver's terms."""
    n = blocks.derivatives[0].shape[1]
    return Evaluation(
        objective=float(blocks.values[0][0]),
        gradient=blocks.derivatives[0][0],
        constraints=np.concatenate([np.zeros(0), *blocks.values[1:]]),
        jacobian=np.concatenate([np.zeros((0, n)), *blocks.derivatives[1:]]),
    )


def _rows(blocks: Blocks) -> tuple[slice, ...]:
    """The rows of each constraint in the program's constraint vector."""
    ends = np.cumsum([0, *(block.size for block in blocks.values[1:])]).tolist()
    return tuple(slice(first, last) for first, last in itertools.pairwise(ends))


def _spread(rows: tuple[slice, ...], numbers: list[float]) -> Float[np.ndarray, " m"]:
    """One number for each constraint, repeated over its rows."""
    return np.concatenate(
        [np.zeros(0), *(np.full(row.stop - row.start, x) for row, x in zip(rows, numbers, strict=True))]
    )


def _scales(problem: Problem, at_start: Blocks, decision_scale: Float[np.ndarray, " n"]) -> list[float]:
    """A typical magnitude of each constraint: its smaller bound, or its change over a typical change of the decisions.

    The larger of the two counts. A remote second bound says nothing of the size, nor does a bound of zero.
    """
    scales = []
    for one, slopes, values in zip(problem.constraints, at_start.derivatives[1:], at_start.values[1:], strict=True):
        bounds = [abs(float(bound)) for bound in (one.lower, one.upper) if np.isfinite(bound) and bound != 0]
        change = float(np.max(np.abs(slopes) @ decision_scale, initial=0.0))
        known = [size for size in (min(bounds, default=0.0), change) if np.isfinite(size)]
        fallback = float(np.max(np.abs(values), initial=0.0))
        scales.append(max(known) or (fallback if np.isfinite(fallback) else 0.0) or 1.0)
    return scales


def _decision_scale(start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Float[np.ndarray, " n"]:
    """A typical magnitude of each decision: its start, or a tenth of its range if that is larger."""
    span = upper - lower
    scale = np.maximum(np.abs(start), np.where(np.isfinite(span), 0.1 * span, 0.0))
    return np.where(scale > 0, scale, 1.0)
