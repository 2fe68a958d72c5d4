"""Numbers, probabilities and units as an engineer reads them."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from aleator.design import Expression, Problem, Statistic, Units, functionals_of, number_unit, output_units, units_of
from aleator.statistics import PURE

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from aleator.validation import Share

NOTHING = "–"
"""In the place of a number that is not there, or is none."""

_THIN = "\u202f"  # narrow no-break space
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float | None, digits: int = 4, unit: str = "") -> str:
    """A number to `digits` significant digits, whole where it is large, with its unit: `23 339 N/m`, `−0.0322 m`.

    None is what JSON has in the place of a number that is not finite.
    """
    if value is None or math.isnan(value):
        return NOTHING
    text = _magnitude(abs(float(value)), digits)
    return with_unit(f"−{text}" if value < 0 and text != "0" else text, unit)


def _magnitude(value: float, digits: int) -> str:
    if math.isinf(value):
        return "∞"
    if value == 0:
        return "0"
    if value >= 1e7 or value < 1e-4:
        mantissa, exponent = f"{value:.{max(0, digits - 2)}e}".split("e")
        return f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPT)}"
    decimals = max(0, digits - 1 - math.floor(math.log10(value)))
    return f"{value:,.{decimals}f}".replace(",", _THIN)


def with_unit(text: str, unit: str) -> str:
    """A number in words with its unit, if it has one."""
    return text if unit in ("", "-") else f"{text}{_THIN}{unit}"


def given(value: float, unit: str = "") -> str:
    """A number as it was given, without redundant digits: `0.034 m`, `220`."""
    if math.isnan(value):
        return NOTHING
    return with_unit(f"{float(value):.6g}".replace("-", "−").replace("inf", "∞"), unit)


def count(value: int) -> str:
    """A whole number: `20 000`."""
    return f"{int(value):,}".replace(",", _THIN) if math.isfinite(value) else number(value)


def residual(value: float | None) -> str:
    """A residual, of which only the order of magnitude matters: `8·10⁻¹³`."""
    return number(value and abs(value), 2 if value is not None and 1e-4 <= abs(value) < 1e7 else 3)


def seconds(value: float) -> str:
    """A wall time: `0.64 s`, `3.2 min`."""
    return number(value, 2, "s") if value < 120 else number(value / 60, 2, "min")


def percent(probability: float) -> str:
    """A probability to three significant digits: `35.0 %`."""
    return f"{_percent(probability)}{_THIN}%"


def _percent(probability: float) -> str:
    value = 100 * float(probability)
    if not math.isfinite(value) or value in (0, 100):
        return number(value, 3)
    return f"{value:#.3g}".rstrip(".")


def interval(share: Any) -> str:
    """The confidence interval of a share: `34.3 to 35.6 %`."""
    return f"{_percent(share.lower)} to {percent(share.upper)}"


def share_text(share: "Share | None") -> str:
    """A share with its confidence interval: `35.0 % [34.3 to 35.6 %]`; a dash where nothing was counted."""
    return NOTHING if share is None else f"{percent(share.estimate)} [{interval(share)}]"


def values_text(values: "ArrayLike", digits: int = 5, unit: str = "") -> str:
    """A number, or the numbers of a short array, with a unit."""
    entries = [number(one, digits) for one in np.ravel(np.asarray(values, dtype=float))]
    return with_unit(entries[0] if np.ndim(values) == 0 else f"[{', '.join(entries)}]", unit)


def words(names: Sequence[str], nothing: str = "none") -> str:
    """Names in a sentence: `a, b and c`."""
    if len(names) < 2:
        return names[0] if names else nothing
    return f"{', '.join(names[:-1])} and {names[-1]}"


def unit_of(what: Any, problem: Problem) -> str:
    """The unit of an expression, a statistic or a functional of a problem; none for a ratio or a probability."""
    if isinstance(what, Expression):
        unit = what.unit(units_of(what, problem))
    elif isinstance(what, Statistic):
        unit = what.unit(Units(output_units(problem), {}))
    else:
        unit = what.unit(output_units(problem))
    return _written(unit)


def unit_of_decision(name: str, problem: Problem) -> str:
    """The unit of a decision: that of its field, even if it is inside a distribution there."""
    return _written(number_unit(name, problem))


def unit_of_limit(name: str, problem: Problem) -> str:
    """The unit of the constraints of a name."""
    return unit_of(problem.named(name)[0].expression, problem)


def units_of_outputs(problem: Problem) -> dict[str, str]:
    """The units of the outputs of the system, by their names, as far as it declares them."""
    return {name: _written(unit) for name, unit in output_units(problem).items()}


def units_of_moments(problem: Problem) -> dict[str, str]:
    """The unit of each functional in a problem, by its text."""
    return {one.text(): unit_of(one, problem) for one in functionals_of(problem.expressions)}


def _written(unit: str) -> str:
    return "" if unit == PURE else unit
