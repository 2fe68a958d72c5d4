"""Expressions of SymPy as programs of JAX, as plain text: equal models share what is compiled, and others never do.

The text has the common subexpressions first. Its variables are numbered: what a symbol is called is no part of it.
"""

import ast
import functools
import math
from collections.abc import Mapping, Sequence
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
# Names in a text besides symbols, and what SymPy writes in Python where it knows nothing of JAX, as for sums.
_NAMES = {"jax", "functools", "abs"}
_OF_PYTHON = (ast.IfExp, ast.comprehension, ast.BoolOp, ast.Lambda)
_MODULES = {"jax", "jax.numpy", "jax.scipy.special", "functools"}


class Program(NamedTuple):
    """A function of named numbers: `text` defines `value` with one argument for each of `arguments`."""

    arguments: tuple[str, ...]
    text: str

    def __call__(self, values: Mapping[str, Any]) -> list[Array]:
        """The value of each expression, scalars; `values` may have more names than the program reads."""
        found = _function(self.text)(*(values[name] for name in self.arguments))
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


def written(who: str, expressions: Sequence[Any], meanings: Mapping[Any, str]) -> Program:
    """The program of some expressions, all of whose symbols have `meanings`: the names under which it reads them.

    Raises `ProblemError` for what JAX has no function for, and for numbers that are not real.
    """
    sympy = load_sympy(who)
    # Real, so that `re(x)` and the derivative of `Abs(x)` become what they are for numbers.
    real = {symbol: sympy.Symbol(f"v{i}", real=True) for i, symbol in enumerate(meanings)}
    plain = [_evaluated(sympy, expression.xreplace(real)) for expression in expressions]
    used = set[Any]().union(*(expression.free_symbols for expression in plain))
    for ours, theirs in zip(plain, expressions, strict=True):
        if ours.has(sympy.I, sympy.zoo, sympy.nan):
            raise ProblemError(f"{who}: expected real and finite expressions; received {_brief(theirs)}.")
        if any(math.isinf(float(number)) for number in ours.atoms(sympy.Number)):
            raise ProblemError(f"{who}: expected numbers below 1e308; received {_brief(theirs)}.")
    common, reduced = sympy.cse(plain, symbols=sympy.numbered_symbols("x"))
    printer = _printer()
    lines = [f"    {symbol} = {_printed(who, printer, part)}" for symbol, part in common]
    values = ", ".join(_printed(who, printer, part) for part in reduced)
    read = {own: symbol for symbol, own in real.items() if own in used}
    text = "\n".join([f"def value({', '.join(map(str, read))}):", *lines, f"    return [{values}]"])
    return Program(tuple(meanings[symbol] for symbol in read.values()), text)


def _evaluated(sympy: Any, expression: Any) -> Any:
    """An expression without derivatives that have become known, such as that of `re(x)` by a real `x`."""
    return expression.doit() if expression.has(sympy.Derivative) else expression


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

    return Printer({"fully_qualified_modules": True, "allow_unknown_functions": False, "user_functions": _SPECIAL})


def _printed(who: str, printer: Any, expression: Any) -> str:
    text = _text(printer, expression)
    if text is not None:
        return text
    from sympy import postorder_traversal

    # Of nested functions the innermost is the one that is not known.
    unknown = next(part for part in postorder_traversal(expression) if _text(printer, part) is None)
    raise ProblemError(
        f"{who}: JAX has no function for {type(unknown).__name__}; rewrite it by elementary ones "
        "(expression.rewrite(...), .doit()), or write the model as an al.System."
    )


def _text(printer: Any, expression: Any) -> str | None:
    """An expression in JAX, or none if it has a function that JAX lacks."""
    from sympy.printing.codeprinter import PrintMethodNotImplementedError

    printer.module_imports.clear()
    try:
        text = printer.doprint(expression)
    except PrintMethodNotImplementedError:
        return None
    imports = printer.module_imports
    known = set(imports) <= _MODULES and all(hasattr(jnp, name) for name in imports.get("jax.numpy", ()))
    return text if known and _is_traceable(text, {str(symbol) for symbol in expression.free_symbols}) else None


def _is_traceable(text: str, symbols: set[str]) -> bool:
    """Whether a text has names of JAX and symbols alone, and no choices or loops of Python, which JAX cannot trace."""
    try:
        nodes = list(ast.walk(ast.parse(text, mode="eval")))
    except SyntaxError:
        return False
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    return names <= symbols | _NAMES and not any(isinstance(node, _OF_PYTHON) for node in nodes)


def _brief(expression: Any) -> str:
    text = str(expression)
    return text if len(text) <= 80 else text[:79] + "…"
