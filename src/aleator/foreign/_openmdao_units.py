"""Units as OpenMDAO writes them, where it knows them."""

import math
import re
from typing import Any

from aleator._core.units import measure

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+")
_ROOTS = {
    **{"meter": "m", "gram": "g", "second": "s", "ampere": "A", "kelvin": "degK", "mole": "mol", "candela": "cd"},
    "radian": "rad",
}

# Digits of the sizes of units in OpenMDAO's library, such as that of psi.
_DIGITS = 1e-8


def as_in_openmdao(unit: str) -> str | None:
    """A unit in OpenMDAO's spelling, `m²/s⁴` as `m**2/s**4`; None where it is unknown to OpenMDAO or to us.

    It is taken only if it has the same size there as here. So `°C` is unknown, which OpenMDAO converts with an offset:
    a standard deviation has none.
    """
    measured, text = measure(unit), _spelt(unit)
    if measured is None or not measured.powers.keys() <= _ROOTS.keys():
        return None
    powers = {**measured.powers, "radian": measured.angles}
    size = _size(text, "*".join(["m/m", *(f"{_ROOTS[name]}**{power}" for name, power in powers.items() if power)]))
    return text if size is not None and math.isclose(size, measured.size, rel_tol=_DIGITS) else None


def _spelt(unit: str) -> str:
    powered = re.sub(r"[⁻⁺]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda found: f"**{found[0].translate(_SUPERSCRIPTS)}", unit.strip())
    factors = re.sub(r"\s*[·⋅×.]\s*|(?<=[\w)])\s+(?=[\w(])", "*", powered.replace("^", "**"))
    return factors.replace("°", "deg")


def _size(text: str, base: str) -> float | None:
    from openmdao.utils.units import convert_units

    try:
        found: Any = convert_units(1.0, text, base)
    except Exception:  # whatever Python raises where OpenMDAO evaluates the text
        return None
    return float(found)
