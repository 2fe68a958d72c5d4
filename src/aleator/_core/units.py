"""Units as text: the units of sums, products, squares, rates and integrals over time.

A unit is a text that a model declares, such as `N m` or `m²/s⁴`, and is parsed only as far as needed here
(`_core.dimensions` parses it fully). An empty text is an unknown unit, from which nothing follows; `-` is the unit of a
pure number.
"""

import re
from collections.abc import Iterable

from aleator._core.dimensions import all_same

PURE = "-"
EXPONENTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")

# Units of force or torque, and of the rate that each acts on.
_POWERS = ({"N", "m/s"}, {"N m", "rad/s"}, {"N·m", "rad/s"}, {"Nm", "rad/s"})
_SECONDS = ("s", "s²", "s³", "s⁴")
_INTEGRALS = {"": "", PURE: "s", "W": "J"}
_RATES = {"": "", PURE: "1/s", "J": "W"}


def common(units: Iterable[str]) -> str:
    """The unit of a sum: the one that all terms share, as the first writes it; unknown if they differ."""
    found = list(dict.fromkeys(units))
    return found[0] if len(found) == 1 or (found and all_same(found)) else ""


def product(first: str, second: str) -> str:
    """The unit of a product: `N` and `m` make `N m`, a force and a speed make `W`."""
    if not (first and second):
        return ""
    if PURE in (first, second):
        return second if first == PURE else first
    if first == second:
        return f"{first}²" if first.isalpha() else f"({first})²"
    return "W" if {first, second} in _POWERS else f"{_factor(first)} {_factor(second)}"


def squared(unit: str) -> str:
    """The unit of a square: `N²`, `(N m)²`."""
    return product(unit, unit)


def quotient(first: str, second: str) -> str:
    """The unit of a quotient: `N` and `m` make `N/m`, equal units a pure number."""
    if not (first and second):
        return ""
    if first == second or all_same((first, second)):
        return PURE
    if second == PURE:
        return first
    below = second if second.isalpha() else f"({second})"
    return f"1/{below}" if first == PURE else f"{_factor(first)}/{below}"


def raised(unit: str, exponent: float) -> str:
    """The unit of a power: `m³`, `(N m)²`; unknown if the exponent is no whole number."""
    whole = int(exponent)
    if not unit or whole != exponent:
        return ""
    if unit == PURE or whole == 0:
        return PURE
    if whole in (1, 2):
        return unit if whole == 1 else squared(unit)
    above = str(whole).translate(EXPONENTS)
    return f"{unit}{above}" if unit.isalpha() else f"({unit}){above}"


def integrated(unit: str) -> str:
    """The unit of an integral over time: `m²/s⁴` becomes `m²/s³`, `W` becomes `J`."""
    if unit in _INTEGRALS:
        return _INTEGRALS[unit]
    base, power = _by_time(unit)
    if not power:
        return f"{_factor(unit)} s"
    if power == 1:
        return PURE if base == "1" else base
    return f"{base}/{_SECONDS[power - 2]}"


def rate(unit: str) -> str:
    """The unit of a derivative by time: `rad` becomes `rad/s`, `J` becomes `W`."""
    if unit in _RATES:
        return _RATES[unit]
    base, power = _by_time(unit)
    if power < len(_SECONDS):
        return f"{base if power else _factor(unit)}/{_SECONDS[power]}"
    return f"{_factor(unit)}/s"


def _by_time(unit: str) -> tuple[str, int]:
    """The numerator of a unit that ends in a division by a power of seconds, and the power; 0 if it does not."""
    base, _, seconds = unit.rpartition("/")
    return (base, 1 + _SECONDS.index(seconds)) if base and seconds in _SECONDS else (unit, 0)


def _factor(unit: str) -> str:
    """A unit as a factor of a product: in brackets if it contains a division."""
    return f"({unit})" if "/" in re.sub(r"\([^()]*\)", "", unit) else unit
