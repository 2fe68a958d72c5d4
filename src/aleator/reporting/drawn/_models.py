"""Facts of models and problems."""

from typing import Any

import numpy as np

from aleator._core.given import shown
from aleator.design import Problem
from aleator.dynamics import AbstractSystem
from aleator.reporting import _units
from aleator.reporting._blocks import Table
from aleator.reporting._numbers import given
from aleator.reporting.drawn._facts import Facts, facts_of
from aleator.uncertainty import AbstractDistribution, Decision, fields_of


@facts_of.register(AbstractSystem)
def _(system: AbstractSystem) -> Facts:
    rows = [[name, _value(value), str(field.metadata.get("unit", ""))] for name, field, value in fields_of(system)]
    said = (type(system).__doc__ or "").strip().split("\n")[0]
    return Facts(type(system).__name__, said, [Table("", ["number", "value", "unit"], rows)] if rows else [])


@facts_of.register(Problem)
def _(problem: Problem) -> Facts:
    places = problem.placements
    rows = [["minimise", str(problem.objective), ""]]
    rows += [["subject to", str(one), one.name] for one in problem.constraints]
    rows += [["over", str(one.decision), name] for name, one in places.decisions.items()]
    rows += [["where", f"~ {one}", name] for name, one in places.distributions.items()]
    unit = _units.of_expression(problem.objective, problem)
    rows[0][2] = unit
    heading = f"Problem: {type(problem.system).__name__}"
    counted = f"{places.size} decisions, {len(problem.constraints)} limits, {len(places.germs)} uncertain variables"
    return Facts(heading, counted, [Table("", ["", "", ""], rows)])


def _value(value: Any) -> str:
    """A number, distribution or decision in words; arrays and others shortened."""
    if isinstance(value, AbstractDistribution | Decision):
        return str(value)
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return given(float(value))
    return shown(value)
