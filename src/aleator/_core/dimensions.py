"""Units written as text: their dimension and size in SI units, or that they are unknown.

The parser knows SI units with their prefixes, and some others in common use, in the usual notations: `N m`, `N·m`,
`N*m`, `kg m²/s²`, `kg m^2 s^-2`, `J/(kg K)`. An ambiguous text is unknown, and so never in conflict with another:
`W/m² K`; `rpm`; `g`, `C` and `F` alone (gram or gravity, coulomb or Celsius, farad or Fahrenheit).
"""

import math
import re
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

_DIGITS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+")
_TOKENS = re.compile(
    r"\s*(?:(?P<symbol>°[CF]?|%|‰|[A-Za-z\u00b5\u03bc\u03a9\u2126]+)|(?P<power>[⁻⁺]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+|(?:\^|\*\*)\s*(?:[-+]?\d+|\([-+]?\d+\)))"
    r"|(?P<digits>-?\d+)|(?P<mark>[()/·⋅*×.]))"
)
_ROUNDING = 1e-9


class Measure(NamedTuple):
    """A unit: powers of metre, kilogram, second, ampere, kelvin, mole and candela, and its size in these.

    Angles are pure numbers, and the radian is one. Degrees Celsius count as kelvins, because temperature differences
    are equal in both.
    """

    powers: tuple[int, ...]
    scale: float

    def times(self, other: "Measure", power: int = 1) -> "Measure":
        """The product with a power of another unit."""
        powers = tuple(one + power * more for one, more in zip(self.powers, other.powers, strict=True))
        return Measure(powers, self.scale * other.scale**power)


def _measure(scale: float = 1.0, **powers: int) -> Measure:
    return Measure(tuple(powers.get(name, 0) for name in ("m", "kg", "s", "A", "K", "mol", "cd")), scale)


_PURE = _measure()
# The micro sign and the small letter mu, and below the capital omega and the ohm sign, look alike.
_PREFIXES = {"T": 1e12, "G": 1e9, "M": 1e6, "k": 1e3, "h": 1e2, "da": 1e1, "d": 1e-1, "c": 1e-2, "m": 1e-3} | {
    **{"\u00b5": 1e-6, "\u03bc": 1e-6, "u": 1e-6, "n": 1e-9, "p": 1e-12},
}
_WITH_PREFIX = {
    **{name: _measure(**{name: 1}) for name in ("m", "s", "A", "K", "mol", "cd")},
    "g": _measure(1e-3, kg=1),
    "rad": _PURE,
    "Hz": _measure(s=-1),
    "N": _measure(kg=1, m=1, s=-2),
    "Pa": _measure(kg=1, m=-1, s=-2),
    "bar": _measure(1e5, kg=1, m=-1, s=-2),
    "J": _measure(kg=1, m=2, s=-2),
    "Nm": _measure(kg=1, m=2, s=-2),
    "eV": _measure(1.602176634e-19, kg=1, m=2, s=-2),
    "Wh": _measure(3600.0, kg=1, m=2, s=-2),
    "W": _measure(kg=1, m=2, s=-3),
    "C": _measure(A=1, s=1),
    "V": _measure(kg=1, m=2, s=-3, A=-1),
    "F": _measure(kg=-1, m=-2, s=4, A=2),
    **dict.fromkeys(("\u03a9", "\u2126", "ohm"), _measure(kg=1, m=2, s=-3, A=-2)),
    "S": _measure(kg=-1, m=-2, s=3, A=2),
    "Wb": _measure(kg=1, m=2, s=-2, A=-1),
    "T": _measure(kg=1, s=-2, A=-1),
    "H": _measure(kg=1, m=2, s=-2, A=-2),
    **dict.fromkeys(("l", "L"), _measure(1e-3, m=3)),
}
_ALONE = {
    **dict.fromkeys(("°", "deg"), _measure(math.pi / 180)),
    "sr": _PURE,
    "%": _measure(1e-2),
    "‰": _measure(1e-3),
    "ppm": _measure(1e-6),
    "min": _measure(60.0, s=1),
    "h": _measure(3600.0, s=1),
    "d": _measure(86400.0, s=1),
    "t": _measure(1000.0, kg=1),
    **dict.fromkeys(("°C", "degC"), _measure(K=1)),
    **dict.fromkeys(("°F", "degF"), _measure(5 / 9, K=1)),
    "in": _measure(0.0254, m=1),
    "ft": _measure(0.3048, m=1),
    "yd": _measure(0.9144, m=1),
    "mi": _measure(1609.344, m=1),
    "mph": _measure(0.44704, m=1, s=-1),
    "lb": _measure(0.45359237, kg=1),
    "lbf": _measure(4.4482216152605, kg=1, m=1, s=-2),
    "psi": _measure(6894.757293168361, kg=1, m=-1, s=-2),
}
_AMBIGUOUS = ("g", "C", "F", "pH")


class _UnknownError(Exception):
    """A text that is no unit, or ambiguous."""


@lru_cache(maxsize=256)
def measure(unit: str) -> Measure | None:
    """The measure of a unit; None if unknown."""
    text = unit.strip()
    if text == "-":
        return _PURE
    try:
        tokens = _tokens(text)
        found = _quotient(tokens)
        return None if tokens else found
    except _UnknownError:
        return None


def is_same(first: Measure, second: Measure) -> bool:
    """Whether two units have the same dimension and size."""
    return first.powers == second.powers and math.isclose(first.scale, second.scale, rel_tol=_ROUNDING)


def all_same(units: Iterable[str]) -> bool:
    """Whether all units are known and equal, however they are written."""
    first, *others = map(measure, units)
    return first is not None and all(one is not None and is_same(first, one) for one in others)


class _Token(NamedTuple):
    kind: str
    text: str


def _tokens(text: str) -> list[_Token]:
    """The tokens of a text in reverse order."""
    found, at = [], 0
    while at < len(text):
        match = _TOKENS.match(text, at)
        if match is None:
            raise _UnknownError
        found.append(_Token(match.lastgroup or "", match.group(match.lastgroup or 0)))
        at = match.end()
    return found[::-1]


def _quotient(tokens: list[_Token]) -> Measure:
    result, _ = _product(tokens)
    while tokens and tokens[-1].text == "/":
        tokens.pop()
        below, factors = _product(tokens)
        if factors > 1:
            raise _UnknownError  # `a/b c` is `a/(b c)` to some, and `(a/b) c` to others
        result = result.times(below, -1)
    return result


def _product(tokens: list[_Token]) -> tuple[Measure, int]:
    """The next product, and the number of its factors."""
    result, factors = _factor(tokens), 1
    while tokens and tokens[-1].text not in ("/", ")"):
        if tokens[-1].kind == "mark" and tokens[-1].text != "(":
            tokens.pop()
        result, factors = result.times(_factor(tokens)), factors + 1
    return result, factors


def _factor(tokens: list[_Token]) -> Measure:
    if not tokens:
        raise _UnknownError
    token = tokens.pop()
    if token.text == "1":
        return _PURE
    if token.text == "(":
        base = _quotient(tokens)
        if not tokens or tokens.pop().text != ")":
            raise _UnknownError
    elif token.kind == "symbol":
        base = _symbol(token.text)
    else:
        raise _UnknownError
    return _PURE.times(base, _power(tokens, base))


def _power(tokens: list[_Token], base: Measure) -> int:
    """The power after a factor. Plain digits are one for lengths and times only, as in `m2`; signed ones for any."""
    if not tokens or tokens[-1].kind not in ("power", "digits"):
        return 1
    token = tokens.pop()
    is_simple = sum(map(abs, base.powers)) == 1 and (base.powers[0] or base.powers[2])
    if token.kind == "digits" and not (token.text.startswith("-") or is_simple):
        raise _UnknownError
    return int(token.text.translate(_DIGITS).lstrip("^* ").strip("()"))


def _symbol(text: str) -> Measure:
    if text in _AMBIGUOUS:
        raise _UnknownError
    if text in _ALONE or text in _WITH_PREFIX:
        return _ALONE.get(text) or _WITH_PREFIX[text]
    for prefix, factor in _PREFIXES.items():
        if text.startswith(prefix) and text[len(prefix) :] in _WITH_PREFIX:
            base = _WITH_PREFIX[text[len(prefix) :]]
            return base._replace(scale=factor * base.scale)
    raise _UnknownError
