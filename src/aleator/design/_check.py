"""Checks of a problem before anything is compiled; each refusal says what was expected and what was received."""

import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator._core.border import meant, one_of, refusal
from aleator._core.errors import ProblemError
from aleator.design._functionals import events_of
from aleator.design._objectives import time_integrals
from aleator.design._response import AbstractProblem
from aleator.design._scope import AbstractComposite, Value
from aleator.design._statistic import (
    Extreme,
    Statistic,
    functionals_of,
    is_worst_case,
    statistics_in,
)
from aleator.design._text import refuse_clashes
from aleator.dynamics import (
    AbstractIntegrator,
    AbstractSystem,
    AlgebraicSystem,
    Grid,
    Instant,
    LinkedGrid,
    LinkedSystems,
    Simulation,
    System,
    check_signals,
    check_variables,
    phase_of,
    refuse_unknown_event,
    within,
)
from aleator.ensemble import corners_of
from aleator.expansion import Expansion, MultiElement
from aleator.statistics import Probability, Sobol
from aleator.trajectories import piecewise_in
from aleator.uncertainty import (
    AbstractGerm,
    at_means,
    intervals_of,
    named_numbers,
    placements,
    realise,
    refuse_correlated,
    refuse_intervals,
    refuse_nonpositive,
    tables_of,
    uncertain_numbers,
)

# Quantile at which unbounded variables are tried, on either side: one realisation in a billion lies beyond.
_TAIL = 1e-9
LEAST_CHANCE = 1e-9
"""Smaller probabilities are lost in the error with which they are computed."""
# Part of the names of decided gains; the most corners of their bounds at which they are tried, and points inside; how
# far one without a bound is tried, in the largest gain.
_GAINS, _CORNERS, _INSIDE, _FAR = ".feedback.gains.", 16, 8, 10.0


def check(problem: AbstractProblem) -> None:
    """Raise `ProblemError` for the first fault, from the outside inwards."""
    _check_types(problem)
    _check_inputs(problem)
    _check_time(problem)
    _check_worst_cases(problem)
    _check_probabilities(problem)
    refuse_nonpositive(problem.simulation)
    _check_values(problem)
    _check_germs(problem)
    refuse_clashes(problem)
    _refuse_diagnosed(problem)


def _check_types(problem: AbstractProblem) -> None:
    system = one_of("Problem: 'system'", problem.system, (System, AlgebraicSystem, LinkedSystems))
    if system.has_time:
        one_of("Problem: 'grid'", problem.grid, (Grid, LinkedGrid), "al.Grid(1.0, 50)")
    elif not isinstance(problem.grid, Instant):
        raise refusal("Problem: 'grid'", "none, because an algebraic system has no time: drop the grid", problem.grid)
    one_of("Problem: 'expansion'", problem.expansion, (Expansion, MultiElement))
    one_of("Problem: 'integrator'", problem.integrator, AbstractIntegrator)
    if not (problem.objective.atoms or problem.constraints):
        raise ProblemError(
            f"Problem: minimize: expected an expression, such as al.output('y').mean; received {problem.objective}, "
            "which no design changes."
        )
    # A system without states evolves only by a motion that is given to it.
    for one in problem.simulation.phases.values():
        names = getattr(one.system, "states", None)
        if isinstance(one.system, System) and (names is None or not (names or one.inputs or one.system.signals())):
            name = type(one.system).__name__
            raise ProblemError(f'{name} names no states: expected `states = ("x", ...)` in the class.')


def _check_inputs(problem: AbstractProblem) -> None:
    events, phases = events_of(functionals_of(problem.expressions)), list(problem.simulation.phases)
    for before, dot, _ in (name.partition(".")[2].partition(".") for name in events if phases[0]):
        if dot:
            raise ProblemError(unknown("phase", before, phases))
    for phase, one in problem.simulation.phases.items():
        if not (isinstance(one.system, System) and isinstance(one.grid, Grid)):
            if one.inputs:
                name = type(one.system).__name__
                raise ProblemError(f"{name} is algebraic and takes no inputs; received {sorted(one.inputs)}.")
            return
        check_variables(one.system)
        check_signals(one.system, one.grid, one.inputs)
        _refuse_jumps_inside(one.system)
        for name in (*sorted(within(phase, events) if phase else events), one.grid.until):
            refuse_unknown_event(one.system, name)
    _check_paths(problem)


def _check_paths(problem: AbstractProblem) -> None:
    """Refuse functionals of several phases, integrals over times that differ, and paths of several phases in one."""
    phases = isinstance(problem.grid, LinkedGrid)
    for one in functionals_of(problem.expressions) if phases else ():
        if len({phase_of(name) for name in (one.place, *one.outputs)}) > 1:
            raise ProblemError(f"'{one.text()}' is of several phases: expected outputs of one; received {one.outputs}.")
    for expression in problem.expressions if phases else ():
        own = sorted({phase_of(one.place) for one in functionals_of((expression,)) if one.is_path})
        if len(own) > 1:
            raise ProblemError(
                f"'{expression}' has paths of several phases, {own}, whose instants differ: write one for each phase."
            )
    every = (inner for one in problem.expressions for inner in time_integrals(one))
    until = getattr(problem.grid, "until", None)
    if (until is not None or phases) and (inner := next(every, None)) is not None:
        ends = f"each realisation ends at its own '{until}'" if until else "there are several phases"
        raise ProblemError(
            f"'{inner}' is integrated over time, but {ends}: integrate along each realisation, al.integral(output) or "
            "al.rms(output), and take statistics of that."
        )


def _refuse_jumps_inside(system: System) -> None:
    """Refuse a control that jumps in the place of a number: only signals are told on which side of a jump a step is."""
    system = system.plain
    for field in dataclasses.fields(system):
        inside = () if field.name in system.signal_fields else piecewise_in(getattr(system, field.name))
        if any(one.degree == 0 for one in inside):
            raise ProblemError(
                f"{type(system).__name__}.{field.name}: an al.Control of degree 0 jumps between two steps, and a "
                "number of a model cannot tell on which side a step is. Give it as an input: "
                f'inputs={{"{field.name}": al.Control(...)}}, an argument of rhs and outputs; or use degree=1.'
            )


def _check_time(problem: AbstractProblem) -> None:
    """Refuse functionals over time of a system without time, and `output` of one with time."""
    has_time, name = problem.system.has_time, type(problem.system).__name__
    for functional in functionals_of(problem.expressions):
        if functional.needs_time and not has_time:
            raise ProblemError(
                f"'{functional.text()}' is taken over time, but {name} is algebraic, without time: use "
                f"al.output('{functional.output}')."
            )
        if has_time and not functional.needs_time:
            raise ProblemError(
                f"al.output is for systems without time, but {name} evolves in time: choose a functional, such as "
                f"al.terminal('{functional.output}'), al.path('{functional.output}') or al.rms('{functional.output}')."
            )
        functional.refuse_on(problem.grid.of(functional.place))


def _check_worst_cases(problem: AbstractProblem) -> None:
    """Refuse the worst case of an output in an objective, or in a function of expressions: realisations are limited."""
    composite = [atom for one in problem.expressions for atom in one.atoms if isinstance(atom, AbstractComposite)]
    intervals = list(intervals_of(problem.placements))
    if intervals and (limits := [one.name for one in problem.constraints if is_worst_case(one)]):
        raise ProblemError(
            f"worst_case of '{limits[0]}': beside '{intervals[0]}', an al.Interval, limits hold for statistics. A "
            f"worst case needs no probability: declare '{intervals[0]}' as an al.Uniform, whose ends alone count there."
        )
    misplaced = [*problem.objective.leaves, *(part for atom in composite for part in atom.parts)]
    for atom in misplaced:
        if isinstance(atom, Extreme):
            raise ProblemError(
                f"'{atom.text()}' is the worst case of the model, or of its collocation points, which can only be "
                "limited, realisation by realisation, as in .at_most(bound, worst_case=True): it has no place in an "
                "objective, a penalty or a function of expressions. Use a statistic there, such as .quantile(0.99) or "
                ".supremum."
            )


def _check_probabilities(problem: AbstractProblem) -> None:
    """Refuse bounds of a probability that are none, such as percentages, and those smaller than its error."""
    for one in problem.constraints:
        atoms, factors, constant = one.expression.atoms, one.expression.factors, float(one.expression.constant)
        is_alone = len(atoms) == 1 and isinstance(atoms[0], Statistic) and isinstance(atoms[0].kind, Probability)
        if not (is_alone and float(factors[0])):
            continue
        for bound in ((float(end) - constant) / float(factors[0]) for end in (one.lower, one.upper)):
            # That of 1 - P has the rounding of 1.
            is_between = min(bound, 1 - bound) > LEAST_CHANCE - np.finfo(float).eps
            if np.isfinite(bound) and bound not in (0, 1) and not is_between:
                expected = f"a probability, 0, 1 or from {LEAST_CHANCE} to 1 - {LEAST_CHANCE}"
                raise refusal(f"Bound of '{one}'", expected, bound)


def _check_values(problem: AbstractProblem) -> None:
    """Refuse tables that do not go together, and numbers in expressions that the model does not have."""
    if tables_of(problem.placements):
        remedy = "Solve for each whole number or row, declared as a number."
        refuse_intervals("Problem with al.Integer or al.Choice", problem.placements, remedy)
    numbers = named_numbers(problem.simulation, jax_array(problem.placements.vector("initial")))
    names = (one.name for expression in problem.expressions for one in expression.leaves if isinstance(one, Value))
    for name in names:
        if name not in numbers:
            raise ProblemError(unknown("number of the model", name, list(numbers)))
        until = getattr(problem.grid.of(name), "until", None) if name.rpartition(".")[2] == "t_final" else None
        if until is not None:
            raise ProblemError(
                f"'{name}' is the latest end of a grid that the event '{until}' ends, the same for all systems: the "
                f"time of the event is al.at('{until}'), with statistics such as al.at('{until}').mean."
            )


def _check_germs(problem: AbstractProblem) -> None:
    """Refuse Sobol indices of unknown germ variables, and of those in a correlated group."""
    places = problem.placements
    known = list(places.germ_names)
    for one in statistics_in(problem.expressions):
        variables = one.kind.variables if isinstance(one.kind, Sobol) else ()
        refuse_correlated(places.distributions, variables)
        for name in variables:
            if name not in known:
                raise ProblemError(unknown("germ variable", name, known))


def unknown(kind: str, name: str, known: list[str]) -> str:
    return f"There is no {kind} '{name}'; expected one of {known}.{meant(name, known)}"


def _refuse_diagnosed(problem: AbstractProblem) -> None:
    """Raise `ProblemError` for any fault that a system diagnoses.

    Systems are diagnosed at the means; then with each uncertain number at either end of its distribution and the others
    at their medians; and with each decided number of the system itself (not of a prescribed motion) at either bound.
    """
    if all(type(one.system).diagnose is AbstractSystem.diagnose for one in problem.simulation.phases.values()):
        return
    for simulation, who in _systems(problem, problem.placements.vector("initial")):
        _refuse(simulation, who)
    for name, decisions in _bounds(problem):
        _refuse(_at_means(problem, decisions), f" In the system with {name}.")


def destabilised(problem: AbstractProblem, decisions: Float[np.ndarray, " n"]) -> str:
    """That decided gains let errors grow, at a design and wherever else within their bounds, with the system; empty if
    there are none or some do not. A linearisation at the start of the plan tells it.
    """
    places = problem.placements
    gains = {name: np.r_[place.where] for name, place in places.decisions.items() if _GAINS in f".{name}."}
    if not gains:
        return ""
    where = np.concatenate([*gains.values()])
    lower, upper, first = (places.vector(one)[where] for one in ("lower", "upper", "initial"))
    # A gain without a bound is tried far away on that side.
    far = _FAR * max(1.0, *np.abs(first), *np.abs(decisions[where]))
    lower, upper = np.where(np.isfinite(lower), lower, -far), np.where(np.isfinite(upper), upper, far)
    generator = np.random.default_rng(0)
    tried = np.concatenate([corners_of(len(where), _CORNERS, generator), generator.random((_INSIDE, len(where)))])
    others = np.tile(decisions, (len(tried), 1))
    others[:, where] = lower + tried * (upper - lower)
    for i, (simulation, who) in enumerate(_systems(problem, decisions)):
        said = simulation.system.destabilised(simulation.grid)
        same = (next(itertools.islice(_systems(problem, one), i, None))[0] for one in others)
        if said and all(one.system.destabilised(one.grid) for one in same):
            all_of = f"all {len(tried)} values of {', '.join(gains)} that were tried within their bounds"
            return f"{said}{who} So it is with {all_of}: widen these."
    return ""


def _systems(problem: AbstractProblem, decisions: Any) -> Iterator[tuple[Simulation, str]]:
    """The system at the means; then with each uncertain number at either end of its distribution, and a sentence with
    these numbers.
    """
    yield _at_means(problem, decisions), ""
    for germ in map(jax_array, _extremes(list(problem.placements.germs.values()))):
        numbers = uncertain_numbers(problem.placements, germ, jax_array(decisions))
        where = ", ".join(f"{name} = {float(number):.4g}" for name, number in numbers.items())
        yield realise(problem.simulation, germ, jax_array(decisions)), f" In the system with {where}."


def _at_means(problem: AbstractProblem, decisions: Any) -> Simulation:
    return realise(at_means(problem.simulation), jax_array(np.zeros(0)), jax_array(decisions))


def _refuse(simulation: Simulation, who: str) -> None:
    try:
        diagnosis = simulation.system.diagnose(simulation.grid)
    except ProblemError as error:
        diagnosis = str(error)
    if diagnosis:
        raise ProblemError(diagnosis + who)


def _extremes(germs: list[AbstractGerm]) -> Iterator[Float[np.ndarray, " variables"]]:
    """Germ points with one variable at an end of its distribution, the others at their medians."""
    middle = np.array([float(germ.quantile(np.array(0.5))) for germ in germs])
    for i, germ in enumerate(germs):
        for end, level in zip(germ.support(), (_TAIL, 1 - _TAIL), strict=True):
            point = middle.copy()
            point[i] = end if np.isfinite(end) else float(germ.quantile(np.array(level)))
            yield point


def _bounds(problem: AbstractProblem) -> Iterator[tuple[str, Float[np.ndarray, " n"]]]:
    """Decisions with one number of the system at a finite bound and the others at their start, with its name.

    Entries of an array are moved together: the moments of a body, for example, may be impossible one at a time.
    """
    system, places = problem.system, problem.placements
    own = placements(system.formulated).decisions
    start, names = places.vector("initial"), places.entry_names()
    single = [place.where for name, place in places.decisions.items() if name in own]
    for i in (where.start for where in single if where.stop - where.start == 1):
        for bound in (places.vector("lower")[i], places.vector("upper")[i]):
            if np.isfinite(bound) and bound != start[i]:
                decisions = start.copy()
                decisions[i] = bound
                yield f"{names[i]} = {bound:.4g}", decisions
