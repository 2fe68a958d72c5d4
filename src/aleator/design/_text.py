"""A problem as readable mathematics."""

import numpy as np

from aleator.design._declaration import AbstractProblem
from aleator.design._language import Statistic


def problem_text(problem: AbstractProblem) -> str:
    """Objective, decisions, constraints, uncertainty, dynamics and expansion, a line each."""
    places = problem.survey
    rows = [("minimise", str(problem.objective))]
    rows += _labelled("over", [_decision_text(name, place.decision) for name, place in places.decisions.items()])
    rows += _labelled("subject to", [f"{one.name}: {one}" for one in problem.constraints])
    rows += _labelled("where", [f"{name} ~ {law}" for name, law in places.distributions.items()])
    rows += [
        ("dynamics", _dynamics_text(problem)),
        ("expansion", _expansion_text(problem, len(places.distributions))),
    ]
    return "\n".join(f"{label:<11} {text}" for label, text in rows)


def _labelled(label: str, texts: list[str]) -> list[tuple[str, str]]:
    return [(label if i == 0 else "", text) for i, text in enumerate(texts)]


def _decision_text(name: str, decision: object) -> str:
    lower, upper, start = (_range(getattr(decision, part)) for part in ("lower", "upper", "initial"))
    return f"{name} ∈ [{lower}, {upper}], from {start}"


def _range(values: object) -> str:
    low, high = float(np.min(np.asarray(values))), float(np.max(np.asarray(values)))
    return f"{low:g}" if low == high else f"{low:g}…{high:g}"


def _dynamics_text(problem: AbstractProblem) -> str:
    grid, system = problem.grid, problem.system
    return (
        f"{type(system).__name__}({', '.join(system.states)}), {grid.steps} steps of {float(grid.step):g} s, "
        f"{type(problem.integrator).__name__}"
    )


def _expansion_text(problem: AbstractProblem, variables: int) -> str:
    if variables == 0:
        return "none: nothing is uncertain, every σ is 0" if _has_std(problem) else "none: nothing is uncertain"
    expansion = problem.expansion
    return (
        f"order {expansion.order} in {variables} variables: {expansion.terms(variables)} terms, "
        f"{expansion.point_count(variables)} collocation points"
    )


def _has_std(problem: AbstractProblem) -> bool:
    return any(
        isinstance(atom, Statistic) and atom.kind != "mean"
        for expression in problem.expressions
        for atom in expression.atoms
    )
