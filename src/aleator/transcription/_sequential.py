"""Sequential transcription: simulate inside, optimise outside (SeqNLP, equations 93, 95 and 122).

The decisions are the only variables of the nonlinear program; the dynamics are solved exactly at every evaluation. The
values and the Jacobian of the objective and of all constraints come from one compiled function.
"""

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator._core.errors import ProblemError
from aleator.design import Problem, current, history, refuse_changed_code
from aleator.expansion import Basis, Collocation
from aleator.nlp import NonlinearProgram
from aleator.statistics import Constants
from aleator.transcription._alone import middle
from aleator.transcription._discretisation import RESPOND, discretised
from aleator.transcription._evaluator import COMBINE, CONTRIBUTE, EVALUATE, Evaluator, evaluation_of
from aleator.transcription._instantaneous import FEATURES, anchors_of, instantaneous
from aleator.transcription._magnitudes import (
    Sizing,
    decision_scales,
    elsewhere,
    largest_of,
    least_objective,
    needs_more,
    spread,
)
from aleator.transcription._oracle import REACHED
from aleator.transcription._resolution import RESOLVE, Resolved
from aleator.transcription._rows import row_bounds, rows_of
from aleator.transcription._scenarios import Scenarios, first_scenarios
from aleator.transcription._settled import refuse_settled
from aleator.transcription._structure import nearby, structure_of
from aleator.transcription._texts import Texts
from aleator.uncertainty import Survey

# Enough for a problem and its deterministic twin, each solved from many starts.
_KEPT = 4


def _outputs_at_points(
    problem: Problem, points: Float[Array, "points variables"], decisions: Float[Array, " n"]
) -> dict[str, Array]:
    return jax.vmap(lambda germ: history(problem, germ, decisions))(points)


OUTPUTS_AT_POINTS = Compiled(_outputs_at_points, use=Use.ONCE, unchanged=refuse_changed_code)


def compile_seconds() -> float:
    """How long all compilations for solutions have taken so far, s."""
    every = EVALUATE, CONTRIBUTE, COMBINE, RESOLVE, RESPOND, FEATURES, REACHED
    return sum(one.seconds for one in every)


@final
@dataclass(frozen=True)
class Sequential:
    """A problem transcribed: its nonlinear program, and what leads back from the program's rows to the problem.

    `rows` and `scales` (magnitudes at the start) are those of each constraint; `begun`: each functional at the start
    for the system in the middle of the family; `texts`: how the problem is written;
    `sizing`: how large its constraints are anywhere; `scenarios`: where its limits on the worst case are held, if it
    has any.
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
    begun: tuple[Float[np.ndarray, "..."], ...]
    evaluator: Evaluator
    texts: Texts
    sizing: Sizing
    scenarios: Scenarios | None = None

    @property
    def points(self) -> Float[np.ndarray, "points variables"]:
        """All germ points at which the model is simulated: the collocation points, then the scenarios."""
        points = np.asarray(self.collocation.points)
        return points if self.scenarios is None else np.concatenate([points, self.scenarios.points])

    def outputs(self, decisions: Float[np.ndarray, " n"]) -> dict[str, Array]:
        """Histories of all outputs at all `points`."""
        return OUTPUTS_AT_POINTS(self.traced, jnp.asarray(self.points), jnp.asarray(decisions))

    def times(self, decisions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " instants"]:
        """The instants of the grid."""
        return self.evaluator(decisions).times

    def constraints(self, decisions: Float[np.ndarray, " n"]) -> list[Float[np.ndarray, " rows"]]:
        """The rows of each constraint."""
        blocks = self.evaluator(decisions)
        return blocks.by_constraint(blocks.values)

    def statistics(self, decisions: Float[np.ndarray, " n"]) -> dict[str, Float[np.ndarray, "..."]]:
        """Every statistic that stands in the problem, by its text."""
        return dict(zip(self.texts.statistics, self.evaluator(decisions).statistics, strict=True))

    def resolve(self, decisions: Float[np.ndarray, " n"]) -> dict[str, Resolved]:
        """The moments and the quality of each functional's expansion, by its text."""
        return dict(zip(self.texts.functionals, self.evaluator.resolved(decisions), strict=True))


_RECENT: deque[tuple[list[Any], Sequential]] = deque(maxlen=_KEPT)
_LOCK = threading.Lock()


Meanwhile = Callable[[Problem, Collocation, Constants], object]


def transcribe(problem: Problem, meanwhile: Meanwhile = lambda *_: None) -> Sequential:
    """Turn a declared problem into a nonlinear program, compiling it if no problem of its structure has been before.

    `meanwhile` is called just before it is compiled, to begin what can be done beside that.

    A problem that was transcribed a short while ago, such as by a solution from another start, is not again. One whose
    code has changed since it was declared is transcribed as it is now. Raises `ProblemError` if the problem has no
    decisions.
    """
    problem = current(problem)
    numbers = jax.tree.leaves(problem)
    with _LOCK:
        recent = list(_RECENT)
    for known, found in recent:
        if found.problem is problem and _same(known, numbers):
            return found
    found = _transcribed(problem, meanwhile)
    with _LOCK:
        _RECENT.append(([leaf.copy() if isinstance(leaf, np.ndarray) else leaf for leaf in numbers], found))
    return found


def _same(first: list[Any], second: list[Any]) -> bool:
    """Whether the numbers of a problem are still what they were: arrays can be changed in place."""
    return len(first) == len(second) and all(
        np.array_equal(one, other) if isinstance(one, np.ndarray) else one is other
        for one, other in zip(first, second, strict=True)
    )


def _transcribed(problem: Problem, meanwhile: Meanwhile) -> Sequential:
    places = problem.survey
    if places.size == 0:
        raise ProblemError(
            "The problem has no decisions: put al.Decision(initial, lower, upper) in the place of a number of it."
        )
    scenarios = first_scenarios(problem)
    basis, collocation, constants = discretised(problem)
    if scenarios is not None:
        constants = replace(constants, scenarios=jnp.asarray(scenarios.points))
    traced = numbers_to_arrays(problem)
    start, lower, upper = (places.vector(name) for name in ("initial", "lower", "upper"))
    evaluator = Evaluator(traced, collocation, constants, anchors_of(traced, collocation, start))
    if not evaluator.is_known(start):
        meanwhile(problem, collocation, constants)
    decision_scale = decision_scales(start, lower, upper)
    around = nearby(start, lower, upper, decision_scale)
    beside = [evaluator(one) for one in around] if instantaneous(problem) else []
    # The start comes last, for it is asked for again: the evaluator remembers it.
    at_start = evaluator(start)
    rows = rows_of(at_start.sizes[1:])
    values, derivatives = map(at_start.by_constraint, (at_start.values, at_start.derivatives))
    unknown = not beside and needs_more(problem.constraints, values, derivatives, decision_scale)
    seen = [at_start, *beside, *([evaluator(around[0])] if unknown else [])]
    away = largest_of([one.by_constraint(one.values) for one in seen])
    sizing = Sizing(problem.constraints, rows, decision_scale, away)
    sizes = sizing.each(start, values, derivatives)
    scales = [one.size for one in sizes]
    refuse_settled(
        problem,
        values,
        derivatives,
        scales,
        lambda: at_start.times,
        lambda: [(found := evaluator(one)).by_constraint(found.values) for one in elsewhere(start, lower, upper)],
    )
    paths = [where for where, one in zip(rows, problem.constraints, strict=True) if one.is_path]
    found = [one.derivatives[1:] != 0 for one in (at_start, *beside)]
    constraint_lower, constraint_upper = row_bounds(problem.constraints, rows, scenarios)
    program = NonlinearProgram(
        evaluate=lambda decisions: evaluation_of(evaluator(decisions)),
        start=start,
        lower=lower,
        upper=upper,
        constraint_lower=constraint_lower,
        constraint_upper=constraint_upper,
        constraint_scale=spread(rows, [one.scale for one in sizes]),
        decision_scale=decision_scale,
        structure=structure_of(np.any(found, axis=0), paths, len(at_start.times)) if beside else None,
        magnitudes=sizing.at,
        least=least_objective(problem),
    )
    discretisation = basis, collocation, constants
    which = middle(collocation)
    begun = tuple(np.array(one[which]) for one in at_start.samples)
    back = program, rows, tuple(scales), begun, evaluator, Texts.of(problem), sizing, scenarios
    return Sequential(problem, traced, places, *discretisation, *back)
