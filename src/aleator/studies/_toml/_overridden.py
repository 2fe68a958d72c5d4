"""A problem with other numbers, distributions, decisions, limits, grid, expansion and solver."""

import inspect
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np

from aleator import solvers, uncertainty
from aleator._core.errors import ProblemError
from aleator._core.given import meant
from aleator.design import Problem, declared_anew, units_of
from aleator.dynamics import Grid
from aleator.nlp import AbstractSolver
from aleator.studies._toml._quantity import amount, plain
from aleator.uncertainty import Decision, fields_of

# Parameters of distributions that are pure numbers.
_PURE = ("alpha", "beta", "shape", "cp", "cpk", "sigmas")


def overridden(problem: Problem, name: str, value: Any) -> Problem:
    """The problem with another number, distribution or decision in the place of a field of its model."""
    system = problem.simulation.system
    fields = {place: (field, now) for place, field, now in fields_of(system)}
    if name not in fields:
        raise ProblemError(f"the model has no number of this name.{meant(name, list(fields))}")
    field, _ = fields[name]
    new = _leaf(value, field.metadata.get("unit", ""))
    path = name.split(".")

    def where(tree: Any) -> Any:
        for part in path:
            tree = tree[part] if isinstance(tree, dict) else tree[int(part)] if part.isdigit() else getattr(tree, part)
        return tree

    changed = eqx.tree_at(where, system, new, is_leaf=lambda node: node is None)
    return declared_anew(problem, replace(problem.simulation, system=changed))


def _leaf(value: Any, unit: str) -> Any:
    if hasattr(value, "distribution"):
        return _distribution(value, unit)
    if hasattr(value, "start"):
        return _decision(value, unit)
    return amount(value, unit)


def _decision(table: Any, unit: str) -> Decision:
    lower = -np.inf if table.lower is None else plain(table.lower, unit)
    upper = np.inf if table.upper is None else plain(table.upper, unit)
    return Decision(plain(table.start, unit), lower, upper)


def _distribution(table: Any, unit: str) -> Any:
    family = getattr(uncertainty, table.distribution)
    given = {
        name: _decision(one, unit) if hasattr(one, "start") else _parameter(name, one, unit)
        for name, one in (table.__pydantic_extra__ or {}).items()
    }
    known = [name for name in inspect.signature(family).parameters if name not in ("unnamed", "shared_name")]
    for name in given:
        if name not in known:
            raise ProblemError(f"{table.distribution} has no parameter '{name}'; expected some of {known}.")
    return family(**given)


def _parameter(name: str, value: Any, unit: str) -> float:
    """A parameter of a distribution."""
    if name in _PURE and isinstance(value, str):
        raise ProblemError(f"{name}: expected a number; received the text '{value}'. Leave out the quotation marks.")
    return plain(value, "" if name in _PURE else unit)


def limited(problem: Problem, name: str, bound: Any) -> Problem:
    """The problem with another bound."""
    unit = _unit(problem, name)
    if isinstance(bound, tuple):
        lower, upper = (plain(one, unit) for one in bound)
        return problem.with_bound(name, (lower, upper))
    return problem.with_bound(name, plain(bound, unit))


def swept(problem: Problem, name: str, values: Sequence[Any]) -> list[float]:
    """Values of a bound."""
    return [plain(one, _unit(problem, name)) for one in values]


def _unit(problem: Problem, name: str) -> str:
    expression = problem.named(name)[0].expression
    return expression.unit(units_of(expression, problem))


def on_grid(problem: Problem, t_final: Any, steps: int | None) -> Problem:
    """The problem on another grid."""
    grid = problem.grid
    if not isinstance(grid, Grid):
        raise ProblemError("the model has no time, and so no grid.")
    changed = Grid(grid.t_final if t_final is None else plain(t_final, "s"), grid.steps if steps is None else steps)
    return declared_anew(problem, replace(problem.simulation, grid=changed))


def expanded(problem: Problem, order: int) -> Problem:
    """The problem with another order of its expansion."""
    return eqx.tree_at(lambda tree: tree.expansion, problem, replace(problem.expansion, order=order))


def solver_of(table: Any) -> AbstractSolver:
    """A solver by its name, with its options."""
    family, options = getattr(solvers, table.name), dict(table.__pydantic_extra__ or {})
    known = list(inspect.signature(family).parameters)
    for name in options:
        if name not in known:
            raise ProblemError(f"{table.name} has no option '{name}'.{meant(name, known)} Expected some of {known}.")
    return family(**options)
