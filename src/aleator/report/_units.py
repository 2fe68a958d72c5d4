"""Units of decisions, functionals and expressions, as far as a system declares them; empty where it does not say."""

from aleator._core.units import PURE, rate
from aleator.design import AbstractFunctional, Expression, Problem, Statistic, Units, functionals_of
from aleator.mechanics import AbstractFormulation
from aleator.uncertainty import fields_of

# Those parameters of distributions that are in the unit of the uncertain number itself.
_LIKE_THE_NUMBER = (
    *("mean", "std", "half_width", "lower", "upper", "mode", "median", "location", "scale"),
    *("nominal", "tolerance", "plus", "minus"),
)
_TIMES = {"t_start": "s", "t_final": "s"}


def of_functional(functional: AbstractFunctional, problem: Problem) -> str:
    """The unit of a functional."""
    return _shown(functional.unit(_outputs(problem)))


def of_statistic(statistic: Statistic, problem: Problem) -> str:
    """The unit of a statistic; none for a ratio or a probability."""
    return _shown(statistic.unit(Units(_outputs(problem), {})))


def of_expression(expression: Expression, problem: Problem) -> str:
    """The unit that all terms of an expression share."""
    names = (name for atom in expression.leaves for name in atom.subjects)
    return _shown(expression.unit(Units(_outputs(problem), {name: _number(name, problem) for name in names})))


def of_decision(name: str, problem: Problem) -> str:
    """The unit of a decision: that of the field it stands in, or stands in a distribution of."""
    return _shown(_number(name, problem))


def of_moments(problem: Problem) -> dict[str, str]:
    """The unit of each functional in a problem, by its text."""
    return {one.text(): of_functional(one, problem) for one in functionals_of(problem.expressions)}


def _shown(unit: str) -> str:
    return "" if unit == PURE else unit


def _number(name: str, problem: Problem) -> str:
    """The unit of a number of the model, by the name under which it is decided."""
    units = _TIMES | {place: field.metadata.get("unit", "") for place, field, _ in fields_of(problem.system)}
    owner, _, parameter = name.rpartition(".")
    unit = units.get(name.split("[")[0]) or (units.get(owner) if parameter in _LIKE_THE_NUMBER else "")
    return unit if isinstance(unit, str) else ""


def _outputs(problem: Problem) -> dict[str, str]:
    """The units that a system declares, and those of the rates that every mechanical system has."""
    units = dict(problem.system.units)
    if isinstance(problem.system, AbstractFormulation):
        model = problem.system.model
        for name in model.coordinates:
            speed = units.setdefault(f"{name}_rate", rate(units.get(name, "")))
            units.setdefault(f"{name}_acceleration", rate(speed))
        for name in (*model.speeds, *model.actuators):
            units.setdefault(f"{name}_rate", rate(units.get(name, "")))
    return units
