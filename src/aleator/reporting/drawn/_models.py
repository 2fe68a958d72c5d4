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
    name, said = type(system).__name__, (type(system).__doc__ or "").strip().split("\n")[0]
    # A class without a docstring is given its signature as one.
    said = "" if said.startswith(f"{name}(") else said
    return Facts(name, said, [Table("", ["number", "value", "unit"], rows)] if rows else [])


@facts_of.register(Problem)
def _(problem: Problem) -> Facts:
    rows = [list(row) for row in problem_rows(problem)]
    return Facts(f"Problem: {type(problem.system).__name__}", "", [Table("", ["", ""], rows)])


def _value(value: Any) -> str:
    """A number, distribution or decision in words; arrays and others shortened."""
    if isinstance(value, AbstractDistribution):
        return str(value)
    if isinstance(value, Decision):
        many = f"{np.size(value.initial)} numbers" if np.ndim(value.initial) else f"from {float(value.initial):g}"
        return f"Decision in [{np.min(value.lower):g}, {np.max(value.upper):g}], {many}"
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return given(float(value))
    return shown(value)
