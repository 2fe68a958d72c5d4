"""A problem as readable mathematics."""

import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from aleator.design._declaration import AbstractProblem
from aleator.design._statistic import statistics_in
from aleator.dynamics import Grid, System
from aleator.mechanics import AbstractFormulation
from aleator.statistics import Mean
from aleator.uncertainty import AbstractDistribution, AbstractGerm, Decision, Placements, correlations_at


def problem_text(problem: AbstractProblem, mesh: str = "") -> str:
    """Objective, decisions, constraints, uncertainty, dynamics and expansion, one line per item.

    - `mesh`: what holds states to their equations, in words, where they are variables; else the integrator does.
    """
    return "\n".join(f"{label:<11} {text}" for label, text in problem_rows(problem, mesh))


def problem_rows(problem: AbstractProblem, mesh: str = "") -> list[tuple[str, str]]:
    """The lines of `problem_text`, each with its label, which is empty where that of the line before holds."""
    places = problem.placements
    rows = [("minimise", str(problem.objective))]
    rows += _labelled("over", [_decision_text(name, place.decision) for name, place in places.decisions.items()])
    rows += _labelled("subject to", [f"{one.name}: {one}" for one in problem.constraints])
    rows += _labelled("where", list(_distribution_texts(places.distributions)))
    rows += _labelled("correlated", _correlation_texts(places))
    return [
        *rows,
        _physics_row(problem, mesh or type(problem.integrator).__name__),
        ("expansion", _expansion_text(problem, places.germs)),
    ]


def _labelled(label: str, texts: list[str]) -> list[tuple[str, str]]:
    return [(label if i == 0 else "", text) for i, text in enumerate(texts)]


def _decision_text(name: str, decision: object) -> str:
    lower, upper, start = (_range(getattr(decision, part)) for part in ("lower", "upper", "initial"))
    return f"{name} ∈ [{lower}, {upper}], from {start}"


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


def _range(values: object) -> str:
    low, high = float(np.min(np.asarray(values))), float(np.max(np.asarray(values)))
    return f"{low:g}" if low == high else f"{low:g}…{high:g}"


def _physics_row(problem: AbstractProblem, advanced: str) -> tuple[str, str]:
    grid, system = problem.grid, problem.system
    name = type(system).__name__
    if not (isinstance(system, System) and isinstance(grid, Grid)):
        unknowns = getattr(system, "unknowns", ())
        solved = f"{name}({', '.join(unknowns)}), solved by Newton's method"
        return "equations", solved if unknowns else f"{name}, in closed form"
    free = isinstance(grid.t_final, Decision)
    steps = f"{grid.steps} steps to t_final" if free else f"{grid.steps} steps of {float(grid.step):g} s"
    who = f"{name} of {type(system.model).__name__}" if isinstance(system, AbstractFormulation) else name
    if not system.states:
        return "dynamics", f"{who}, {steps}, nothing is integrated"
    return "dynamics", f"{who}({', '.join(system.states)}), {steps}, {advanced}"


def _expansion_text(problem: AbstractProblem, germs: Mapping[str, AbstractGerm]) -> str:
    if not germs:
        return "none: nothing is uncertain, every σ is 0" if _has_std(problem) else "none: nothing is uncertain"
    return problem.expansion.text(germs)


def _has_std(problem: AbstractProblem) -> bool:
    return any(not isinstance(atom.kind, Mean) for atom in statistics_in(problem.expressions))
