"""Sequential transcription: simulate inside, optimise outside (SeqNLP, equations 93, 95 and 122).

The decisions are the only variables of the nonlinear program; every evaluation integrates the dynamics. The values and
the Jacobian of the objective and of all constraints come from one compiled function, exact second derivatives, where
decisions are few, from another one. Rows of splines depend on few decisions each, which the Jacobian's sparsity says.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.border import refusal
from aleator._core.compilation import Compiled
from aleator.design import AbstractFunctional, Problem, ends_by_event, functionals_of, instants_at
from aleator.expansion import Collocation
from aleator.nlp import Hessian, NonlinearProgram, with_entries
from aleator.statistics import Constants, Std
from aleator.transcription._abstract import AbstractTranscribed, AbstractTranscription, Meaning, Meanwhile
from aleator.transcription._constraints import (
    Sizing,
    decision_scales,
    elsewhere,
    largest_of,
    least_objective,
    needs_more,
    refuse_unsatisfiable,
    row_bounds,
    rows_of,
    spread,
    spreads_of,
)
from aleator.transcription._discretised import Discretised, Scenarios, discretised, first_scenarios
from aleator.transcription._expansions import scope_of
from aleator.transcription.sequential._evaluator import Evaluator, use_of
from aleator.transcription.sequential._instantaneous import anchors_of, instantaneous
from aleator.transcription.sequential._population import Population

# How many points near the start show which derivatives are zero everywhere, and how far away they are.
_NEARBY, _DISTANCE = 3, 0.1


def _sparsity(nonzero: Bool[np.ndarray, "rows n"], paths: Sequence[slice], instants: int) -> Bool[np.ndarray, "rows n"]:
    """The derivatives that may be nonzero, from those that are nonzero at some decisions.

    A constraint on a path, whose rows are in `paths`, counts as depending on a decision at an instant if it did so at
    any instant, and if any such constraint did so at this one: so interactions of bodies that are near each other only
    for a while count wherever they may occur. Other constraints may depend on everything.
    """
    sparsity = np.ones_like(nonzero)
    felt = np.zeros((instants, nonzero.shape[1]), dtype=bool)
    for where in paths:
        felt |= nonzero[where].reshape(instants, -1, nonzero.shape[1]).any(axis=1)
    for where in paths:
        block = nonzero[where]
        sparsity[where] = np.repeat(felt, len(block) // instants, axis=0) & block.any(axis=0)
    return sparsity


class _At(NamedTuple):
    """Decisions, the weight of the objective, and the multipliers of all rows."""

    decisions: Float[Array, " n"]
    weight: Float[Array, ""]
    multipliers: Float[Array, " m"]


def _curvature(problem: Problem, collocation: Collocation, constants: Constants, at: _At) -> Float[Array, "n n"]:
    """The second derivatives of `weight f + multipliers · c`: forward mode twice, `n²` directions in one simulation."""
    functionals = functionals_of(problem.expressions)

    def lagrangian(decisions: Float[Array, " n"]) -> Float[Array, ""]:
        scope, _ = scope_of(problem, functionals, collocation, constants, decisions)
        values, _ = scope.evaluated(problem.expressions)
        rows = jnp.concatenate(values)
        return at.weight * rows[0] + at.multipliers @ rows[1:]

    return jax.jacfwd(jax.jacfwd(lagrangian))(at.decisions)


CURVATURE = Compiled(_curvature, use=lambda problem, collocation, *_: use_of(problem, len(collocation.points)))


def _hessian(traced: Problem, discretised: Discretised, size: int) -> Hessian:
    """Second derivatives for solvers of a problem with `size` decisions."""
    evaluate = CURVATURE.bound(traced, discretised.collocation, discretised.constants)
    rows, columns = np.tril_indices(size)
    triangle = scipy.sparse.csr_array((np.ones(rows.size), (rows, columns)), shape=(size, size))

    def lower(x: np.ndarray, weight: float, multipliers: np.ndarray) -> Any:
        whole = np.asarray(evaluate(_At(*map(jax_array, (x, float(weight), multipliers)))))
        return with_entries(triangle, whole[rows, columns])

    return Hessian(lower, triangle)


@final
@dataclass(frozen=True, kw_only=True)
class SequentiallyTranscribed(AbstractTranscribed):
    """A problem as a program in its decisions alone. `sizing`: the magnitudes of its constraints at any decisions."""

    evaluator: Evaluator
    sizing: Sizing

    @property
    @override
    def decided(self) -> Int[np.ndarray, " n"]:
        return np.arange(self.program.start.size)

    @override
    def point(self, decisions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return decisions

    @override
    def at(self, point: Float[np.ndarray, " n"]) -> Meaning:
        return self.evaluator(point).meaning

    @override
    def times(self, point: Float[np.ndarray, " n"]) -> Float[np.ndarray, " instants"]:
        # Of events, a program of its own tells them, which most answers do not need.
        return instants_at(self.problem, point) if ends_by_event(self.problem) else self.evaluator(point).times

    @override
    def at_scenarios(self, scenarios: Scenarios) -> "SequentiallyTranscribed":
        """The same program with limits on the worst case imposed at other scenarios; more slots need compilation."""
        discretised = self.discretised.at_scenarios(scenarios)
        evaluator, program = Evaluator(self.traced, discretised, self.evaluator.anchors), self.program
        same = self.scenarios is not None and len(scenarios.used) == len(self.scenarios.used)
        rows = self.rows if same else rows_of(evaluator(program.start).meaning.constraints)
        lower, upper = row_bounds(self.problem.constraints, rows, scenarios, self.scales)
        scales = [float(program.constraint_scale[one.start]) for one in self.rows]
        sizing = replace(self.sizing, rows=rows)
        program = replace(
            program,
            evaluate=lambda decisions: evaluator(decisions).evaluation,
            constraint_lower=lower,
            constraint_upper=upper,
            constraint_scale=spread(rows, scales),
            sparsity=program.sparsity if same else None,
            sizes=sizing.at,
            values=Population(self.traced, discretised.collocation, discretised.constants),
            hessian=None if program.hessian is None else _hessian(self.traced, discretised, program.start.size),
        )
        own = {"discretised": discretised, "evaluator": evaluator, "sizing": sizing}
        return replace(self, rows=rows, program=program, scenarios=scenarios, **own)


@final
@dataclass(frozen=True)
class Sequential(AbstractTranscription):
    """Simulate inside, optimise outside: few decisions, thousands of rows, dynamics that hold at every iterate.

    For systems that can be simulated from start to end whatever the decisions are (SeqNLP, equations 93, 95 and 122).

    - `second_derivatives`: whether solvers get exact ones of the Lagrangian, instead of collecting curvature from
      iteration to iteration. Each costs as much as `n²` simulations without derivatives for `n` decisions, and one more
      compilation: worth it for a few decisions on flat objectives, such as controls on singular arcs. The model, and
      functions of one's own, must then be differentiable twice.

    Raises `ProblemError` for anything but True or False.
    """

    second_derivatives: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.second_derivatives, bool):
            raise refusal("Sequential: second_derivatives", "True or False", self.second_derivatives)

    @override
    def transcribed(self, problem: Problem, meanwhile: Meanwhile) -> SequentiallyTranscribed:
        discretisation, traced = discretised(problem), numbers_to_arrays(problem.with_tables_looked_up())
        scenarios = first_scenarios(problem, np.asarray(discretisation.collocation.points))
        discretisation = discretisation.at_scenarios(scenarios)
        start, lower, upper = (problem.placements.vector(name) for name in ("initial", "lower", "upper"))
        anchors = anchors_of(traced, discretisation.collocation, start)
        evaluator = Evaluator(traced, discretisation, anchors)
        if not evaluator.is_known(start):
            # Compiled on another core, and meanwhile the check on this one.
            evaluator.begin(start, lambda: meanwhile(problem, discretisation)())
        decision_scale = decision_scales(start, lower, upper)
        # Few derivatives vanish at all of these.
        steps = _DISTANCE * np.random.default_rng(0).uniform(-1, 1, (_NEARBY, len(start)))
        around = list(np.clip(start + decision_scale * steps, lower, upper))
        beside = [evaluator(one) for one in around] if instantaneous(problem) else []
        # The start comes last, so that the evaluator still remembers it when it is needed again.
        at_start = evaluator(start)
        values, (_, *derivatives) = at_start.meaning.constraints, at_start.derivatives
        rows = rows_of(values)
        unknown = not beside and needs_more(problem.constraints, values, derivatives, decision_scale)
        seen = [at_start, *beside, *([evaluator(around[0])] if unknown else [])]
        away = largest_of([one.meaning.constraints for one in seen])
        samples = dict(zip(functionals_of(problem.expressions), at_start.meaning.samples, strict=True))

        @functools.cache
        def std_of(functional: AbstractFunctional) -> Float[np.ndarray, "..."]:
            terms = discretisation.collocation.coefficients(jax_array(samples[functional]))
            return np.asarray(Std().of(terms, ()))

        spreads = spreads_of(problem.constraints, std_of)
        sizing = Sizing(problem.constraints, rows, decision_scale, away, spreads)
        sizes = sizing.each(start, values, derivatives)
        refuse_unsatisfiable(
            problem,
            values,
            derivatives,
            sizes,
            at_start.times,
            lambda: [evaluator(one).meaning.constraints for one in elsewhere(start, lower, upper)],
        )
        paths = [where for where, one in zip(rows, problem.constraints, strict=True) if one.is_path]
        nonzero = [one.evaluation.jacobian != 0 for one in (at_start, *beside)]
        constraint_lower, constraint_upper = row_bounds(problem.constraints, rows, scenarios, sizes)
        program = NonlinearProgram(
            evaluate=lambda decisions: evaluator(decisions).evaluation,
            start=start,
            lower=lower,
            upper=upper,
            constraint_lower=constraint_lower,
            constraint_upper=constraint_upper,
            constraint_scale=spread(rows, sizing.first_divisors(sizes, derivatives)),
            variable_scale=decision_scale,
            sparsity=_sparsity(np.any(nonzero, axis=0), paths, len(at_start.times)) if beside else None,
            sizes=sizing.at,
            least=least_objective(problem),
            values=Population(traced, discretisation.collocation, discretisation.constants),
            hessian=_hessian(traced, discretisation, start.size) if self.second_derivatives else None,
        )
        return SequentiallyTranscribed(
            problem,
            traced,
            discretisation,
            program,
            rows,
            tuple(sizes),
            scenarios,
            evaluator=evaluator,
            sizing=sizing,
        )
