"""Units of decisions, functionals and expressions, as far as a system declares them."""

from aleator.design import AbstractFunctional, Expression, Problem, Statistic, functionals_of
from aleator.report._numbers import times_second
from aleator.uncertainty import fields_of


def of_functional(functional: AbstractFunctional, problem: Problem) -> str:
    """The unit of a functional; empty where the system does not say."""
    unit = problem.system.units.get(functional.output, "")
    return times_second(unit) if unit and functional.text().startswith("∫") else unit


def of_expression(expression: Expression, problem: Problem) -> str:
    """The unit of an expression: that of the first statistic in it; empty where it has none or a variance."""
    for atom in expression.atoms:
        if isinstance(atom, Statistic):
            unit = of_functional(atom.functional, problem)
            return f"({unit})²" if atom.kind == "variance" and unit else unit
    return ""


def of_decision(name: str, problem: Problem) -> str:
    """The unit of a decision: that of the field it stands in, or stands in a distribution of."""
    units = {
        place: field.metadata.get("unit", "")
        for place, field, _ in fields_of(problem.system)
        if isinstance(field.metadata.get("unit", ""), str)
    }
    place = name.split("[")[0]
    return units.get(place, units.get(place.rpartition(".")[0], "")).replace("-", "")


def of_moments(problem: Problem) -> dict[str, str]:
    """The unit of each functional in a problem, by its text."""
    return {one.text(): of_functional(one, problem) for one in functionals_of(problem.expressions)}
