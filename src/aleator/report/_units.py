"""Units of decisions, functionals and expressions, as far as a system declares them."""

from aleator.design import AbstractFunctional, Expression, Problem, Statistic, functionals_of, statistics_in
from aleator.report._numbers import times_second
from aleator.statistics import Correlation, Covariance, Kurtosis, Probability, Skewness, Sobol, TotalSobol, Variance
from aleator.uncertainty import fields_of

# Ratios and probabilities; squares.
_PURE = (Skewness, Kurtosis, Correlation, Sobol, TotalSobol, Probability)
_SQUARED = (Variance, Covariance)


def of_functional(functional: AbstractFunctional, problem: Problem) -> str:
    """The unit of a functional; empty where the system does not say."""
    unit = problem.system.units.get(functional.output, "")
    return times_second(unit) if unit and functional.text().startswith("∫") else unit


def of_statistic(statistic: Statistic, problem: Problem) -> str:
    """The unit of a statistic: that of its functional, squared for a variance, none for a ratio or a probability."""
    units = [of_functional(one, problem) for one in statistic.functionals]
    if isinstance(statistic.kind, _PURE):
        return ""
    if isinstance(statistic.kind, _SQUARED):
        first, last = units[0], units[-1]
        squared = f"({first})²" if first == last else f"({first or '1'})·({last or '1'})"
        return squared if first or last else ""
    return units[0]


def of_expression(expression: Expression, problem: Problem) -> str:
    """The unit of an expression: that of the first statistic in it; empty where it has none."""
    return next((of_statistic(one, problem) for one in statistics_in((expression,))), "")


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
