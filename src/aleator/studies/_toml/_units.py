"""What a number in one unit is multiplied by to be in another, by pint; angles are a dimension of their own.

To pint, as to the SI, a radian is 1, so that a turn per second would be 6.28 Hz, and a hertz one radian per second.
Here a hertz is a turn per second wherever it meets an angle, and a plain `1/s` is never one: nobody could tell turns
from radians. Radians alone may be left out beside a mass, where nothing else can be meant: `N m/rad` and `N m`.
"""

import functools
import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from aleator._core.errors import MissingExtraError, ProblemError

_PURE = ("-", "1")
_TURN = 2 * math.pi
_WRITE = "Write factors apart and powers with '^', as in 'N m', 'kg m^2' and '1/s'."
# `W/m² K` is `W/(m² K)` to some, and `(W/m²) K` to others.
_AMBIGUOUS = re.compile(r"/\s*[^\s*/·()]+(?:\s+|\s*·\s*)[^\s*/·()]")
_SPACE = re.compile(r"(?<=[^\s*/])\s+(?=[^\s*/])")
_PLAIN_POWER = re.compile(r"(?<![\w^.])([^\W\d_]+)(-?\d+)(?!\w)")


class _Measured(NamedTuple):
    """A unit in root units: its size, powers of all but angles, the power of angles, and that of hertz.

    - `zero`: where its zero is, as that of degrees Celsius; `plainly`: whether radians are the only angles in it.
    """

    size: float
    zero: float
    powers: Mapping[str, float]
    angles: float
    hertz: float
    plainly: bool


def factor(given: str, wanted: str) -> float:
    """What a number in the unit `given` is multiplied by to be in the unit `wanted`.

    Raises `ProblemError` for a unit that is unknown or cannot be converted, and where turns and radians look alike.
    """
    if given == wanted:
        return 1.0
    try:
        one, other = _measured(given), _measured(wanted)
    except ProblemError:
        raise
    except Exception as error:  # pint has one for each way to fail
        raise ProblemError(f"{_expected(given, wanted)} {_WRITE}") from error
    if one.powers != other.powers:
        raise ProblemError(_expected(given, wanted))
    if one.zero != other.zero:
        raise ProblemError(f"expected a unit whose zero is that of '{wanted}'; received '{given}': convert it.")
    ratio = one.size / other.size
    if one.angles == other.angles:
        return ratio
    if one.angles + one.hertz == other.angles + other.hertz:
        return ratio * _TURN ** (one.hertz - other.hertz)
    if one.plainly and other.plainly and "gram" in one.powers and not (one.hertz or other.hertz):
        return ratio
    raise ProblemError(_of_angles(given, wanted, bool(one.angles)))


def _expected(given: str, wanted: str) -> str:
    return f"expected a unit that can be converted to '{wanted}'; received '{given}'."


def _of_angles(given: str, wanted: str, has_angle: bool) -> str:
    why = "which says nothing of turns or radians" if not has_angle else "which has another power of angles"
    return (
        f"expected a unit with the angles of '{wanted}'; received '{given}', {why}. Write angles as rad, deg or turn, "
        "speeds as rad/s, rpm or Hz (a turn per second), and what has no angle without one."
    )


def _measured(unit: str) -> _Measured:
    registry = _registry()
    written = registry.Quantity(1.0, _parsed(unit))
    root, zero = written.to_root_units(), registry.Quantity(0.0, written.units).to_root_units().magnitude
    powers = dict(root.unit_items())
    angles = powers.pop("radian", 0)
    hertz = sum(power for name, power in written.unit_items() if name.endswith("hertz"))
    radians = sum(power for name, power in written.unit_items() if name == "radian")
    return _Measured(float(root.magnitude - zero), float(zero), powers, angles, hertz, radians == angles)


def _parsed(unit: str) -> Any:
    text = unit.replace("⋅", "·").strip()
    if text in _PURE:
        return _registry().parse_units("")
    if _AMBIGUOUS.search(text):
        raise ProblemError(f"expected a unit that can be read in one way alone; received '{unit}'. Write brackets.")
    text = f"1{text}" if text.startswith("/") else text
    return _registry().parse_units(_PLAIN_POWER.sub(_power, _SPACE.sub("*", text.replace("·", "*"))))


def _power(found: re.Match[str]) -> str:
    """`s-1` and `mm2` as powers; digits without a sign count for lengths and times only, as everywhere here."""
    name, digits = found.groups()
    registry = _registry()
    if not digits.startswith("-") and found[0] in registry:
        return found[0]
    is_simple = name in registry and str(registry.get_dimensionality(name)) in ("[length]", "[time]")
    return f"{name}**{digits}" if digits.startswith("-") or is_simple else found[0]


@functools.cache
def _registry() -> Any:
    try:
        import pint
    except ImportError as error:
        raise MissingExtraError("Quantities with units need pint: pip install pint") from error
    registry = pint.UnitRegistry(on_redefinition="ignore")  # of Nm, a measure of yarn there
    registry.define("@alias turn = rev")
    registry.define("newton_meter = newton * meter = Nm")
    return registry
