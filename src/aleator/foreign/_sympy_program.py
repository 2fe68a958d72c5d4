"""Expressions of SymPy as programs of JAX, as plain text: equal models are equal, and can be pickled."""

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.scipy.special  # The text names it.
from jaxtyping import Array

from aleator._core.errors import MissingExtraError, ProblemError

# Functions that SymPy's printer does not know of JAX.
_SPECIAL = MappingProxyType(
    {name: f"jax.scipy.special.{ours}" for name, ours in (("erf", "erf"), ("erfc", "erfc"), ("loggamma", "gammaln"))}
)


class Program(NamedTuple):
    """A function of some numbers in order: `text` defines `value`, which takes those at the places it needs."""

    places: tuple[int, ...]
    text: str

    def __call__(self, values: Sequence[Any] | Mapping[int, Any]) -> list[Array]:
        """The value of each expression, scalars."""
        found = _function(self.text)(*(values[place] for place in self.places))
        return [jnp.asarray(value, dtype=float) for value in found]


def load_sympy(who: str) -> Any:
    """SymPy, imported late. Raises `MissingExtraError` if it is not installed."""
    try:
        import sympy
        import sympy.physics.mechanics
    except ImportError as error:
        raise MissingExtraError(
            f"{who} needs the library SymPy: install it with `pip install 'aleator[sympy]'`."
        ) from error
    return sympy


def written(who: str, expressions: Iterable[Any], symbols: Iterable[Any]) -> Program:
    """The program of some expressions as a function of the values of `symbols`, in their order.

    Raises `ProblemError` for what JAX has no function for, and for numbers that are not real and finite.
    """
    sympy = load_sympy(who)
    # Real, so that `re(x)` and the derivative of `Abs(x)` become what they are for numbers.
    places = {symbol: i for i, symbol in enumerate(symbols)}
    real = {symbol: sympy.Symbol(f"v{i}", real=True) for symbol, i in places.items()}
    expressions = list(expressions)
    plain = [expression.xreplace(real) for expression in expressions]
    plain = [expression.doit() if expression.has(sympy.Derivative) else expression for expression in plain]
    for ours, theirs in zip(plain, expressions, strict=True):
        infinite = any(math.isinf(float(number)) for number in ours.atoms(sympy.Float, sympy.Rational))
        if infinite or ours.has(sympy.I, sympy.oo, sympy.zoo, sympy.nan):
            raise ProblemError(f"{who}: expected real numbers below 1e308; received {str(theirs)[:80]}.")
    used = set[Any]().union(*(expression.free_symbols for expression in plain))
    program = _program({i: real[symbol] for symbol, i in places.items() if real[symbol] in used}, plain)
    if not _is_traceable(program):
        parts = [part for one in plain for part in sympy.postorder_traversal(one) if isinstance(part, sympy.Expr)]
        # Of nested functions the innermost is the one that is not known.
        unknown = next(
            part for part in parts if not _is_traceable(_program(dict(enumerate(part.free_symbols)), [part]))
        )
        raise ProblemError(
            f"{who}: JAX has no function for {type(unknown).__name__}; rewrite it by elementary ones "
            "(expression.rewrite(...), .doit()), or write the model as an al.System."
        )
    return program


def _program(symbols: Mapping[int, Any], expressions: Sequence[Any]) -> Program:
    """Common subexpressions first. The text has the symbols' numbers, whatever they are called."""
    sympy = load_sympy("")
    common, reduced = sympy.cse(expressions, symbols=sympy.numbered_symbols("x"))
    printed = _printer().doprint
    lines = [f"    {symbol} = {printed(part)}" for symbol, part in common]
    values = ", ".join(map(printed, reduced))
    head = f"def value({', '.join(map(str, symbols.values()))}):"
    return Program(tuple(symbols), "\n".join([head, *lines, f"    return [{values}]"]))


def _is_traceable(program: Program) -> bool:
    """Whether JAX has all functions of a program, and traces it: no choice or loop of Python depends on a number."""
    try:
        jax.eval_shape(
            lambda *values: program(dict(zip(program.places, values, strict=True))), *[0.5] * len(program[0])
        )
    except Exception:  # whatever Python and JAX raise for what they cannot read or trace
        return False
    return True


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

        def _print_Integer(self, expr: Any) -> str:  # noqa: N802
            return str(expr.p) if abs(expr.p) < 2**53 else repr(float(expr))

        def _print_Rational(self, expr: Any) -> str:  # noqa: N802
            return f"({expr.p}/{expr.q})" if max(abs(expr.p), expr.q) < 2**53 else repr(float(expr))

        def _print_Pow(self, expr: Any, rational: bool = False) -> str:  # noqa: N802
            if expr.exp.is_Integer and expr.exp < 0:
                return f"(1/({self._print(expr.base**-expr.exp)}))"
            return super()._print_Pow(expr, rational=rational)

    # What it does not know it writes as it is called, which no program then finds.
    return Printer({"fully_qualified_modules": True, "allow_unknown_functions": True, "user_functions": _SPECIAL})
