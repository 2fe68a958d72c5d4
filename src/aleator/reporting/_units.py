"""Units of decisions, functionals and expressions, as far as a system declares them; else empty."""

from aleator._core.units import PURE
from aleator.design import (
    AbstractFunctional,
    Expression,
    Problem,
    Statistic,
    Units,
    functionals_of,
    number_unit,
    output_units,
    units_of,
)


def of_outputs(problem: Problem) -> dict[str, str]:
    """The units of the outputs of the system, by their names, as far as it declares them."""
    return {name: _shown(unit) for name, unit in output_units(problem).items()}


def of_functional(functional: AbstractFunctional, problem: Problem) -> str:
    """The unit of a functional."""
    return _shown(functional.unit(output_units(problem)))


def of_statistic(statistic: Statistic, problem: Problem) -> str:
    """The unit of a statistic; none for a ratio or a probability."""
    return _shown(statistic.unit(Units(output_units(problem), {})))


def of_expression(expression: Expression, problem: Problem) -> str:
    """The unit that all terms of an expression share."""
    return _shown(expression.unit(units_of(expression, problem)))


def of_decision(name: str, problem: Problem) -> str:
    """The unit of a decision: that of its field, even if it is inside a distribution there."""
    return _shown(number_unit(name, problem))


def of_moments(problem: Problem) -> dict[str, str]:
    """The unit of each functional in a problem, by its text."""
    return {one.text(): of_functional(one, problem) for one in functionals_of(problem.expressions)}


def of_statistics(problem: Problem) -> dict[str, str]:
    """The unit of each statistic in a problem, by its text."""
    every = (one for expression in problem.expressions for one in expression.leaves if isinstance(one, Statistic))
    return {one.text(): of_statistic(one, problem) for one in every}


def _shown(unit: str) -> str:
    return "" if unit == PURE else unit
