"""The symbols of a SymPy model: states, inputs and parameters, against the numbers and assumptions that they have."""

import contextlib
import math
from collections.abc import Collection, Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from aleator._core.border import meant, refusal, shown
from aleator._core.errors import ProblemError
from aleator._core.leaves import highest, lowest, realised_shape, stored_numbers
from aleator.foreign._sympy_program import load_sympy
from aleator.trajectories import AbstractSignal, AbstractTrajectory

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


class Contents(NamedTuple):
    """What some expressions contain, each in the order of its name.

    - `functions`: functions of time without an equation of their own, such as `q(t)`; `derivatives` of these;
    - `symbols`: plain symbols, the time too where it stands outside of functions.
    """

    functions: tuple[Any, ...]
    derivatives: tuple[Any, ...]
    symbols: tuple[Any, ...]


def expression(what: str, given: Any) -> Any:
    """One real expression or number, of SymPy or Python. Raises `ProblemError` for anything else."""
    sympy = load_sympy(what)
    if isinstance(given, sympy.Equality):
        raise ProblemError(
            f"{what}: expected an expression; received an equation. Solve it with sympy.solve, or write an al.System "
            "with `algebraic` and `residual`."
        )
    found: Any = None
    with contextlib.suppress(sympy.SympifyError, TypeError, ValueError):
        found = sympy.sympify(given, strict=True)
    if not isinstance(found, sympy.Expr) or isinstance(found, sympy.MatrixExpr):
        raise refusal(what, "one SymPy expression", given)
    of = [derivative.expr for derivative in found.atoms(sympy.Derivative)]
    return found if all(isinstance(inner, sympy.core.function.AppliedUndef) for inner in of) else found.doit()


def expressions_by_name(what: str, given: Any) -> dict[str, Any]:
    """Expressions by name. Raises `ProblemError` for anything but a mapping of texts."""
    if not isinstance(given, Mapping):
        raise refusal(what, "expressions by name, in a dict", given)
    for name in given:
        if not isinstance(name, str) or not name:
            raise refusal(what, "a text as the name of each expression", name)
    return {name: expression(f"{what}, '{name}'", formula) for name, formula in given.items()}


def contents_of(who: str, expressions: Iterable[Any]) -> Contents:
    """What expressions contain. Raises `ProblemError` for functions of anything but the time."""
    sympy = load_sympy(who)
    whole, time = sympy.Tuple(*expressions), time_symbol()
    derivatives = whole.atoms(sympy.Derivative)
    functions = whole.atoms(sympy.core.function.AppliedUndef)
    for function in functions:
        if function.args != (time,):
            raise ProblemError(
                f"{who}: expected functions of the time {time} alone (sympy.physics.mechanics.dynamicsymbols); "
                f"received {function}."
            )
    plain = whole.xreplace({part: sympy.Dummy() for part in derivatives | functions})
    symbols = (symbol for symbol in plain.free_symbols if not isinstance(symbol, sympy.Dummy))
    return Contents(*(tuple(sorted(part, key=str)) for part in (functions, derivatives, symbols)))


def time_symbol() -> Any:
    """The time of SymPy's mechanics."""
    mechanics: Any = load_sympy("from_sympy").physics.mechanics
    return mechanics.dynamicsymbols._t


def name_of(symbol: Any) -> str:
    """The name of a symbol, or of a function of time without its argument: `q`; `q_rate` of its derivative."""
    if symbol.is_Derivative:
        return f"{name_of(symbol.expr)}_rate"
    return symbol.func.__name__ if getattr(symbol, "args", ()) else symbol.name


def named(who: str, symbols: Iterable[Any]) -> dict[Any, str]:
    """Each symbol's name. Raises `ProblemError` where two have the same."""
    found: dict[Any, str] = {}
    for symbol in symbols:
        name = name_of(symbol)
        if name in found.values():
            raise ProblemError(
                f"{who}: two different symbols are called '{name}'. Rename one; symbols with other assumptions, such "
                "as Symbol('m') and Symbol('m', positive=True), are different."
            )
        found[symbol] = name
    return found


def symbols_given(what: str, given: Any) -> dict[Any, Any]:
    """A mapping whose keys are symbols or functions of time. Raises `ProblemError` for anything else."""
    sympy = load_sympy(what)
    if not isinstance(given, Mapping):
        raise refusal(what, "a dict by symbol", given)
    kinds = sympy.Symbol, sympy.core.function.AppliedUndef
    for symbol in given:
        if not isinstance(symbol, kinds):
            raise refusal(what, "SymPy symbols, or functions of time, as keys", symbol)
    return dict(given)


def numbers_for(who: str, symbols: Collection[Any], given: Mapping[Any, Any]) -> dict[str, Any]:
    """The number, distribution or decision of each parameter, by name; a signal may be that of a function of time.

    Raises `ProblemError` for a parameter without one, for numbers of symbols that nothing contains, and for numbers
    that contradict their symbol's assumptions, by which SymPy has simplified.
    """
    names = [name_of(symbol) for symbol in symbols]
    for symbol in given:
        if symbol not in symbols:
            raise ProblemError(f"{who}: numbers has '{name_of(symbol)}', {_stray(name_of(symbol), names)}")
    if missing := sorted(name_of(symbol) for symbol in symbols if symbol not in given):
        raise ProblemError(
            f"{who}: expected a number, a distribution or a decision for each parameter in numbers; received none for "
            f"{missing}."
        )
    return {name_of(symbol): _number(who, symbol, given[symbol]) for symbol in symbols}


def _stray(name: str, names: Collection[str]) -> str:
    """What is wrong with a number of a symbol that is no parameter."""
    if name in names:
        return "another symbol than the model's of this name: their assumptions differ. Use the very same symbol."
    return f"which is no parameter of the model.{meant(name, names) or ' Drop it.'}"


def _number(who: str, symbol: Any, given: Any) -> Any:
    name = name_of(symbol)
    if isinstance(given, AbstractSignal):
        return _signal(who, symbol, given)
    if realised_shape(given) != ():
        raise ProblemError(f"{who}: expected one number for '{name}'; received shape {realised_shape(given)}.")
    number = stored_numbers(f"{who}: number '{name}'", given)
    refuse_contradiction(who, name, symbol, number)
    return number


def _signal(who: str, symbol: Any, given: AbstractSignal) -> AbstractSignal:
    if not symbol.is_Function:
        # Its rate would be missing wherever SymPy has differentiated by time.
        raise ProblemError(
            f"{who}: SymPy takes the symbol '{symbol}' to be constant; received a signal, {type(given).__name__}. Put "
            "a function of time in its place (dynamicsymbols)."
        )
    refuse_stepping(who, symbol, name_of(symbol))
    if isinstance(given, AbstractTrajectory) and given.shape != ():
        raise ProblemError(f"{who}: expected a signal of one number for '{symbol}'; received shape {given.shape}.")
    return given


def refuse_unknown(what: str, symbols: Iterable[Any], known: Iterable[Any], remedy: str) -> None:
    """Raise `ProblemError` for the first of `symbols` that is not `known`."""
    known = list(known)
    for symbol in symbols:
        if symbol not in known:
            names = [name_of(other) for other in known]
            if name_of(symbol) in names:
                raise ProblemError(
                    f"{what}: '{symbol}' is another symbol than the model's of this name: one is a function of time, "
                    "or their assumptions differ. Use the very same symbol."
                )
            raise ProblemError(f"{what}: '{symbol}' is not known.{meant(name_of(symbol), names)} {remedy}")


def units_for(who: str, units: Any, outputs: Collection[str]) -> tuple[tuple[str, str], ...]:
    """Units of outputs. Raises `ProblemError` for units of anything else."""
    given = {} if units is None else units
    if not isinstance(given, Mapping) or not all(isinstance(text, str) for text in (*given, *given.values())):
        raise refusal(f"{who}: units", "units as texts by output, in a dict", units)
    for name in given:
        if name not in outputs:
            raise ProblemError(f"{who}: units has '{name}', which is no output.{meant(name, outputs)}")
    return tuple(given.items())
