"""Quantities as text, in numbers of the model's own unit: `30 kN/m`, `27.645 +0.05/-0.02 mm`, `40 ± 4 N/m`."""

import functools
import math
import re
from typing import Any, NamedTuple

from aleator._core.errors import MissingExtraError, ProblemError

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_QUANTITY = re.compile(
    rf"\s*(?P<number>{_NUMBER})\s*"
    rf"(?:(?:±|\+/-)\s*(?P<both>{_NUMBER})|\+\s*(?P<plus>{_NUMBER})\s*/\s*-\s*(?P<minus>{_NUMBER}))?\s*(?P<unit>.*?)\s*"
)


class Amount(NamedTuple):
    """A number, and the tolerances beside it, None if there are none; all in the unit asked for."""

    number: float
    plus: float | None = None
    minus: float | None = None


def amount(text: float | str, unit: str) -> Amount:
    """A quantity in the unit of the model; a number without a unit is in that one already.

    Raises `ProblemError` for a text that is no quantity, and for a unit that cannot be converted.
    """
    if not isinstance(text, str):
        return Amount(float(text))
    found = _QUANTITY.fullmatch(text)
    if found is None:
        raise ProblemError(f"expected a quantity, such as '30 kN/m'; received '{text}'.")
    factor = _factor(found["unit"], unit)
    numbers = [None if found[name] is None else factor * float(found[name]) for name in ("number", "plus", "minus")]
    number, plus, minus = numbers
    if found["both"] is not None:
        plus = minus = factor * float(found["both"])
    assert number is not None
    if not math.isfinite(number):
        raise ProblemError(f"expected a finite quantity; received '{text}'.")
    return Amount(number, plus, minus)


def plain(text: float | str, unit: str) -> float:
    """A quantity without tolerances."""
    found = amount(text, unit)
    if found.plus is not None:
        raise ProblemError(f"expected a quantity without tolerances; received '{text}'.")
    return found.number


def _factor(given: str, wanted: str) -> float:
    """What a number in one unit is multiplied by to be in the other."""
    if not given:
        return 1.0
    if not wanted:
        raise ProblemError(
            f"expected a number without a unit, since the model declares none here (`al.parameter('kg')` does for a "
            f"number, `units = {{...}}` of the system for outputs); received the unit '{given}'."
        )
    registry = _registry()
    try:
        one = registry.Quantity(1.0, _parsed(given)).to(_parsed("" if wanted == "-" else wanted))
        none = registry.Quantity(0.0, _parsed(given)).to(_parsed("" if wanted == "-" else wanted))
    except Exception as error:  # pint has one for each way to fail
        raise ProblemError(f"expected a unit that can be converted to '{wanted}'; received '{given}'.") from error
    if none.magnitude:
        raise ProblemError(f"expected a unit whose zero is that of '{wanted}'; received '{given}': convert it.")
    return float(one.magnitude)


def _parsed(unit: str) -> Any:
    return _registry().parse_units(re.sub(r"(?<=[^\s*/·])\s+(?=[^\s*/·])", "*", unit.replace("·", "*").strip()))


@functools.cache
def _registry() -> Any:
    try:
        import pint
    except ImportError as error:
        raise MissingExtraError("Quantities with units need pint: pip install pint") from error
    return pint.UnitRegistry()
