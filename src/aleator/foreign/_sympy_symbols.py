"""The symbols of a SymPy model: states, inputs and parameters, against the numbers and assumptions that they have."""

import contextlib
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from aleator._core.border import meant, refusal, shown
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf, highest, lowest, realised_shape, stored_numbers
from aleator.foreign._sympy_program import load_sympy
from aleator.trajectories import AbstractSignal, AbstractTrajectory

# Weights of a number within a range that is no fraction of it.
_GOLDEN = np.array([(5**0.5 - 1) / 2, (3 - 5**0.5) / 2])


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


def names_of(who: str, moving: Iterable[Any], parameters: Iterable[Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names of symbols that move continuously, and of parameters.

    Raises `ProblemError` where two have the same, and where SymPy takes what moves to be integer, or zero.
    """
    found: dict[str, Any] = {}
    for symbol in (moving := list(moving)):
        refuse_stepping(who, symbol)
    for symbol in (*moving, *(parameters := list(parameters))):
        if found.setdefault(name_of(symbol), symbol) != symbol:
            raise ProblemError(
                f"{who}: two different symbols are called '{name_of(symbol)}'. Rename one; symbols with other "
                "assumptions, such as Symbol('m') and Symbol('m', positive=True), are different."
            )
    return tuple(map(name_of, moving)), tuple(map(name_of, parameters))


def refuse_stepping(who: str, symbol: Any) -> None:
    """Raise `ProblemError` for a function of time that SymPy takes to be integer, or zero: it moves continuously."""
    if kind := next((kind for kind in ("integer", "zero") if getattr(symbol, f"is_{kind}")), None):
        raise ProblemError(
            f"{who}: SymPy takes '{name_of(symbol)}' to be {kind}, and simplifies by it; expected a symbol without "
            "this assumption for what moves continuously."
        )


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
    refuse_unknown(f"{who}: numbers", given, symbols, "Drop it.")
    if missing := sorted(name_of(symbol) for symbol in symbols if symbol not in given):
        raise ProblemError(
            f"{who}: expected a number, a distribution or a decision for each parameter in numbers; received none for "
            f"{missing}."
        )
    return {name_of(symbol): number_of(who, "number", symbol, given[symbol]) for symbol in symbols}


def number_of(who: str, what: str, symbol: Any, given: Any) -> Any:
    """One number of a symbol. Raises `ProblemError` for what is none, or contradicts what SymPy assumes of it."""
    name = name_of(symbol)
    if isinstance(given, AbstractSignal) and what == "number":
        return _signal(who, symbol, given)
    if not isinstance(given, AbstractLeaf) and realised_shape(given) != ():
        raise ProblemError(f"{who}: expected one number for '{name}'; received shape {realised_shape(given)}.")
    number = stored_numbers(f"{who}: {what} of '{name}'", given)
    _refuse_contradiction(who, symbol, number)
    return number


def _signal(who: str, symbol: Any, given: AbstractSignal) -> AbstractSignal:
    if not symbol.is_Function:
        # Its rate would be missing wherever SymPy has differentiated by time.
        raise ProblemError(
            f"{who}: SymPy takes the symbol '{symbol}' to be constant; received a signal, {type(given).__name__}. Put "
            "a function of time in its place (dynamicsymbols)."
        )
    refuse_stepping(who, symbol)
    if isinstance(given, AbstractTrajectory) and given.shape != ():
        raise ProblemError(f"{who}: expected a signal of one number for '{symbol}'; received shape {given.shape}.")
    return given


def _refuse_contradiction(who: str, symbol: Any, number: Any) -> None:
    """Raise `ProblemError` if a number can take a value that contradicts what SymPy assumes of its symbol."""
    low, high = lowest(number), highest(number)
    if low is None or high is None:  # traced: it has been looked at before
        return
    sympy = load_sympy(who)
    # A range has its ends, zero between them, and a number that is not whole.
    ends = np.nan_to_num([low, high], posinf=1e6, neginf=-1e6)
    values = [*ends.tolist(), *([0.0] if low < 0 < high else ()), *([float(ends @ _GOLDEN)] if low < high else ())]
    exact = [sympy.Integer(int(value)) if value.is_integer() else sympy.Float(value) for value in values]
    # What the user wrote comes before what follows from it.
    assumed = {**getattr(symbol, "_assumptions_orig", {}), **symbol.assumptions0}
    for kind, holds in assumed.items():
        if any(getattr(value, f"is_{kind}") is (not holds) for value in exact):
            raise ProblemError(
                f"{who}: SymPy takes '{name_of(symbol)}' to be {'' if holds else 'not '}{kind}, and simplifies by it; "
                f"received {shown(low if low == high else number)}. Change the number, or the assumption of the symbol."
            )


def refuse_unknown(what: str, symbols: Iterable[Any], known: Iterable[Any], remedy: str) -> None:
    """Raise `ProblemError` for the first of `symbols` that is not `known`."""
    known = list(known)
    names = [name_of(other) for other in known]
    for symbol in symbols:
        if symbol not in known and name_of(symbol) in names:
            raise ProblemError(
                f"{what}: '{symbol}' is another symbol than the model's of this name: one is a function of time, or "
                "their assumptions differ. Use the very same symbol."
            )
        if symbol not in known:
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


def structure(field: str, name: str, kind: Callable[[Any], Any] = tuple) -> Any:
    """A property of a system of SymPy that its structure, in a field, has under this name."""
    return property(lambda system: kind(getattr(getattr(system, field), name)))
