"""What SymPy gives: expressions, the symbols and numbers that they may have, and their programs in JAX.

A program is plain text: equal models are equal, and can be pickled.
"""

import contextlib
import functools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.special  # The text names it.
import numpy as np
from jaxtyping import Array

from aleator._core.border import meant, one_of, refusal, shown
from aleator._core.errors import ProblemError, optional
from aleator._core.leaves import AbstractLeaf, Module, highest, lowest, realised_shape, stored_numbers
from aleator.trajectories import AbstractSignal, AbstractTrajectory

# Functions that SymPy's printer does not know of JAX.
_SPECIAL = MappingProxyType(
    {name: f"jax.scipy.special.{name}" for name in ("erf", "erfc", "gamma")} | {"loggamma": "jax.scipy.special.gammaln"}
)
# Weights of a number within a range that is no fraction of it.
_GOLDEN = np.array([(5**0.5 - 1) / 2, (3 - 5**0.5) / 2])


def load_sympy(who: str) -> Any:
    """SymPy, imported late. Raises `MissingExtraError` if it is not installed."""
    return [optional(library, who, "'aleator[sympy]'") for library in ("sympy.physics.mechanics", "sympy")][1]


def time_symbol() -> Any:
    """The time of SymPy's mechanics."""
    mechanics: Any = load_sympy("from_sympy").physics.mechanics
    return mechanics.dynamicsymbols._t


# --- Expressions and what they contain --------------------------------------------------------------------------------


def expression(what: str, given: Any) -> Any:
    """One real expression or number, of SymPy or Python. Raises `ProblemError` for anything else."""
    sympy = load_sympy(what)
    found: Any = None
    with contextlib.suppress(sympy.SympifyError, TypeError, ValueError):
        found = sympy.sympify(given, strict=True)
    if not isinstance(found, sympy.Expr) or isinstance(found, sympy.MatrixExpr):
        solved = " (solve equations first, by sympy.solve)" * isinstance(found, sympy.Equality)
        raise refusal(what, f"one SymPy expression{solved}", given)
    inside = [derivative.expr for derivative in found.atoms(sympy.Derivative)]
    return found if all(isinstance(inner, sympy.core.function.AppliedUndef) for inner in inside) else found.doit()


def expressions_by_name(what: str, given: Any) -> dict[str, Any]:
    """Expressions by name. Raises `ProblemError` for anything but a mapping of texts."""
    if not isinstance(given, Mapping) or not all(isinstance(name, str) and name for name in given):
        raise refusal(what, "expressions by name, in a dict", given)
    return {name: expression(f"{what}, '{name}'", formula) for name, formula in given.items()}


def contents_of(who: str, expressions: Iterable[Any]) -> tuple[list[Any], list[Any], list[Any]]:
    """Functions of time in expressions, such as `q(t)`, derivatives of these, and plain symbols, each by their names.

    The time is a symbol where it stands outside of functions. Raises `ProblemError` for functions of anything else.
    """
    sympy = load_sympy(who)
    whole, time, applied = sympy.Tuple(*expressions), time_symbol(), sympy.core.function.AppliedUndef
    functions = whole.atoms(applied)
    derivatives = {derivative for derivative in whole.atoms(sympy.Derivative) if derivative.has(applied)}
    for function in functions:
        if function.args != (time,):
            raise ProblemError(
                f"{who}: expected functions of the time {time} alone (sympy.physics.mechanics.dynamicsymbols); "
                f"received {function}."
            )
    plain = whole.xreplace({part: sympy.Dummy() for part in derivatives | functions})
    symbols = (symbol for symbol in plain.free_symbols if not isinstance(symbol, sympy.Dummy))
    return sorted(functions, key=str), sorted(derivatives, key=str), sorted(symbols, key=str)


def refuse_others(what: str, expressions: Iterable[Any], known: Collection[Any], remedy: str) -> None:
    """Raise `ProblemError`, with what to do, if expressions contain anything that is not known."""
    functions, derivatives, symbols = contents_of(what, expressions)
    for part in (*derivatives, *functions, *symbols):
        if part not in known:
            listed = ", ".join(sorted(map(str, known))[:8]) + ", ..." * (len(known) > 8)
            raise ProblemError(f"{what}: expected no other symbols than {listed or 'none'}; received {part}. {remedy}")


# --- Symbols and their numbers ----------------------------------------------------------------------------------------


def name_of(symbol: Any) -> str:
    """The name of a symbol, or of a function of time without its argument: `q`; `q_rate` of its derivative."""
    if symbol.is_Derivative:
        return f"{name_of(symbol.expr)}_rate"
    return symbol.func.__name__ if symbol.args else symbol.name


def symbols_given(what: str, given: Any) -> dict[Any, Any]:
    """A mapping whose keys are symbols or functions of time. Raises `ProblemError` for anything else."""
    sympy = load_sympy(what)
    kinds = sympy.Symbol, sympy.core.function.AppliedUndef
    if not isinstance(given, Mapping) or not all(isinstance(symbol, kinds) for symbol in given):
        raise refusal(what, "a dict by SymPy symbols, or functions of time", given)
    return dict(given)


def numbers_by_name(
    who: str, moving: Sequence[Any], parameters: Sequence[Any], given: Mapping[Any, Any]
) -> dict[str, Any]:
    """The number, distribution, decision or signal of each parameter.

    Raises `ProblemError` for two symbols of one name, also among those that are `moving`, for a parameter without a
    number, for numbers of symbols that nothing contains, and for numbers that contradict their symbol's assumptions.
    """
    symbols: dict[str, Any] = {}
    for symbol in (*moving, *parameters):
        if symbols.setdefault(name_of(symbol), symbol) != symbol:
            raise ProblemError(
                f"{who}: two different symbols are called '{name_of(symbol)}'. Rename one; symbols with other "
                "assumptions, such as Symbol('m') and Symbol('m', positive=True), are different."
            )
    refuse_unknown(f"{who}: numbers", given, parameters)
    if missing := sorted(name_of(symbol) for symbol in parameters if symbol not in given):
        raise ProblemError(f"{who}: expected numbers for all parameters; received none for {missing}.")
    return {name_of(symbol): number_of(f"{who}: the number", symbol, given[symbol]) for symbol in parameters}


def number_of(who: str, symbol: Any, given: Any) -> Any:
    """The number of a symbol, or the signal of a function of time.

    Raises `ProblemError` for what is none, or contradicts the assumptions by which SymPy has simplified.
    """
    what = f"{who} of '{name_of(symbol)}'"
    if isinstance(given, AbstractSignal):
        shape = given.shape if isinstance(given, AbstractTrajectory) else ()
        # The rate of a plain symbol would be missing wherever SymPy has differentiated by time.
        if not symbol.is_Function or shape:
            raise refusal(what, "one constant; signals are for functions of time (dynamicsymbols)", given)
        return given
    if not isinstance(given, AbstractLeaf) and realised_shape(given):
        raise refusal(what, "one number", given)
    number = stored_numbers(what, given)
    low, high = lowest(number), highest(number)
    if low is not None and high is not None:  # not traced: then it has been looked at before
        _refuse_contradiction(what, symbol, low, high)
    return number


def _refuse_contradiction(what: str, symbol: Any, low: float, high: float) -> None:
    """Raise `ProblemError` if a number in a range can take a value that contradicts what SymPy assumes."""
    sympy = load_sympy(what)
    # A range has its ends, zero between them, and a number that is not whole.
    ends = np.nan_to_num([low, high], posinf=1e6, neginf=-1e6)
    values = [*ends.tolist(), *([0.0] if low < 0 < high else ()), *([float(ends @ _GOLDEN)] if low < high else ())]
    exact = [sympy.Integer(int(value)) if value.is_integer() else sympy.Float(value) for value in values]
    # What the user wrote comes before what follows from it.
    assumed = {**getattr(symbol, "_assumptions_orig", {}), **symbol.assumptions0}
    for kind, holds in assumed.items():
        if any(getattr(value, f"is_{kind}") is (not holds) for value in exact):
            range_of = f"{low:g}" if low == high else f"a range from {low:g} to {high:g}"
            raise ProblemError(
                f"{what}: SymPy takes '{name_of(symbol)}' to be {'' if holds else 'not '}{kind}, and simplifies by it; "
                f"received {range_of}. Change the number, or the assumption of the symbol."
            )


def refuse_unknown(what: str, symbols: Iterable[Any], known: Collection[Any]) -> None:
    """Raise `ProblemError` for the first of `symbols` that is not `known`."""
    for symbol in symbols:
        if symbol not in known:
            names = [name_of(other) for other in known]
            hint = " It is another symbol than the model's of this name, with other assumptions, or of other kind."
            hint = hint if name_of(symbol) in names else meant(name_of(symbol), names)
            raise ProblemError(f"{what}: '{symbol}' is not known; expected some of {names}.{hint}")


# --- Programs ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Program:
    """`count` expressions as a function of numbers: `text` defines `value`, which takes a sequence of these.

    - `names`: those of the expressions, if they have any.
    """

    text: str
    count: int
    names: tuple[str, ...] = ()

    def __call__(self, values: Sequence[Any]) -> list[Array]:
        """The value of each expression, scalars."""
        return [jnp.asarray(value, dtype=float) for value in _function(self.text)(values)]

    def by_name(self, values: Sequence[Any]) -> dict[str, Array]:
        """The value of each expression, by its name."""
        return dict(zip(self.names, self(values), strict=True))


class AbstractFromSymPy(Module):
    """What was written in SymPy: the numbers of its symbols, and programs, which are its structure.

    - `numbers`: by the names of symbols; programs take their values in the order of the alphabet;
    - `formulas`: the outputs; `declared`: their units.
    """

    numbers: dict[str, Any] = eqx.field(kw_only=True)
    formulas: Program = eqx.field(static=True, kw_only=True)
    declared: tuple[tuple[str, str], ...] = eqx.field(static=True, kw_only=True)

    units = property(lambda self: dict(self.declared))

    def _values(self) -> list[Any]:
        return [self.numbers[name] for name in sorted(self.numbers)]


def units_given(who: str, units: Any) -> tuple[tuple[str, str], ...]:
    """Units of outputs by name."""
    return tuple(one_of(f"{who}: units", units or {}, Mapping, "{'x': 'm'}").items())


def written(what: str, given: Iterable[Any], symbols: Iterable[Any], remedy: str = "") -> Program:
    """The program of some expressions, or of expressions by name, as a function of the values of `symbols` in order.

    Raises `ProblemError` for other symbols, with a `remedy`, for complex numbers, and for functions that JAX lacks.
    """
    sympy, symbols = load_sympy(what), list(symbols)
    names, expressions = (tuple(given), list(given.values())) if isinstance(given, Mapping) else ((), list(given))
    refuse_others(what, expressions, symbols, remedy)
    # Real, so that `re(x)` and the derivative of `Abs(x)` become what they are for numbers. The text has the symbols'
    # places, whatever they are called.
    real = {symbol: sympy.Symbol(f"v[{i}]", real=True) for i, symbol in enumerate(symbols)}
    plain = [expression.xreplace(real) for expression in expressions]
    plain = [expression.doit() if expression.has(sympy.Derivative) else expression for expression in plain]
    for ours, theirs in zip(plain, expressions, strict=True):
        if ours.has(sympy.I, sympy.oo, sympy.zoo, sympy.nan):
            raise refusal(what, "finite real numbers", theirs)
    try:
        program = Program(_text(plain), len(plain), names)
        jax.eval_shape(lambda number: program([number] * len(symbols)), 0.5)
    except Exception as error:  # whatever Python and JAX raise for what they do not know, or cannot trace
        unknown = getattr(error, "name", None) or shown(str(error))
        raise ProblemError(
            f"{what}: JAX has no function for {unknown}; rewrite it by elementary ones (expression.rewrite(...), "
            ".doit()), or write the model as an al.System."
        ) from error
    return program


def _text(expressions: Sequence[Any]) -> str:
    """Common subexpressions first."""
    sympy = load_sympy("")
    common, reduced = sympy.cse(expressions, symbols=sympy.numbered_symbols("x"))
    printed = _printer().doprint
    lines = [f"    {symbol} = {printed(part)}" for symbol, part in common]
    return "\n".join(["def value(v):", *lines, f"    return [{', '.join(map(printed, reduced))}]"])


@functools.lru_cache(maxsize=1024)
def _function(text: str) -> Any:
    names: dict[str, Any] = {"jax": jax, "functools": functools}
    exec(text, names)
    return names["value"]


@functools.cache
def _printer() -> Any:
    from sympy.printing.numpy import JaxPrinter

    class Printer(JaxPrinter):
        """SymPy's printer of JAX, with numbers to their last bit, and reciprocals as quotients.

        SymPy writes 15 digits of a float, integers that no array can hold, and `x**(-1.0)`, a general power.
        """

        def _print_Float(self, expr: Any) -> str:  # noqa: N802
            return repr(float(expr))

        def _print_Rational(self, expr: Any) -> str:  # noqa: N802
            exact = str(expr.p) if expr.q == 1 else f"({expr.p}/{expr.q})"
            return exact if max(abs(expr.p), expr.q) < 2**53 else repr(float(expr))

        _print_Integer = _print_Rational  # noqa: N815

        def _print_Pow(self, expr: Any, rational: bool = False) -> str:  # noqa: N802
            if expr.exp.is_Integer and expr.exp < 0:
                return f"(1/({self._print(expr.base**-expr.exp)}))"
            return super()._print_Pow(expr, rational=rational)

    # What it does not know it writes as it is called, which no program then finds.
    unknown = {"allow_unknown_functions": True, "strict": False}
    return Printer({"fully_qualified_modules": True, "user_functions": _SPECIAL, **unknown})
