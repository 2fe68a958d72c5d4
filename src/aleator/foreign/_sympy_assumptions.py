"""Assumptions of SymPy's symbols, by which it simplifies, against the numbers that are given for them."""

import math
from types import MappingProxyType
from typing import Any

from aleator._core.border import shown
from aleator._core.errors import ProblemError
from aleator._core.leaves import highest, lowest

_WHOLE = ("integer", "even", "odd", "prime", "composite")
_ORDERED = ("positive", "negative", "nonnegative", "nonpositive", "zero", "nonzero")
_ASSUMED = (*_ORDERED, *_WHOLE, "noninteger", "real", "complex", "finite", "infinite", "imaginary")
_COMPLEMENT = MappingProxyType(
    {"nonnegative": "negative", "nonpositive": "positive", "nonzero": "zero", "noninteger": "integer"}
)


def refuse_contradiction(who: str, name: str, symbol: Any, number: Any) -> None:
    """Raise `ProblemError` if a number can take a value that contradicts what SymPy assumes of its symbol."""
    low, high = lowest(number), highest(number)
    if low is None or high is None:  # traced: it has been looked at before
        return
    # What the user wrote comes before what follows from it.
    written = [kind for kind in getattr(symbol, "_assumptions_orig", ()) if kind in _ASSUMED]
    for kind in dict.fromkeys([*written, *_ASSUMED]):
        assumed = getattr(symbol, f"is_{kind}")
        if assumed is not None and assumed is not _holds(kind, low, high):
            raise ProblemError(
                f"{who}: SymPy takes '{name}' to be {'' if assumed else 'not '}{kind}, and simplifies by it; received "
                f"{shown(low if low == high else number)}. Change the number, or the assumption of the symbol."
            )


def refuse_stepping(who: str, symbol: Any, name: str) -> None:
    """Raise `ProblemError` for a function of time that SymPy takes to be integer, or zero: it moves continuously."""
    if kind := next((kind for kind in ("integer", "zero") if getattr(symbol, f"is_{kind}")), None):
        raise ProblemError(
            f"{who}: SymPy takes '{name}' to be {kind}, and simplifies by it; expected a symbol without this "
            "assumption for what moves continuously."
        )


def _holds(kind: str, low: float, high: float) -> bool | None:
    """Whether all values from `low` to `high` are of a kind; None if some are."""
    if kind in _COMPLEMENT:
        other = _holds(_COMPLEMENT[kind], low, high)
        return None if other is None else not other
    if kind in _WHOLE:
        return _is_whole(kind, low, high)
    if kind in ("infinite", "imaginary"):
        return False
    if kind in ("real", "complex", "finite"):
        return True
    if kind == "zero":
        return True if low == high == 0 else None if low <= 0 <= high else False
    above, below = (low > 0, high <= 0) if kind == "positive" else (high < 0, low >= 0)
    return True if above else False if below else None


def _is_whole(kind: str, low: float, high: float) -> bool | None:
    if low != high:
        return None if not (math.isfinite(low) and math.isfinite(high)) or math.ceil(low) <= math.floor(high) else False
    if not float(low).is_integer():
        return False
    import sympy

    return bool(getattr(sympy.Integer(int(low)), f"is_{kind}"))
