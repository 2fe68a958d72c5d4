"""From the end of a program back to its problem: the `Solution`, how far its expansions can be trusted, or where a
simulation failed.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator import _core
from aleator._core.errors import AleatorWarning, CorrelationWarning, ExpansionWarning, GridWarning
from aleator.certification._check import Check, certain
from aleator.certification._grids import at_half_width
from aleator.certification._limits import indistinct_limit
from aleator.certification._moving_jumps import unfollowed_jumps
from aleator.certification._second_opinion import second_opinion
from aleator.design import (
    Problem,
    behind_end,
    expanded_functionals,
    first_broken,
    instants_at,
    path_of,
    statistics_in,
    unsolved,
)
from aleator.ensemble import inputs_at
from aleator.expansion import ILL_CONDITIONED, PiecewiseBasis, unseen
from aleator.nlp import HELD, Outcome, Status, missed_slope
from aleator.solution import (
    MOST_NUMBERS,
    Between,
    Certificate,
    ConstraintResult,
    Effort,
    ExpansionQuality,
    GridError,
    Moments,
    Solution,
    Times,
    WorstCase,
    system_text,
)
from aleator.statistics import Covariance, Mean, Std, Variance
from aleator.transcription import OF_ROUNDING, AbstractTranscribed, Meaning, as_read
from aleator.uncertainty import correlations_at

# The relative error of an expansion that is tolerated for moments and derivatives.
_TRUSTED, _MOMENTS = 1 / 3, (Mean, Std, Variance, Covariance)
# Differences that no data would show.
_TOLERATED = 0.01


class Held(NamedTuple):
    """The last program of a solution and its outcome, and what is known of it: None where it does not apply.

    - `check`: that of the answer; `between`: how far limits break between the instants; `error`: that of the grid;
      `worst_case`: the worst realisations; `misled`: see `Certificate`.
    """

    transcribed: AbstractTranscribed
    outcome: Outcome
    check: Check | None = None
    between: Between | None = None
    error: GridError | None = None
    worst_case: WorstCase | None = None
    misled: str = ""


def solution_of(held: Held) -> Solution:
    """The solution of a problem for an outcome of its program, but for the time of compilations."""
    transcribed, outcome, check = held.transcribed, held.outcome, held.check
    problem, places = transcribed.problem, transcribed.places
    meaning, resolved = transcribed.at(outcome.point), transcribed.resolve(outcome.point)
    names, decided = places.entry_names(), transcribed.decided
    entries = dict(zip(decided.tolist(), names, strict=True))
    costates, switching, crossed = None, None, ""
    # Multipliers of a search that was not finished say nothing of what a push would change.
    if outcome.status in (Status.SOLVED, Status.INTERRUPTED):
        costates, switching = transcribed.costates_at(outcome.point, outcome.multipliers)
        crossed = transcribed.crossed_at(outcome.point)
    return Solution(
        problem=problem,
        status=outcome.status,
        message=outcome.message,
        decisions=_plain(places.named(meaning.decisions)),
        vector=meaning.decisions,
        objective=meaning.objective,
        constraints=tuple(_constraint_results(transcribed, outcome, meaning)),
        moments={text: Moments(np.asarray(one.mean), np.asarray(one.std)) for text, one in resolved.items()},
        statistics=transcribed.statistics(outcome.point),
        at_bounds=tuple(np.array(names)[outcome.active_bounds[decided]].tolist()),
        idle=tuple(entries[i] for i in outcome.idle if i in entries),
        multipliers=outcome.multipliers,
        bound_multipliers=_plain(places.named(outcome.bound_multipliers[decided])),
        certificate=Certificate(
            violation=outcome.violation,
            stationarity=outcome.stationarity,
            complementarity=outcome.complementarity,
            expansion=_quality_of(transcribed, outcome.point, check),
            between=held.between,
            grid_error=held.error,
            worst_case=held.worst_case,
            misled=held.misled,
            crossed=crossed,
            departed="" if check is None else check.departed,
            reaches={} if check is None else {one.text(): own.reach for one, own in check.functionals.items()},
        ),
        effort=Effort(
            solver=outcome.solver,
            iterations=outcome.iterations,
            evaluations=outcome.evaluations,
            times=Times(_core.import_seconds, 0.0, outcome.seconds),
            searched=outcome.searched,
            visited=outcome.visited,
        ),
        meshes=transcribed.meshes_at(outcome.point),
        mesh_states=transcribed.states_at(outcome.point),
        costates=costates,
        switching=switching,
    )


def _plain(named: dict[str, Any]) -> dict[str, Any]:
    return {name: float(value) if np.ndim(value) == 0 else value for name, value in named.items()}


def _constraint_results(transcribed: AbstractTranscribed, outcome: Outcome, meaning: Meaning) -> list[ConstraintResult]:
    each = transcribed.problem.constraints, transcribed.rows, meaning.constraints
    results = []
    for one, rows, own in zip(*each, strict=True):
        times = transcribed.times_limited(outcome.point, path_of(one)) if one.is_path else None
        parts = as_read(one, transcribed.scenarios, own, outcome.multipliers[rows], outcome.active[rows])
        if times is not None:  # rows by instant, if there are several at each
            parts = (part if len(part) == len(times) else part.reshape(len(times), -1) for part in parts)
        values, multipliers, active = parts
        bounds, size = (float(one.lower), float(one.upper)), float(outcome.sizes[rows].max())
        results.append(ConstraintResult(one.name, str(one), *bounds, values, times, multipliers, active, size))
    return results


def _quality_of(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], check: Check | None
) -> ExpansionQuality:
    """The quality of the expansions at a point. Errors of what is constant count as zero."""
    problem, basis, collocation = transcribed.problem, transcribed.basis, transcribed.collocation
    tolerance, grid = problem.expansion.tolerance, problem.grid
    # Limits on the worst case use the model itself.
    expanded = {one.text(): one.place for one in expanded_functionals(problem.expressions)}
    resolved = {text: one for text, one in transcribed.resolve(point).items() if text in expanded}
    constant = [] if check is None else [one.text() for one in certain(check)]
    varying = {text: one for text, one in resolved.items() if text not in constant}
    return ExpansionQuality(
        order=basis.order,
        terms=basis.terms,
        points=len(collocation.points),
        condition_number=float(collocation.condition_number),
        leave_one_out={text: float(one.leave_one_out) if text in varying else 0.0 for text, one in resolved.items()},
        unresolved_from={
            text: float(transcribed.times(point)[grid.where(expanded[text])][int(np.argmax(late))])
            for text, one in varying.items()
            if one.history is not None and (late := ~(np.asarray(one.history) <= tolerance)).any()
        },
        tolerance=tolerance,
        tangents={
            text: dict(zip(transcribed.places.of_distributions, np.asarray(one.tangents).tolist(), strict=True))
            for text, one in resolved.items()
            if one.tangents is not None
        },
        unseen=unseen(basis, np.asarray(collocation.points)),
        elements=len(basis.cells) if isinstance(basis, PiecewiseBasis) else 1,
    )


def with_opinion(solution: Solution, held: Held) -> Solution:
    """A solution with what fresh systems say of its expansions, unless its grid is no good already."""
    if not solution.ok:
        return solution
    certificate = replace(
        solution.certificate,
        opinion=None if held.check is None else second_opinion(held.check),
        smoothing=None if held.check is None else at_half_width(held.check),
        lost=unfollowed_jumps(held.transcribed, held.outcome.point, solution.multipliers)
        # A search has compared values.
        or ("" if solution.effort.searched else _lost_derivatives(held, solution.multipliers)),
        extrapolated=behind_end(held.transcribed.problem, held.transcribed.points, solution.vector),
        indistinct=indistinct_limit(held.transcribed, held.outcome.point, held.check),
        untrusted=_untrusted(solution),
        correlations=_moved_correlations(solution.problem, solution.vector),
    )
    return replace(solution, certificate=certificate)


def _untrusted(solution: Solution) -> str:
    """A sentence on the statistic whose expansion is least accurate, or the derivative by a parameter of a distribution
    that an optimum inside its bounds follows from, if too inaccurate to act on; empty if none is.

    An error adds to a variance by its square: a third of the standard deviation is a ninth of the variance. Tails have
    no such advantage, and are trusted only up to the expansion's tolerance; a mean is less sensitive. A user who sets a
    higher tolerance accepts it for all of them.
    """
    problem, quality = solution.problem, solution.certificate.expansion
    # By how many times what is tolerated something is missed, and a sentence on it.
    missed = [(1.0, "")]
    for one in statistics_in(problem.expressions):
        most = max(quality.tolerance, _TRUSTED if isinstance(one.kind, _MOMENTS) else 0.0)
        for text in (functional.text() for functional in one.functionals):
            error = quality.leave_one_out.get(text, 0.0)
            # If no points are left to check it by, the error is infinite, and fresh simulations decide.
            if not np.isinf(error):
                said = (
                    f"it misses {text} by {error:.2g} of its standard deviation, where {one.text()} asks for {most:.2g}"
                )
                missed.append((np.inf if np.isnan(error) else error / most, f"{said} at most"))
    results = zip(problem.constraints, solution.constraints, strict=True)
    held = (limit.expression for limit, result in results if np.any(result.active))
    holding = {one.text() for one in expanded_functionals((problem.objective, *held))}
    most = max(quality.tolerance, _TRUSTED)
    for text, parameter, error in quality.every_tangent:
        if text in holding and parameter not in solution.at_bounds and np.isfinite(error):
            said = f"it misses the derivative of {text} by {parameter}, which the optimum follows from, by {error:.2g}"
            missed.append((error / most, f"{said} of its standard deviation, where {most:.2g} is the most"))
    return max(missed, key=lambda one: one[0])[1]


def doubts(solution: Solution) -> Iterator[tuple[type[Warning], str]]:
    """What is warned of: sentences with the kinds of their warnings."""
    certificate = solution.certificate
    quality, opinion, sentences = certificate.expansion, certificate.opinion, []
    if not quality.is_conditioned:
        sentences.append(
            f"The collocation matrix has condition number {quality.condition_number:.1e} (limit "
            f"{ILL_CONDITIONED:.0e}), so coefficients lose digits. Use more points, a lower order, or "
            "al.points.ChristoffelPoints()"
        )
    if not quality.can_be_checked:
        sentences.append(
            f"{quality.points} points for {quality.terms} terms leave nothing to check the expansion of order "
            f"{quality.order} by, so whether means and spreads can be trusted is not known. Use more points"
        )
    elif quality.unresolved:
        bad = [f"{text} ({quality.leave_one_out[text]:.2g}){quality.since(text)}" for text in quality.unresolved]
        sentences.append(
            f"The expansion of order {quality.order} does not resolve {', '.join(bad)}: its relative leave-one-out "
            f"error exceeds {quality.tolerance:g}, so means and spreads cannot be trusted. {quality.remedy}"
        )
    if opinion is not None and not opinion.agrees:
        sentences.append(f"{opinion}. {opinion.remedy}")
    if sentences and solution.status is not Status.EVALUATION_FAILED:
        yield ExpansionWarning, f"{'. '.join(sentences)}, and compare with al.validate"
    if certificate.correlations:
        yield CorrelationWarning, certificate.correlations
    if not solution.ok:
        return
    for one in solution.constraints:
        largest = float(np.max(np.abs(one.values)))
        if one.scale == OF_ROUNDING and 0 < largest <= HELD * OF_ROUNDING:
            yield (
                AleatorWarning,
                f"constraint '{one.name}' is taken to hold: its values, {largest:.2g} at most, count as rounding of "
                "zero. If they mean something, let the output be in a smaller unit",
            )
    if solution.branching is not None and solution.branching.better:
        yield (
            AleatorWarning,
            f"a better combination of integers and choices was passed over, {solution.branching.better}, since its "
            "certificate failed. Solve the problem with these values in place of the integers to see why",
        )
    mesh, error, between = solution.mesh, certificate.grid_error, certificate.between
    if mesh is not None and not mesh.is_met:
        yield (
            GridWarning,
            f"the mesh does not reach the error that was asked for: {mesh}. If the model jumps in time there, "
            "declare the jump (al.StepFunction) or make it smooth; or ask for less",
        )
    if error is not None and not error.is_met:
        yield GridWarning, f"{f'on {error.steps} steps' if error.steps else 'in what the model simulates'} {error}"
    if certificate.smoothing is not None and certificate.smoothing.broken:
        yield GridWarning, str(certificate.smoothing)
    if between is not None and between.is_costly:
        yield GridWarning, str(between)


def _lost_derivatives(held: Held, multipliers: Float[np.ndarray, " rows"]) -> str:
    """A sentence on values around an answer that do not follow their derivatives; empty if all do.

    Asked of equations alone that may lose derivatives, and of a user's own functions: JAX's are exact elsewhere.
    """
    problem = held.transcribed.problem
    equations = problem.simulation.equations
    if not (problem.code or (equations is not None and equations.may_lose_derivatives)):
        return ""
    miss = missed_slope(held.transcribed.program, held.outcome.point, multipliers)
    if miss is None:
        return ""
    return (
        f"along a random direction the objective and the limits that hold it change by {miss.seen:.3g}, where their "
        f"derivatives say {miss.exact:.3g}: the model rounds, stops gradients, or has a wrong rule of differentiation. "
        "Mend that (al.examine names the numbers), or let a search compare values (al.solvers.DifferentialEvolution())"
    )


def _moved_correlations(problem: Problem, decisions: Float[np.ndarray, " n"]) -> str:
    """Which correlations differ from those declared, in a sentence; empty if none does."""
    places = problem.placements
    if not any(one.dependence is not None and one.shape_is_decided for one in places.distributions.values()):
        return ""
    declared, now = (correlations_at(places, one) for one in (places.vector("initial"), decisions))
    moved = [pair for pair in declared if not abs(now[pair] - declared[pair]) <= _TOLERATED]
    if not moved:
        return ""
    texts = ", ".join(
        f"{now[pair]:.3g} between {' and '.join(pair)} in the place of {declared[pair]:.3g}" for pair in moved
    )
    return (
        f"at this design correlations are {texts}: a decision sets a shape, and a copula keeps to the shapes in which "
        "it was made. Make it with this design as the initial values of its decisions, and solve again"
    )


def diagnose(transcribed: AbstractTranscribed, decisions: Float[np.ndarray, " n"]) -> str:
    """A message on the first point, output and instant whose value is not finite: the reason, then a few numbers."""
    outputs = {name: np.asarray(values) for name, values in transcribed.outputs(decisions).items()}
    broken = first_broken(outputs, transcribed.problem.grid)
    numbers, x = dict(zip(transcribed.places.entry_names(), decisions.tolist(), strict=True)), jnp.asarray(decisions)
    if broken is None:
        return (
            "Where the solver stopped, every simulation is finite, but the objective, a constraint or its derivative "
            "is not: look for a root or logarithm of zero, or a division by zero, in outputs or cost curves. The "
            f"decisions are {system_text(numbers)}."
        )
    name, point, instant = broken
    germ = jnp.asarray(transcribed.points[point])
    uncertain, count = inputs_at(transcribed.places, germ, x), len(transcribed.collocation.points)
    # The realisation's numbers take precedence: one of many failed, while all have the same decisions.
    realised = min(len(uncertain), MOST_NUMBERS - min(len(numbers), 2))
    place = f"collocation point {point + 1} of {count}" if point < count else "a scenario of the worst case"
    finite = [np.isfinite(values).all(axis=tuple(range(1, values.ndim))) for values in outputs.values()]
    failed = int(np.sum(~np.all(finite, axis=0)))
    share = f", one of {failed} that fail" if failed > 1 else ""
    who = f"{place} ({system_text(uncertain, realised)}){share}" if uncertain else ""
    where = f"The decisions are {system_text(numbers, MOST_NUMBERS - realised)}."
    if reason := unsolved(transcribed.problem, germ, x):
        return f"{reason.rstrip('.')}.{who and f' This is {who}.'} {where}"
    what = f"The simulation{who and ' of ' + who} is not finite: output '{name}'"
    if not transcribed.problem.system.has_time:
        return f"{what}. Look for a root or logarithm of zero, or a division by zero. {where}"
    return (
        f"{what} from t = {instants_at(transcribed.problem, decisions)[instant]:.4g} s on. Shorten the time step, "
        f"tighten the decisions' bounds or use an implicit integrator (al.integrators.Rodas5P). {where}"
    )
