"""Quantities as text, in numbers of the model's own unit: `30 kN/m`, `27.645 +0.05/-0.02 mm`, `40 ± 4 N/m`."""

import math
import re
from typing import Any

from aleator._core.errors import ProblemError
from aleator.statistics import measure
from aleator.uncertainty import Toleranced, toleranced

_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
# A deviation from the nominal value has a sign, or is zero.
_DEVIATION = rf"\s*(?:(?:±|\+\s*/\s*-|\+-|/?\s*[+-])\s*{_NUMBER}|/\s*0(?![\d.])|\s0(?![\d.]))"
_QUANTITY = re.compile(rf"\s*(?P<number>[+-]?{_NUMBER})(?P<deviations>(?:{_DEVIATION})*)\s*(?P<unit>.*?)\s*")
_TOLERANCE_IN_UNIT = re.compile(r"[±+]|(?<![\w^(*])-")
_NUMBER_IN_UNIT = re.compile(r"/\s*\d|\*|(?!1\s*/)\d")


def amount(text: float | str, unit: str) -> float | Toleranced:
    """A quantity in the unit of the model; a number without a unit is in that one already.

    Raises `ProblemError` for a text that is no quantity, and for a unit that cannot be converted.
    """
    if not isinstance(text, str):
        return float(text)
    found = _QUANTITY.fullmatch(text.replace("\N{MINUS SIGN}", "-"))
    if found is None:
        raise ProblemError(f"expected a quantity, such as '30 kN/m'; received '{text}'.")
    if _TOLERANCE_IN_UNIT.search(found["unit"]):
        raise _no_tolerances(text)
    if _NUMBER_IN_UNIT.match(found["unit"]):
        raise ProblemError(f"expected one number, with a decimal point, and its unit; received '{text}'.")
    scale = _scale(found["unit"], unit)
    if not found["deviations"].strip():
        return _finite(scale * float(found["number"]), text)
    try:
        zone = toleranced(found["number"] + found["deviations"]).parameters
    except ProblemError as error:
        raise _no_tolerances(text) from error
    names = [name for name in ("nominal", "tolerance", "plus", "minus") if name in zone]
    scaled: dict[str, Any] = {name: _finite(scale * float(zone[name]), text) for name in names}
    return Toleranced(**scaled)


def _no_tolerances(text: str) -> ProblemError:
    return ProblemError(
        "expected tolerances as on a drawing, with limits apart and the unit once at the end, such as '27.645 "
        f"+0.05/-0.02 mm' or '40 ± 4 N/m'; received '{text}'."
    )


def plain(text: float | str, unit: str) -> float:
    """A quantity without tolerances."""
    found = amount(text, unit)
    if isinstance(found, Toleranced):
        raise ProblemError(f"expected a quantity without tolerances; received '{text}'.")
    return found


def _finite(number: float, text: str) -> float:
    if not math.isfinite(number):
        raise ProblemError(f"expected a finite quantity; received '{text}'.")
    return number


def _scale(given: str, wanted: str) -> float:
    """What a number in one unit is multiplied by to be in the other."""
    if not given:
        return 1.0
    if not wanted:
        raise ProblemError(
            f"expected a number without a unit, since the model declares none here (`al.parameter('kg')` does for a "
            f"number, `units = {{...}}` of the system for outputs); received the unit '{given}'."
        )
    if given == wanted:
        return 1.0
    one, other = measure(given), measure(wanted)
    if one is None or other is None or one.powers != other.powers:
        raise ProblemError(
            f"expected a unit that can be converted to '{wanted}'; received '{given}'. Write factors apart, powers "
            "with '^', and brackets around a product below a fraction stroke: 'N m', 'kg m^2', 'J/(kg K)'."
        )
    if one.zero != other.zero:
        raise ProblemError(f"expected a unit whose zero is that of '{wanted}'; received '{given}': convert it.")
    ratio = one.per(other)
    if ratio is None:
        why = "another power of angles" if one.angles else "no angle"
        raise ProblemError(
            f"expected a unit with the angles of '{wanted}'; received '{given}', which has {why}. Write angles as rad, "
            "deg or turn, speeds as rad/s, rpm or Hz (a turn per second), and what has no angle without one."
        )
    return ratio
