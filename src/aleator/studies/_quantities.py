"""Quantities of study files, such as `30 kN/m`, `27.645 +0.05/-0.02 mm`, `40 ± 4 N/m`, as numbers of the model."""

import re
from collections.abc import Mapping
from typing import Any

from aleator._core.border import real
from aleator._core.errors import ProblemError
from aleator.statistics import PURE, measure
from aleator.uncertainty import Toleranced, toleranced

_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
# A deviation from the nominal value has a sign, or is zero.
_DEVIATION = rf"\s*(?:(?:±|\+\s*/\s*-|\+-|/?\s*[+-])\s*{_NUMBER}|/\s*0(?![\d.])|\s0(?![\d.]))"
# Drawings have the unit once, at the end; a text may repeat it behind the nominal value.
_QUANTITY = re.compile(
    rf"\s*(?P<number>[+-]?{_NUMBER})\s*(?:(?P<repeated>[^\d\s±+/-][^±+]*?)\s*(?=[±+]))?"
    rf"(?P<deviations>(?:{_DEVIATION})*)\s*(?P<unit>.*?)\s*"
)
# A percentage of a value, which is no factor of its unit. What is per percent, or percent per something, is a unit.
_SHARE = re.compile(r"(?<!/)(?<!/ )(?P<percent>%|‰|\b(?:percent|permille|ppm)\b)(?!\s*/)\s*")
_TOLERANCE_IN_UNIT = re.compile(r"[±+]|(?<![\w^(*])-")
_NUMBER_IN_UNIT = re.compile(r"/\s*\d|[*,]|(?!1\s*/)\d")


def amount(text: float | str, unit: str) -> float | Toleranced:
    """A quantity in the unit of the model; a number without a unit is in that one already.

    Raises `ProblemError` for a text that is no quantity, and for a unit that cannot be converted.
    """
    if not isinstance(text, str):
        return real("a quantity", text, "a finite number, or a text such as '30 kN/m'")
    found = _QUANTITY.fullmatch(text.replace("\N{MINUS SIGN}", "-"))
    if found is None:
        raise ProblemError(f"expected a quantity, such as '30 kN/m'; received '{text}'.")
    given, repeated = found["unit"], found["repeated"]
    share = _SHARE.search(given)
    if _TOLERANCE_IN_UNIT.search(given) or (repeated not in (None, given) and not share):
        raise _no_tolerances(text)
    if _NUMBER_IN_UNIT.match(given):
        raise ProblemError(f"expected one number, with a decimal point, and its unit; received '{text}'.")
    zone = _zone(found["number"], found["deviations"], text)
    pure = measure(unit)
    is_pure_share = share and given == share["percent"] and pure is not None and not pure.powers
    if share and given != unit and not (is_pure_share and (len(zone) == 1 or repeated == given)):
        example = _written({"nominal": 50.0, "tolerance": 10.0}, unit)
        raise ProblemError(f"expected absolute amounts, such as {example}, no percentage; received '{text}'.")
    scale = _scale(given, unit, zone)
    scaled: dict[str, Any] = {name: real(f"'{text}'", scale * number) for name, number in zone.items()}
    return Toleranced(**scaled) if len(zone) > 1 else scaled["nominal"]


def _zone(nominal: str, deviations: str, text: str) -> dict[str, float]:
    """The numbers of a quantity: its nominal value, and its tolerances by the names that `Toleranced` has for them."""
    if not deviations.strip():
        return {"nominal": float(nominal)}
    try:
        zone = toleranced(nominal + deviations).parameters
    except ProblemError as error:
        raise _no_tolerances(text) from error
    return {name: float(zone[name]) for name in ("nominal", "tolerance", "plus", "minus") if name in zone}


def _written(zone: Mapping[str, float], unit: str) -> str:
    """A quantity as a study file may have it."""
    said = f"{zone['nominal']:.10g}"
    if "tolerance" in zone:
        said += f" ± {zone['tolerance']:.10g}"
    elif "plus" in zone:
        said += f" {zone['plus']:+.10g}/{-zone['minus']:+.10g}"
    return f"'{said}'" if unit in ("", PURE) else f"'{said} {unit}'"


def plain(text: float | str, unit: str) -> float:
    """A quantity without tolerances."""
    found = amount(text, unit)
    if isinstance(found, Toleranced):
        raise ProblemError(f"expected a quantity without tolerances; received '{text}'.")
    return found


def _no_tolerances(text: str) -> ProblemError:
    decimal = re.sub(r"(?<=\d),(?=\d)", ".", text)
    return ProblemError(
        "expected tolerances as on a drawing, with limits apart and the unit once at the end, such as '27.645 "
        f"+0.05/-0.02 mm' or '40 ± 4 N/m'; received '{text}'."
        + (f" Write decimals with a point: '{decimal}'." if decimal != text else "")
    )


def _scale(given: str, wanted: str, zone: Mapping[str, float]) -> float:
    """What numbers in one unit are multiplied by to be in the other."""
    if not given or given == wanted:
        return 1.0
    if not wanted:
        raise ProblemError(
            f"expected a number without a unit, since the model declares none here (`al.parameter('kg')` does for a "
            f"number, `units = {{...}}` of the system for outputs); received the unit '{given}'."
        )
    one, other = measure(given), measure(wanted)
    if one is None or other is None or one.powers != other.powers:
        raise ProblemError(
            f"expected a unit that can be converted to '{wanted}'; received '{given}'. Write factors apart, powers "
            "with '^', and brackets around a product below a fraction stroke: 'N m', 'kg m^2', 'J/(kg K)'."
        )
    if one.zero != other.zero:
        scaled = {name: one.size / other.size * number for name, number in zone.items()}
        there = scaled | {"nominal": scaled["nominal"] + (one.zero - other.zero) / other.size}
        difference = "" if len(zone) > 1 else f", or {_written(scaled, wanted)} if it is a difference or a spread"
        raise ProblemError(
            f"expected a unit whose zero is that of '{wanted}'; received '{given}'. Write "
            f"{_written(there, wanted)}{difference}."
        )
    ratio = one.per(other)
    if ratio is None:
        why = "another power of angles" if one.angles else "no angle"
        raise ProblemError(
            f"expected a unit with the angles of '{wanted}'; received '{given}', which has {why}. Write angles as rad, "
            "deg or turn, speeds as rad/s, rpm or Hz (a turn per second), and what has no angle without one."
        )
    return ratio
