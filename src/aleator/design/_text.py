"""A problem as readable mathematics, and its units as far as known: sums and comparisons must agree in them."""

import itertools
from collections.abc import Iterator, Mapping
from typing import Any

import equinox as eqx
import jax

from aleator._core.border import refusal
from aleator._core.errors import ProblemError
from aleator._core.leaves import is_leaf
from aleator.design._expression import Expression
from aleator.design._functionals import SquareIntegral, Work
from aleator.design._response import AbstractProblem
from aleator.design._scope import AbstractAtom, Units
from aleator.design._statistic import Statistic, statistics_in
from aleator.dynamics import Grid, Simulation, System, named
from aleator.statistics import PURE, Mean, is_same, measure, rate
from aleator.uncertainty import (
    AbstractDecision,
    AbstractDistribution,
    AbstractGerm,
    Placements,
    correlations_at,
    ends,
    fields_of,
    intervals_of,
)

# The parameters of distributions that have the unit of the uncertain number itself.
_LIKE_THE_NUMBER = (
    *("mean", "std", "half_width", "lower", "upper", "mode", "median", "location", "scale"),
    *("nominal", "tolerance", "plus", "minus"),
)

# Gram or gravity, coulomb or Celsius, farad or Fahrenheit, picohenry or acidity; decibels have no size.
_TWO_READINGS = {"g", "C", "F", "pH", "dB"}
_TIMES = {"t_start": "s", "t_final": "s"}


def units_of(expression: Expression, problem: AbstractProblem) -> Units:
    """The units of the outputs and numbers in an expression, as far as a problem's model declares them."""
    names = {name for atom in expression.leaves for name in atom.subjects}
    return Units(output_units(problem), {name: number_unit(name, problem) for name in names})


def number_unit(name: str, problem: AbstractProblem) -> str:
    """The unit of a number of the model, by the decision's name."""
    units = {field: data.metadata.get("unit", "") for field, data, _ in fields_of(problem.system)}
    times = named(dict.fromkeys(problem.simulation.phases, _TIMES))
    fields = times | {field: unit for field, unit in units.items() if isinstance(unit, str)}
    owner, _, parameter = name.rpartition(".")
    return fields.get(name.split("[")[0], "") or (fields.get(owner, "") if parameter in _LIKE_THE_NUMBER else "")


def output_units(problem: AbstractProblem) -> dict[str, str]:
    """The units that a system declares, and those of the standard rates of mechanical systems.

    Raises `ProblemError` if `units` is not a dict.
    """
    declared = problem.system.units
    if not isinstance(declared, Mapping):
        raise refusal(
            f"{type(problem.system).__name__}.units", "units of outputs by name, such as {'x': 'm'}", declared
        )
    units = {name: unit for name, unit in declared.items() if isinstance(unit, str)}
    for name, origin in problem.system.rates_of.items():
        units.setdefault(name, rate(units.get(origin, "")))
    return units


def refuse_clashes(problem: AbstractProblem) -> None:
    """Raise `ProblemError` where quantities of different known units are added, compared or shared.

    Two terms of a sum clash where neither factor can be a unit conversion: where the factors are equal in size or, in a
    constraint, where one is the multiple of a standard deviation, a margin. Efforts, energies and norms never clash,
    since their weights of one may stand for weights with units.
    """
    _refuse_shared(problem)
    limits = [(f"Constraint '{one.name}'", one.expression, True) for one in problem.constraints]
    for where, expression, is_limit in [("The objective", problem.objective, False), *limits]:
        _refuse_sum(where, expression, units_of(expression, problem), is_limit=is_limit)


def _refuse_sum(where: str, expression: Expression, units: Units, *, is_limit: bool) -> None:
    terms = [term for term in zip(expression.factors, expression.atoms, strict=True) if float(term[0]) != 0]
    for (factor, one), (other_factor, other) in itertools.combinations(terms, 2):
        is_margin = is_limit and (one.is_spread or other.is_spread)
        if is_margin or abs(float(factor)) == abs(float(other_factor)):
            first, second = (_unit(atom, units) for atom in (one, other))
            clash = _clash(first, second)
            if clash:
                raise ProblemError(
                    f"{where}: '{one.text()}' is in {first} and '{other.text()}' in {second}, {clash}: convert both to "
                    "one unit, or multiply one by a conversion factor."
                )
    for inner in (inner for _, atom in terms for inner in atom.inner):
        _refuse_sum(where, inner, units, is_limit=is_limit)


def _unit(atom: AbstractAtom, units: Units) -> str:
    """The unit of a term; empty for terms whose weights carry units."""
    weighted = isinstance(atom, Statistic) and any(isinstance(one, SquareIntegral | Work) for one in atom.functionals)
    return "" if weighted else atom.unit(units)


def _refuse_shared(problem: AbstractProblem) -> None:
    """Refuse one number, shared by name, in fields of different units."""
    seen: dict[str, tuple[str, str]] = {}
    for place, unit, name in _shared(problem.system):
        first_place, first = seen.setdefault(name, (place, unit))
        clash = _clash(first, unit)
        if clash:
            raise ProblemError(
                f"'{name}' is shared by '{first_place}', in {first}, and '{place}', in {unit}, {clash}: give both "
                "fields one unit, or compute one of them from the other."
            )


def _shared(model: Any) -> Iterator[tuple[str, str, str]]:
    """The shared numbers in fields with a unit: place, unit and shared name."""
    for place, field, value in fields_of(model):
        unit = field.metadata.get("unit", "")
        if not (isinstance(unit, str) and unit) or (isinstance(value, eqx.Module) and not is_leaf(value)):
            continue
        for leaf in filter(is_leaf, jax.tree.leaves(value, is_leaf=is_leaf)):
            if leaf.shared_name:
                yield place, unit, leaf.shared_name
            if isinstance(leaf, AbstractDistribution):
                for parameter, decision in leaf.decisions.items():
                    if decision.shared_name and parameter in _LIKE_THE_NUMBER:
                        yield f"{place}.{parameter}", unit, decision.shared_name


def _clash(first: str, second: str) -> str:
    """How two units differ, as the end of a sentence; empty where they agree or one is unknown."""
    if first == second or not (first and second) or {first, second} & _TWO_READINGS:
        return ""
    one, other = measure(first), measure(second)
    if one is None or other is None or is_same(first, second):
        return ""
    if one.powers != other.powers:
        return "which measure different things"
    ratio = other.per(one)
    return "" if ratio is None else f"which differ in size: 1 {_counted(second)} is {ratio:.6g} {_counted(first)}"


def _counted(unit: str) -> str:
    return f"({unit})" if unit == PURE else unit


def problem_text(problem: AbstractProblem, mesh: str = "") -> str:
    """Objective, decisions, constraints, uncertainty, dynamics and expansion, one line per item.

    - `mesh`: what holds states to their equations, in words, where they are variables; else the integrator does.
    """
    return "\n".join(f"{label:<11} {text}" for label, text in problem_rows(problem, mesh))


def problem_rows(problem: AbstractProblem, mesh: str = "") -> list[tuple[str, str]]:
    """The lines of `problem_text`, each with its label, which is empty where that of the line before holds."""
    places = problem.placements
    rows = [("minimise", str(problem.objective))]
    rows += _labelled("over", [_decision_text(name, place.decision) for name, place in places.designed.items()])
    rows += _labelled(
        "for all", [f"{name} ∈ {places.decisions[name].decision.domain()}" for name in intervals_of(places)]
    )
    rows += _labelled("subject to", [f"{one.name}: {one}" for one in problem.constraints])
    rows += _labelled("where", list(_distribution_texts(places.distributions)))
    rows += _labelled("correlated", _correlation_texts(places))
    advanced = mesh or type(problem.integrator).__name__
    phases = [(phase, *_physics_row(one, advanced)) for phase, one in problem.simulation.phases.items()]
    rows += _labelled(phases[0][1], [f"{phase}: {text}" if phase else text for phase, _, text in phases])
    return [*rows, ("expansion", _expansion_text(problem, places.germs))]


def _labelled(label: str, texts: list[str]) -> list[tuple[str, str]]:
    return [(label if i == 0 else "", text) for i, text in enumerate(texts)]


def _decision_text(name: str, decision: AbstractDecision) -> str:
    return f"{name} ∈ {decision.domain()}, from {ends(decision.initial)}"


def _distribution_texts(distributions: Mapping[str, AbstractDistribution]) -> Iterator[str]:
    """One line per distribution; numbered ones of one kind, such as the modes of a process, share a line."""
    for _, group in itertools.groupby(distributions.items(), key=_numbered):
        (first, distribution), *others = group
        yield f"{first}{f' … {others[-1][0]}' if others else ''} ~ {distribution}"


def _correlation_texts(places: Placements) -> list[str]:
    """One line per correlated distribution, with those before it to which it has a correlation at the start."""
    lines: dict[str, list[str]] = {}
    for (first, second), value in correlations_at(places, places.vector("initial")).items():
        lines.setdefault(second, []).append(f"{value:.3g} with {first}")
    return [f"{name}: {', '.join(texts)}" for name, texts in lines.items()]


def _numbered(named: tuple[str, AbstractDistribution]) -> tuple[str, str]:
    """The common part of numbered distributions: the name before the number, and the distribution."""
    name, distribution = named
    before, _, number = name.rpartition(".")
    return (before if number.isdigit() else name), str(distribution)


def _physics_row(simulation: Simulation, advanced: str) -> tuple[str, str]:
    """The label and the text of a system and its grid."""
    grid, system = simulation.grid, simulation.system
    name = type(system).__name__
    if not (isinstance(system, System) and isinstance(grid, Grid)):
        unknowns = getattr(system, "unknowns", ())
        solved = f"{name}({', '.join(unknowns)}), solved by Newton's method"
        return "equations", solved if unknowns else f"{name}, in closed form"
    free = isinstance(grid.t_final, AbstractDecision) or grid.until is not None
    end = "t_final" if grid.until is None else f"'{grid.until}', at most {grid.latest:g} s"
    steps = f"{grid.steps} steps to {end}" if free else f"{grid.steps} steps of {float(grid.step):g} s"
    who = name if system.formulated is system else f"{name} of {type(system.formulated).__name__}"
    if not system.states:
        return "dynamics", f"{who}, {steps}, nothing is integrated"
    return "dynamics", f"{who}({', '.join(system.states)}), {steps}, {advanced}"


def _expansion_text(problem: AbstractProblem, germs: Mapping[str, AbstractGerm]) -> str:
    if germs:
        return problem.expansion.text(germs)
    has_spread = any(not isinstance(atom.kind, Mean) for atom in statistics_in(problem.expressions))
    return "none: nothing is uncertain, every σ is 0" if has_spread else "none: nothing is uncertain"
