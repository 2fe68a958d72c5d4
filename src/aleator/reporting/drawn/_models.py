"""Facts of models and problems."""

from typing import Any

import numpy as np

from aleator._core.given import shown
from aleator.design import Problem, problem_rows
from aleator.dynamics import AbstractSystem
from aleator.mechanics import AbstractMechanical
from aleator.reporting._blocks import Table
from aleator.reporting._numbers import given
from aleator.reporting.drawn._facts import Facts, facts_of
from aleator.uncertainty import AbstractDistribution, Decision, fields_of


@facts_of.register(AbstractMechanical)
@facts_of.register(AbstractSystem)
def _(system: AbstractMechanical | AbstractSystem) -> Facts:
    rows = [[name, _value(value), str(field.metadata.get("unit", ""))] for name, field, value in fields_of(system)]
    said = (type(system).__doc__ or "").strip().split("\n")[0]
    return Facts(type(system).__name__, said, [Table("", ["number", "value", "unit"], rows)] if rows else [])


@facts_of.register(Problem)
def _(problem: Problem) -> Facts:
    rows = [list(row) for row in problem_rows(problem)]
    return Facts(f"Problem: {type(problem.system).__name__}", "", [Table("", ["", ""], rows)])


def _value(value: Any) -> str:
    """A number, distribution or decision in words; arrays and others shortened."""
    if isinstance(value, AbstractDistribution | Decision):
        return str(value)
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return given(float(value))
    return shown(value)
