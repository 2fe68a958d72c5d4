"""Numbers, probabilities and units as an engineer reads them."""

import math
from typing import TYPE_CHECKING

import numpy as np

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
from aleator.statistics import PURE

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from aleator.validation import Share

NOTHING = "–"
"""In the place of a number that is not there, or is none."""

_THIN = "\u202f"  # narrow no-break space
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, digits: int = 4, unit: str = "") -> str:
    """A number to `digits` significant digits, whole where it is large, with its unit: `23 339 N/m`, `−0.0322 m`."""
    value = float(value)
    if math.isnan(value):
        return NOTHING
    text = _magnitude(abs(value), digits)
    signed = f"−{text}" if value < 0 and text != "0" else text
    return f"{signed}{_THIN}{unit}" if unit not in ("", "-") else signed


def _magnitude(value: float, digits: int) -> str:
    """A number that is not negative; a diverged model's are not finite."""
    if math.isnan(value):
        return NOTHING
    if math.isinf(value):
        return "∞"
    if value == 0:
        return "0"
    if value >= 1e7 or value < 1e-4:
        mantissa, exponent = f"{value:.{max(0, digits - 2)}e}".split("e")
        return f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPT)}"
    decimals = max(0, digits - 1 - math.floor(math.log10(value)))
    return f"{value:,.{decimals}f}".replace(",", _THIN)


def given(value: float, unit: str = "") -> str:
    """A number as it was given, without redundant digits: `0.034 m`, `220`."""
    if math.isnan(float(value)):
        return NOTHING
    text = f"{float(value):.6g}".replace("-", "−").replace("inf", "∞")
    return f"{text}{_THIN}{unit}" if unit not in ("", "-") else text


def count(value: int) -> str:
    """A whole number: `20 000`."""
    return f"{int(value):,}".replace(",", _THIN) if math.isfinite(value) else number(value)


def residual(value: float) -> str:
    """A residual, of which only the order of magnitude matters: `8·10⁻¹³`."""
    return "0" if value == 0 else _magnitude(abs(float(value)), 2 if 1e-4 <= abs(value) < 1e7 else 3)


def seconds(value: float) -> str:
    """A wall time: `0.64 s`, `3.2 min`."""
    return number(value, 2, "s") if value < 120 else number(value / 60, 2, "min")


def percent(probability: float) -> str:
    """A probability to three significant digits: `35.0 %`."""
    value = 100 * float(probability)
    if not math.isfinite(value):
        return number(value, unit="%")
    if value == 0 or value == 100:
        return f"{value:.0f}{_THIN}%"
    return f"{value:#.3g}".rstrip(".") + f"{_THIN}%"


def interval(share: "Share") -> str:
    """The confidence interval of a share: `34.3 to 35.6 %`."""
    ends = [percent(end).removesuffix(f"{_THIN}%") for end in (share.lower, share.upper)]
    return f"{ends[0]} to {ends[1]}{_THIN}%"


def share_text(share: "Share | None") -> str:
    """A share with its confidence interval: `35.0 % [34.3 to 35.6 %]`; a dash where nothing was counted."""
    return "–" if share is None else f"{percent(share.estimate)} [{interval(share)}]"


def values_text(values: "ArrayLike", digits: int = 5, unit: str = "") -> str:
    """A number, or the numbers of a short array, with a unit."""
    entries = [number(one, digits) for one in np.ravel(np.asarray(values, dtype=float))]
    text = entries[0] if np.ndim(values) == 0 else f"[{', '.join(entries)}]"
    return f"{text}{_THIN}{unit}" if unit not in ("", "-") else text


def words(names: list[str] | tuple[str, ...], nothing: str = "none") -> str:
    """Names in a sentence: `a, b and c`."""
    if len(names) < 2:
        return names[0] if names else nothing
    return f"{', '.join(names[:-1])} and {names[-1]}"


def units_of_outputs(problem: Problem) -> dict[str, str]:
    """The units of the outputs of the system, by their names, as far as it declares them."""
    return {name: _written(unit) for name, unit in output_units(problem).items()}


def unit_of_functional(functional: AbstractFunctional, problem: Problem) -> str:
    """The unit of a functional."""
    return _written(functional.unit(output_units(problem)))


def unit_of_statistic(statistic: Statistic, problem: Problem) -> str:
    """The unit of a statistic; none for a ratio or a probability."""
    return _written(statistic.unit(Units(output_units(problem), {})))


def unit_of_expression(expression: Expression, problem: Problem) -> str:
    """The unit that all terms of an expression share."""
    return _written(expression.unit(units_of(expression, problem)))


def unit_of_decision(name: str, problem: Problem) -> str:
    """The unit of a decision: that of its field, even if it is inside a distribution there."""
    return _written(number_unit(name, problem))


def unit_of_objective(problem: Problem) -> str:
    """The unit of the objective."""
    return unit_of_expression(problem.objective, problem)


def unit_of_limit(name: str, problem: Problem) -> str:
    """The unit of the constraints of a name."""
    return unit_of_expression(problem.named(name)[0].expression, problem)


def units_of_moments(problem: Problem) -> dict[str, str]:
    """The unit of each functional in a problem, by its text."""
    return {one.text(): unit_of_functional(one, problem) for one in functionals_of(problem.expressions)}


def _written(unit: str) -> str:
    return "" if unit == PURE else unit
