"""Formulas of an assembly: numbers, names, small arithmetic expressions and Python functions. Angles are in degrees."""

import ast
import keyword
import math
import operator
import unicodedata
from collections.abc import Callable, Collection, Mapping
from functools import cache
from typing import Any, NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.border import meant
from aleator._core.errors import ProblemError
from aleator.dynamics._system import state_type

Formula: TypeAlias = str | float | Callable[[Any], Any]

_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "sin": lambda angle: jnp.sin(jnp.deg2rad(angle)),
    "cos": lambda angle: jnp.cos(jnp.deg2rad(angle)),
    "tan": lambda angle: jnp.tan(jnp.deg2rad(angle)),
    "asin": lambda ratio: jnp.rad2deg(jnp.arcsin(ratio)),
    "acos": lambda ratio: jnp.rad2deg(jnp.arccos(ratio)),
    "atan": lambda ratio: jnp.rad2deg(jnp.arctan(ratio)),
    "sqrt": jnp.sqrt,
}
PREVIOUS = "previous"
"""The word that stands for the direction of the preceding vector."""


class _Expression(NamedTuple):
    """A parsed expression: the names in it, and its value as a function of theirs."""

    names: frozenset[str]
    value: Callable[[Mapping[str, Any]], Any]


def read_formula(given: Any, known: Collection[str], where: str) -> Formula:
    """A formula in parsed form, checked to use only `known` names."""
    if callable(given):
        return given
    if isinstance(given, int | float | np.number) and not isinstance(given, bool) and math.isfinite(given):
        return float(given)
    if not isinstance(given, str):
        raise ProblemError(
            f"{where}: expected a name, a finite number, an expression such as 'e - c', or a function of the named "
            f"values; received {given!r}. Put uncertain or decided numbers among the dimensions, under a name."
        )
    try:
        names = _expression(given).names
    except ProblemError as error:
        raise ProblemError(f"{where}: {error}") from error
    for name in sorted(names.difference(known)):
        raise ProblemError(f"{where}: there is no '{name}'; expected one of {sorted(known)}.{meant(name, known)}")
    return given


def read_equation(given: Any, known: Collection[str], where: str) -> tuple[Formula, Formula]:
    """The two sides of an equation `left = right`; for a formula alone, the formula and zero."""
    left, *rest = given.split("=") if isinstance(given, str) else (given,)
    if len(rest) > 1:
        raise ProblemError(f"{where}: expected 'left = right'; received {given!r}.")
    return read_formula(left, known, where), read_formula(rest[0] if rest else 0.0, known, where)


def names_in(formula: Formula) -> frozenset[str]:
    """The names of values that a formula uses; none for a function, whose names are not known."""
    return _expression(formula).names if isinstance(formula, str) else frozenset()


def evaluate(formula: Formula, values: Mapping[str, Any]) -> Float[Array, ""]:
    """The value of a formula."""
    if isinstance(formula, str):
        number = _expression(formula).value(values)
    else:
        number = formula(state_type(tuple(values))(**values)) if callable(formula) else formula
    number = jnp.asarray(number, dtype=float)
    if number.shape != ():
        raise ProblemError(f"Assembly: a function gives one number; received shape {number.shape}.")
    return number


@cache
def _expression(text: str) -> _Expression:
    """Parse an expression. Raises `ProblemError` for anything but arithmetic."""
    try:
        return _read(ast.parse(text.strip(), mode="eval").body)
    except SyntaxError as error:
        raise ProblemError(f"'{text}' is not an arithmetic expression ({error.msg}).") from error


def _read(node: ast.expr) -> _Expression:
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return _Expression(frozenset(), lambda _: number)
        case ast.Name(id="pi"):
            return _Expression(frozenset(), lambda _: math.pi)
        case ast.Name(id=name):
            return _Expression(frozenset({name}), lambda values: values[name])
        case ast.UnaryOp(op=operation, operand=operand) if type(operation) in _OPERATORS:
            return _applied(_OPERATORS[type(operation)], operand)
        case ast.BinOp(left=left, op=operation, right=right) if type(operation) in _OPERATORS:
            return _applied(_OPERATORS[type(operation)], left, right)
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in _FUNCTIONS:
            return _applied(_FUNCTIONS[name], argument)
    raise ProblemError(
        f"expected names, numbers, + - * / ** (power), parentheses, pi and the functions {', '.join(_FUNCTIONS)} of "
        f"one argument; received '{ast.unparse(node)}'. For anything else give a Python function."
    )


def _applied(function: Callable[..., Any], *nodes: ast.expr) -> _Expression:
    arguments = [_read(node) for node in nodes]
    names = frozenset[str]().union(*(one.names for one in arguments))
    return _Expression(names, lambda values: function(*(one.value(values) for one in arguments)))


def check_name(name: Any, kind: str) -> None:
    """Refuse a name that no expression could use."""
    taken = {*_FUNCTIONS, "pi", PREVIOUS}
    usable = isinstance(name, str) and name.isidentifier() and not (keyword.iskeyword(name) or name.startswith("_"))
    # Python normalises names: the micro sign becomes the Greek letter.
    if not usable or name in taken or unicodedata.normalize("NFKC", name) != name:
        raise ProblemError(
            f"Assembly: a {kind} is named like a variable of Python, and not {', '.join(sorted(taken))}; "
            f"received {name!r}."
        )
