"""Units as text: those of products, powers, rates and integrals over time, and what they measure, by pint.

A unit is a text that a model declares, such as `N m` or `m²/s⁴`. An empty text is an unknown unit, from which nothing
follows; `-` is the unit of a pure number. Derived units are composed as texts, as a person would write them; pint is
imported where two different texts are compared.
"""

import functools
import math
import re
import unicodedata
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

PURE = "-"
EXPONENTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_DIGITS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
# Units of force or torque, and of the rate that each acts on.
_POWERS = ({"N", "m/s"}, {"N m", "rad/s"}, {"N·m", "rad/s"}, {"Nm", "rad/s"})
_BY_TIME = {(PURE, -1): "s", (PURE, 1): "1/s", ("W", -1): "J", ("J", 1): "W"}
_OVER_SECONDS = re.compile(r"(.+)/s([²³⁴⁵]?)")
_TURN = 2 * math.pi
# Between factors: a sign of multiplication, a dot before a letter, or space.
_TIMES = re.compile(r"\s*[·⋅×*]\s*|(?<=[\w)])\.(?=[^\W\d])|(?<=[^\s*/])\s+(?=[^\s*/])")
# `W/m² K` is `W/(m² K)` to some, and `(W/m²) K` to others.
_AMBIGUOUS = re.compile(r"//|/\s*(?:[^*/()]|\([^()]*\))+\*")
# `s-1` is a power, and so are `m2` and `s2`; `N2` is nitrogen as well.
_PLAIN_POWER = re.compile(r"(?<![\w^.])([^\W\d_]+(?=-)|[a-zµμ]?[ms]|in|ft)(-?\d+)(?!\w)")


def common(units: Iterable[str]) -> str:
    """The unit of a sum: the unit that all terms share, as the first writes it; unknown if they differ."""
    first, *others = list(dict.fromkeys(units)) or [""]
    return first if all(is_same(first, other) for other in others) else ""


def product(first: str, second: str) -> str:
    """The unit of a product: `N` and `m` make `N m`, a force and a speed make `W`."""
    if not (first and second):
        return ""
    if PURE in (first, second):
        return second if first == PURE else first
    if first == second:
        return raised(first, 2)
    return "W" if {first, second} in _POWERS else f"{_factor(first)} {_factor(second)}"


def squared(unit: str) -> str:
    """The unit of a square: `N²`, `(N m)²`."""
    return raised(unit, 2)


def quotient(first: str, second: str) -> str:
    """The unit of a quotient: `N` and `m` make `N/m`, equal units a pure number."""
    if not (first and second):
        return ""
    if second == PURE or is_same(first, second):
        return first if second == PURE else PURE
    return f"{'1' if first == PURE else _factor(first)}/{_base(second)}"


def raised(unit: str, exponent: float) -> str:
    """The unit of a power: `m³`, `(N m)²`; unknown if the exponent is no whole number."""
    if not unit or exponent != int(exponent):
        return ""
    if unit == PURE or exponent == 0:
        return PURE
    return unit if exponent == 1 else f"{_base(unit)}{str(int(exponent)).translate(EXPONENTS)}"


def integrated(unit: str) -> str:
    """The unit of an integral over time: `m²/s⁴` becomes `m²/s³`, `W` becomes `J`."""
    return _by_time(unit, -1)


def rate(unit: str) -> str:
    """The unit of a derivative by time: `rad` becomes `rad/s`, `J` becomes `W`."""
    return _by_time(unit, 1)


def _by_time(unit: str, change: int) -> str:
    """A unit divided by one more power of seconds, or by one less."""
    if not unit or (unit, change) in _BY_TIME:
        return _BY_TIME.get((unit, change), "")
    ending = _OVER_SECONDS.fullmatch(unit)
    base, power = (ending[1], int((ending[2] or "1").translate(_DIGITS))) if ending else (_factor(unit), 0)
    power += change
    if power < 1:
        return f"{base} s" if power else (PURE if base == "1" else base)
    return f"{base}/s{str(power).translate(EXPONENTS) if power > 1 else ''}"


def _factor(unit: str) -> str:
    """A unit as a factor of a product: in brackets if it contains a division."""
    return f"({unit})" if "/" in re.sub(r"\([^()]*\)", "", unit) else unit


def _base(unit: str) -> str:
    return unit if unit.isalpha() else f"({unit})"


class Measure(NamedTuple):
    """What a unit measures, and its size, in pint's root units (metre, gram, second, ...), with angles apart.

    - `zero`: where its zero is, as that of degrees Celsius; `powers` of all root units but the radian;
    - `angles`, `hertz`: powers of the radian and of the hertz; `plainly`: whether radians are the only angles in it.
    """

    size: float
    zero: float
    powers: Mapping[str, float]
    angles: float
    hertz: float
    plainly: bool

    def per(self, other: "Measure") -> float | None:
        """What a number in this unit is multiplied by to be in another of equal powers; None where angles forbid it.

        To pint, as to the SI, a radian is 1, so that a turn per second would be 6.28 Hz. Here a hertz is a turn per
        second wherever it meets an angle, and a plain `1/s` is never one: nobody could tell turns from radians.
        Radians alone may be left out beside a mass, where nothing else can be meant: `N m/rad` and `N m`.
        """
        ratio = self.size / other.size
        if self.angles == other.angles:
            return ratio
        if self.angles + self.hertz == other.angles + other.hertz:
            return ratio * _TURN ** (self.hertz - other.hertz)
        is_plain = self.plainly and other.plainly and not (self.hertz or other.hertz)
        return ratio if is_plain and "gram" in self.powers else None


def is_same(first: str, second: str) -> bool:
    """Whether two units are known and equal, however they are written."""
    if first == second or not (first and second):
        return first == second != ""
    one, other = measure(first), measure(second)
    if one is None or other is None or one.powers != other.powers:
        return False
    ratio = one.per(other)
    return ratio is not None and math.isclose(ratio, 1.0, rel_tol=1e-9)


@functools.lru_cache(maxsize=256)
def measure(unit: str) -> Measure | None:
    """What a unit measures; None if it is unknown, logarithmic (as a decibel), or can be read in two ways."""
    text = unicodedata.normalize("NFC", unit).strip().replace("**", "^")  # an ohm sign becomes a capital omega
    text = _TIMES.sub("*", "1" if text == PURE else text)
    if not text or _AMBIGUOUS.search(text):
        return None
    registry = _registry()
    try:
        written = registry.parse_units(_PLAIN_POWER.sub(r"\1^\2", f"1{text}" if text.startswith("/") else text))
        root, twice = (registry.Quantity(number, written).to_root_units() for number in (1.0, 2.0))
        zero = registry.Quantity(0.0, written).to_root_units().magnitude
    except Exception:  # pint, and Python's tokenizer below it, have one for each way to fail
        return None
    size = root.magnitude - zero
    if not math.isclose(twice.magnitude - zero, 2 * size, rel_tol=1e-9):
        return None
    powers = dict(root.unit_items())
    angles = powers.pop("radian", 0)
    factors = dict(registry.Quantity(1.0, written).unit_items())
    hertz = sum(power for name, power in factors.items() if name.endswith("hertz"))
    return Measure(float(size), float(zero), powers, angles, hertz, factors.get("radian", 0) == angles)


@functools.cache
def _registry() -> Any:
    import pint

    registry = pint.UnitRegistry(on_redefinition="ignore")  # of Nm, a measure of yarn there
    registry.define("@alias turn = rev")
    registry.define("newton_meter = newton * meter = Nm")
    return registry
