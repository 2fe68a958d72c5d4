"""From the end of a program back to its problem: the `Solution`, what the model says against it, or where a simulation
failed.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator import _core
from aleator._core.errors import AleatorWarning, CorrelationWarning, ExpansionWarning, GridWarning
from aleator.certification._check import Check
from aleator.certification._grids import at_half_width
from aleator.certification._limits import constraint_results, statistics_at, within_reach_of_errors
from aleator.certification._moving_jumps import unfollowed_jumps
from aleator.certification._second_opinion import second_opinion
from aleator.design import (
    Constraint,
    Peak,
    Problem,
    as_declared,
    behind_end,
    expanded_functionals,
    first_broken,
    instants_at,
    may_lose_derivatives,
    statistics_in,
    unsolved,
)
from aleator.ensemble import inputs_at
from aleator.expansion import ILL_CONDITIONED, PiecewiseBasis, unseen
from aleator.nlp import HELD, Outcome, Status, missed_slope
from aleator.solution import (
    Between,
    Certificate,
    Effort,
    ExpansionQuality,
    GridError,
    Moments,
    Objection,
    Solution,
    Times,
    WorstCase,
    system_text,
)
from aleator.statistics import Covariance, Mean, Std, Variance
from aleator.transcription import NOISE, OF_ROUNDING, AbstractTranscribed, bound_size, excess_of
from aleator.uncertainty import correlations_at

# The relative error of an expansion that is tolerated for moments and derivatives.
_TRUSTED, _MOMENTS = 1 / 3, (Mean, Std, Variance, Covariance)
# Differences that no data would show.
_TOLERATED = 0.01
# A limit of zero is broken by more than this part of its values, which follow the decisions if they are nearly straight
# over steps of this part of a typical magnitude.
_BROKEN, _MOVED, _STRAIGHT = 1e-3, 1e-3, 0.1


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

    @property
    def excess(self) -> float:
        """How far limits break between the instants; 0 if that was not checked."""
        return 0.0 if self.between is None else self.between.worst


def solution_of(held: Held) -> Solution:
    """The solution of a problem for an outcome of its program, but for the time of compilations."""
    transcribed, outcome, check = held.transcribed, held.outcome, held.check
    problem, places, point = transcribed.problem, transcribed.places, outcome.point
    meaning, names, decided = transcribed.at(point), places.entry_names(), transcribed.decided
    entries = dict(zip(decided.tolist(), names, strict=True))
    costates, switching, crossed = None, None, ""
    # Multipliers of a search that was not finished say nothing of what a push would change.
    if outcome.status in (Status.SOLVED, Status.INTERRUPTED):
        costates, switching = transcribed.costates_at(point, outcome.multipliers)
        crossed = transcribed.crossed_at(point)
    objection = Objection("a realisation does not end at the first event", f"solved, but {crossed}")
    resolved = transcribed.resolve(point).items()
    return Solution(
        problem=as_declared(problem),
        status=outcome.status,
        message=outcome.message,
        decisions=_plain(places.named(meaning.decisions)),
        vector=meaning.decisions,
        objective=meaning.objective,
        constraints=tuple(constraint_results(transcribed, outcome)),
        moments={text: Moments(np.asarray(one.mean), np.asarray(one.std)) for text, one in resolved},
        statistics=statistics_at(transcribed, point),
        at_bounds=tuple(np.array(names)[outcome.active_bounds[decided]].tolist()),
        idle=tuple(entries[i] for i in outcome.idle if i in entries),
        multipliers=outcome.multipliers,
        bound_multipliers=_plain(places.named(outcome.bound_multipliers[decided])),
        certificate=Certificate(
            violation=outcome.violation,
            stationarity=outcome.stationarity,
            complementarity=outcome.complementarity,
            expansion=_quality_of(transcribed, point, check),
            between=held.between,
            grid_error=held.error,
            worst_case=held.worst_case,
            objections=(objection,) if crossed else (),
            misled=held.misled,
            departed="" if check is None else check.simulations.departed,
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
        meshes=transcribed.meshes_at(point),
        mesh_states=transcribed.states_at(point),
        costates=costates,
        switching=switching,
    )


def _plain(named: dict[str, Any]) -> dict[str, Any]:
    return {name: float(value) if np.ndim(value) == 0 else value for name, value in named.items()}


def _quality_of(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], check: Check | None
) -> ExpansionQuality:
    """The quality of the expansions at a point. Errors of what is constant count as zero."""
    problem, basis, collocation = transcribed.problem, transcribed.basis, transcribed.collocation
    tolerance, grid, times = problem.expansion.tolerance, problem.grid, transcribed.times(point)
    certain = () if check is None else [one.text() for one, own in check.functionals.items() if own.is_certain]
    errors, late, tangents = dict[str, float](), dict[str, float](), dict[str, dict[str, float]]()
    resolved = transcribed.resolve(point)
    # Limits on the worst case use the model itself.
    for functional in expanded_functionals(problem.expressions):
        text = functional.text()
        one, varies = resolved[text], text not in certain and len(problem.placements.germs) > 0
        errors[text] = float(one.leave_one_out) if varies else 0.0
        if varies and one.history is not None and (missed := ~(np.asarray(one.history) <= tolerance)).any():
            late[text] = float(times[grid.where(functional.place)][int(np.argmax(missed))])
        if one.tangents is not None:
            tangents[text] = dict(
                zip(transcribed.places.of_distributions, np.asarray(one.tangents).tolist(), strict=True)
            )
    return ExpansionQuality(
        order=basis.order,
        terms=basis.terms,
        points=len(collocation.points),
        condition_number=float(collocation.condition_number),
        leave_one_out=errors,
        unresolved_from=late,
        tolerance=tolerance,
        tangents=tangents,
        unseen=unseen(basis, np.asarray(collocation.points)),
        elements=len(basis.cells) if isinstance(basis, PiecewiseBasis) else 1,
    )


def with_opinion(solution: Solution, held: Held) -> Solution:
    """A solution with what fresh systems say of its expansions, unless its grid is no good already."""
    if not solution.ok:
        return solution
    check, problem = held.check, held.transcribed.problem
    opinion = None if check is None else second_opinion(check)
    is_contradicted = opinion is not None and opinion.broken
    phrases = {
        "data lie behind the end of the motion": behind_end(problem, held.transcribed.points, solution.vector),
        "a broken limit of zero is as small as rounding": _indistinct_limit(held),
        "values do not follow their derivatives": _lost_derivatives(held, solution),
        "the expansion is too coarse for the statistics asked of it": "" if is_contradicted else _untrusted(solution),
    }
    certificate = replace(
        solution.certificate,
        opinion=opinion,
        smoothing=None if check is None else at_half_width(check),
        objections=tuple(Objection(phrase, f"solved, but {said}") for phrase, said in phrases.items() if said),
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
    trusted = max(quality.tolerance, _TRUSTED)
    # By how many times what is tolerated something is missed, and what.
    missed = [(1.0, "", "")]
    for one in statistics_in((problem.objective, *within_reach_of_errors(solution))):
        most = trusted if isinstance(one.kind, _MOMENTS) else quality.tolerance
        for text in (functional.text() for functional in one.functionals):
            error = quality.leave_one_out.get(text, 0.0)
            # If no points are left to check it by, the error is infinite, and fresh simulations decide.
            if not np.isinf(error):
                said = f"{text} by {error:.2g} of its standard deviation, where {one.text()} asks for"
                by = np.inf if np.isnan(error) else error / most
                missed.append((by, f"{said} {most:.2g} at most", quality.remedy))
    results = zip(problem.constraints, solution.constraints, strict=True)
    held = (limit.expression for limit, result in results if np.any(result.active))
    for one in expanded_functionals((problem.objective, *held)):
        # The peak of a motion goes from instant to instant.
        text, remedy = one.text(), "Use more steps" if isinstance(one, Peak) else quality.remedy
        for parameter, error in quality.tangents.get(text, {}).items():
            if parameter not in solution.at_bounds and np.isfinite(error):
                said = f"the derivative of {text} by {parameter}, which the optimum follows from, by {error:.2g} of its"
                missed.append((error / trusted, f"{said} standard deviation, where {trusted:.2g} is the most", remedy))
    _, worst, remedy = max(missed, key=lambda one: one[0])
    return worst and (
        f"the expansion of order {quality.order} misses {worst}. {remedy}; or say that you accept it, "
        "al.Expansion(order, tolerance=...), and trust al.validate alone"
    )


def _lost_derivatives(held: Held, solution: Solution) -> str:
    """A sentence on values around an answer that do not follow their derivatives; empty if all do.

    Asked of equations alone that may lose derivatives, and of a user's own code: JAX's are exact elsewhere.
    """
    problem, multipliers, point = held.transcribed.problem, solution.multipliers, held.outcome.point
    if jumped := unfollowed_jumps(held.transcribed, point, multipliers):
        return jumped
    # A search has compared values.
    if solution.effort.searched or not may_lose_derivatives(problem):
        return ""
    miss = missed_slope(held.transcribed.program, point, multipliers)
    if miss is None:
        return ""
    return (
        f"along a random direction the objective and the limits that hold it change by {miss.seen:.3g}, where their "
        f"derivatives say {miss.exact:.3g}: the model rounds, stops gradients, or has a wrong rule of differentiation. "
        "Mend that (al.examine names the numbers), or let a search compare values (al.solvers.DifferentialEvolution())"
    )


def _indistinct_limit(held: Held) -> str:
    """A sentence on a limit of zero that is broken by values so small that they count as rounding, though they follow
    the decisions, as those of an output in too large a unit do; empty if there is none.

    Nothing tells these from rounding of a constant, such as `sin(pi)`, that a decision multiplies.
    """
    transcribed, point, check = held.transcribed, held.outcome.point, held.check
    problem, every = transcribed.problem, transcribed.at(point).constraints

    def is_suspect(one: Constraint, values: Float[np.ndarray, "..."]) -> bool:
        largest = float(np.max(np.abs(values), initial=0.0))
        is_broken = float(excess_of(one, values).max(initial=0.0)) > _BROKEN * largest
        small = is_broken and largest <= NOISE and not bound_size(one)
        return small and (check is None or check.reach_of(one.expression) <= NOISE)

    suspects = [i for i, (one, own) in enumerate(zip(problem.constraints, every, strict=True)) if is_suspect(one, own)]
    if not suspects:
        return ""
    here, lower, upper = transcribed.decisions(point), *map(problem.placements.vector, ("lower", "upper"))
    step = _MOVED * transcribed.decisions(transcribed.program.variable_scale)
    step *= np.random.default_rng(0).uniform(0.5, 1.5, here.size) * np.where(here + 5 * step > upper, -1, 1)
    moved = [transcribed.point(np.clip(here + i * step, lower, upper)) for i in range(4)]
    values = [transcribed.at(one).constraints for one in moved]
    for i in suspects:
        along = np.array([one[i] for one in values])
        change, bend = (float(np.linalg.norm(np.diff(along, order, axis=0))) for order in (1, 2))
        if np.max(np.abs(along)) <= NOISE and bend < _STRAIGHT * change:
            one, excess = problem.constraints[i], float(excess_of(problem.constraints[i], every[i]).max())
            return (
                f"'{one.name}' ({one}) is broken by {excess:.2g}. Values so small count as rounding of zero, but these "
                "follow the decisions: let the output be in a smaller unit; or, if they are rounding, drop the limit"
            )
    return ""


def _moved_correlations(problem: Problem, decisions: Float[np.ndarray, " n"]) -> str:
    """Which correlations differ from those declared, in a sentence; empty if none does."""
    places = problem.placements
    if not any(one.dependence is not None and one.shape_is_decided for one in places.distributions.values()):
        return ""
    declared, now = (correlations_at(places, one) for one in (places.vector("initial"), decisions))
    moved = [pair for pair in declared if not abs(now[pair] - declared[pair]) <= _TOLERATED]
    if not moved:
        return ""
    texts = (f"{now[pair]:.3g} between {' and '.join(pair)} in place of {declared[pair]:.3g}" for pair in moved)
    return (
        f"at this design correlations are {', '.join(texts)}: a decision sets a shape, and a copula keeps to the "
        "shapes in which it was made. Make it with this design as the initial values of its decisions, and solve again"
    )


def doubts(solution: Solution) -> Iterator[tuple[type[Warning], str]]:
    """What is warned of: sentences with the kinds of their warnings."""
    certificate, mesh = solution.certificate, solution.mesh
    quality, opinion, said = certificate.expansion, certificate.opinion, []
    if not quality.condition_number <= ILL_CONDITIONED:
        said.append(
            f"The collocation matrix has condition number {quality.condition_number:.1e}, above {ILL_CONDITIONED:.0e}, "
            "so that coefficients lose digits. Use more points, a lower order, or al.points.ChristoffelPoints()"
        )
    if not quality.can_be_checked:
        said.append(
            f"{quality.points} points for {quality.terms} terms leave nothing to check the expansion of order "
            f"{quality.order} by, so whether means and spreads can be trusted is not known. Use more points"
        )
    elif quality.unresolved:
        # An error of all instants together may be small where it is large from one on.
        errors = {text: error for text, error in quality.leave_one_out.items() if not error <= quality.tolerance}
        sizes = {text: f" ({error:.2g})" for text, error in errors.items()}
        bad = [f"{text}{sizes.get(text, '')}{quality.since(text)}" for text in quality.unresolved]
        said.append(
            f"The expansion of order {quality.order} does not resolve {', '.join(bad)}: its relative leave-one-out "
            f"error exceeds {quality.tolerance:g}, so means and spreads cannot be trusted. {quality.remedy}"
        )
    if opinion is not None and not opinion.agrees:
        said.append(f"{opinion}. {opinion.remedy}")
    if said and solution.status is not Status.EVALUATION_FAILED:
        yield ExpansionWarning, f"{'. '.join(said)}, and compare with al.validate"
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
    error, between, smoothing = certificate.grid_error, certificate.between, certificate.smoothing
    if mesh is not None and not mesh.is_met:
        yield (
            GridWarning,
            f"the mesh does not reach the error that was asked for: {mesh}. If the model jumps in time there, "
            "declare the jump (al.StepFunction) or make it smooth; or ask for less",
        )
    if error is not None and not error.is_met:
        yield GridWarning, f"{f'on {error.steps} steps' if error.steps else 'in what the model simulates'} {error}"
    if certificate.misled:
        yield GridWarning, certificate.misled
    if smoothing is not None and smoothing.broken:
        yield GridWarning, str(smoothing)
    if between is not None and between.is_costly:
        yield GridWarning, str(between)


def diagnose(transcribed: AbstractTranscribed, decisions: Float[np.ndarray, " n"]) -> str:
    """A message on the first point, output and instant whose value is not finite: the reason, then a few numbers."""
    outputs = {name: np.asarray(values) for name, values in transcribed.outputs(decisions).items()}
    broken = first_broken(outputs, transcribed.problem.grid)
    numbers, x = dict(zip(transcribed.places.entry_names(), decisions.tolist(), strict=True)), jnp.asarray(decisions)
    where = f"The decisions are {system_text(numbers)}."
    if broken is None:
        return (
            "Where the solver stopped, every simulation is finite, but the objective, a constraint or its derivative "
            f"is not: look for a root or logarithm of zero, or a division by zero. {where}"
        )
    name, point, instant = broken
    germ, count = jnp.asarray(transcribed.points[point]), len(transcribed.collocation.points)
    uncertain = inputs_at(transcribed.places, germ, x)
    place = f"collocation point {point + 1} of {count}" if point < count else "a scenario of the worst case"
    who = f"{place} ({system_text(uncertain)})" if uncertain else ""
    if reason := unsolved(transcribed.problem, germ, x):
        return f"{reason.rstrip('.')}.{who and f' This is {who}.'} {where}"
    what = f"The simulation{who and ' of ' + who} is not finite: output '{name}'"
    if not transcribed.problem.system.has_time:
        return f"{what}. Look for a root or logarithm of zero, or a division by zero. {where}"
    return (
        f"{what} from t = {instants_at(transcribed.problem, decisions)[instant]:.4g} s on. Shorten the time step, "
        f"tighten the decisions' bounds or use an implicit integrator (al.integrators.Rodas5P). {where}"
    )
