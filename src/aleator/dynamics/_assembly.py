"""`Assembly`: a kinematic assembly, described by its vector loops. Its numbers are formulas; angles are in degrees."""

import ast
import keyword
import math
import operator
import unicodedata
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import meant, members, real
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf, transparent
from aleator.dynamics._algebraic import AlgebraicSystem
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
_PREVIOUS = "previous"
"""The word that stands for the direction of the preceding vector."""


class _Expression(NamedTuple):
    """A parsed expression: the names in it, and its value as a function of theirs."""

    names: frozenset[str]
    value: Callable[[Mapping[str, Any]], Any]


def _read_formula(formula: Any, known: Collection[str], where: str) -> Formula:
    """A formula in parsed form, checked to use only `known` names."""
    if callable(formula):
        return formula
    if isinstance(formula, int | float | np.number) and not isinstance(formula, bool) and math.isfinite(formula):
        return float(formula)
    if not isinstance(formula, str):
        raise ProblemError(
            f"{where}: expected a name, a finite number, an expression such as 'e - c', or a function of the named "
            f"values; received {formula!r}. Put uncertain or decided numbers among the dimensions, under a name."
        )
    try:
        names = _expression(formula).names
    except ProblemError as error:
        raise ProblemError(f"{where}: {error}") from error
    for name in sorted(names.difference(known)):
        raise ProblemError(f"{where}: there is no '{name}'; expected one of {sorted(known)}.{meant(name, known)}")
    return formula


def _read_equation(equation: Any, known: Collection[str], where: str) -> tuple[Formula, Formula]:
    """The two sides of an equation `left = right`; for a formula alone, the formula and zero."""
    left, *rest = equation.split("=") if isinstance(equation, str) else (equation,)
    if len(rest) > 1:
        raise ProblemError(f"{where}: expected 'left = right'; received {equation!r}.")
    return _read_formula(left, known, where), _read_formula(rest[0] if rest else 0.0, known, where)


def _evaluate(formula: Formula, values: Mapping[str, Any]) -> Float[Array, ""]:
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


def _check_name(name: Any, kind: str) -> None:
    """Refuse a name that no expression could use."""
    taken = {*_FUNCTIONS, "pi", _PREVIOUS}
    usable = isinstance(name, str) and name.isidentifier() and not (keyword.iskeyword(name) or name.startswith("_"))
    # Python normalises names: the micro sign becomes the Greek letter.
    if not usable or name in taken or unicodedata.normalize("NFKC", name) != name:
        raise ProblemError(
            f"Assembly: a {kind} is named like a variable of Python, and not {', '.join(sorted(taken))}; "
            f"received {name!r}."
        )


class Vector(NamedTuple):
    """A length and its direction in degrees: one angle in the plane, azimuth and elevation in space."""

    length: Formula
    direction: tuple[Formula, ...]


class Chain(NamedTuple):
    """Vectors in a row, each starting at the tip of the one before."""

    vectors: tuple[Vector, ...]

    @property
    def components(self) -> int:
        """3 if any vector has an elevation (space), else 2 (plane)."""
        return 1 + max(len(one.direction) for one in self.vectors)

    @property
    def formulas(self) -> tuple[Formula, ...]:
        """All lengths and directions."""
        return tuple(formula for one in self.vectors for formula in (one.length, *one.direction))

    def resultant(self, values: Mapping[str, Any]) -> Float[Array, " components"]:
        """The sum of the vectors: x, y and, in space, z."""
        total = jnp.zeros(3)
        before: tuple[Any, ...] = ()
        for vector in self.vectors:
            angles = tuple(
                _evaluate(formula, {**values, _PREVIOUS: previous} if before else values)
                for formula, previous in zip((*vector.direction, 0.0)[:2], before or (0.0, 0.0), strict=True)
            )
            azimuth, elevation = map(jnp.deg2rad, angles)
            along = jnp.cos(elevation)
            unit = jnp.stack([along * jnp.cos(azimuth), along * jnp.sin(azimuth), jnp.sin(elevation)])
            total, before = total + _evaluate(vector.length, values) * unit, angles
        return total[: self.components]


def _is_chain(description: Any) -> bool:
    """Whether a description is a list of vectors rather than a formula."""
    return isinstance(description, list | tuple)


def _read_chain(description: Any, known: Collection[str], where: str) -> Chain:
    """A chain from its description `[(length, direction), ...]`."""
    if not _is_chain(description) or len(description) < 2:
        raise ProblemError(
            f"{where}: expected two or more vectors, [(length, direction), ...]; received {description!r}."
        )
    vectors = enumerate(description)
    return Chain(tuple(_read_vector(one, known, f"{where}, vector {i + 1}", i == 0) for i, one in vectors))


def _read_vector(vector: Any, known: Collection[str], where: str, is_first: bool) -> Vector:
    if not (_is_chain(vector) and len(vector) == 2):
        raise ProblemError(f"{where}: expected (length, direction), such as ('a', 90); received {vector!r}.")
    length, direction = vector
    angles = tuple(direction) if _is_chain(direction) else (direction,)
    if len(angles) not in (1, 2):
        raise ProblemError(
            f"{where}: expected a direction in degrees or, in space, (azimuth, elevation); received {direction!r}."
        )
    turning = known if is_first else {*known, _PREVIOUS}
    return Vector(_read_formula(length, known, where), tuple(_read_formula(one, turning, where) for one in angles))


class _Description(NamedTuple):
    """An assembly without its dimensions: the static structure, which determines the compiled program."""

    guesses: tuple[tuple[str, float], ...]
    loops: tuple[Chain, ...]
    equations: tuple[tuple[Formula, Formula], ...]
    features: tuple[tuple[str, Formula | Chain], ...]
    units: tuple[tuple[str, str], ...]


@final
@transparent("dimensions")
class Assembly(AlgebraicSystem):
    """Parts that fit together, described by closed vector loops (dissertation, equations 1, 2 and 121).

        Assembly(
            dimensions={"a": Normal(27.645, 0.0167), "c": Normal(11.43, 0.0033), "e": Normal(50.8, 0.0042)},
            unknowns={"b": 4.8, "chi": 7.0},
            loops=[[("a", 90), ("b", 0), ("c", 90), ("c", "90 - chi"), ("-e", "90 - chi")]],
        )

    - `dimensions`: the independent numbers by name; any may be a distribution or a decision;
    - `unknowns`: the dependent numbers by name, each with a guess near its nominal value;
    - `loops`: closed loops (2), each a list of vectors that add up to zero: two equations in the plane, three in space;
    - `equations`: further relations between angles or lengths, such as `"chi + gamma = 180"`;
    - `features`: quantities of interest besides the unknowns, by name (1): a formula, such as `"housing - 3*plate"` for
      a gap, or an open loop, a list of vectors whose tip has the coordinates x, y and, in space, z;
    - `units`: the units of unknowns and features by name, for reports.

    A vector is `(length, direction)`. Lengths, directions, equations and features are formulas: a number, a name, an
    expression of names (`"e - c"`; + - * / **, parentheses, `pi`, `sqrt`, `sin`, `cos`, `tan`, `asin`, `acos`, `atan`)
    or a Python function of all named values (`lambda v: v.e - v.c`). **All angles are in degrees**, measured from the x
    axis: directions, the dimensions and unknowns used in them, their guesses, and arguments and values of the functions
    above. A direction relative to that of the preceding vector uses the word `previous`: `"previous + 90"`. In space a
    direction is a pair of azimuth and elevation.

    The unknowns and the features are its outputs. Raises `ProblemError` if the description is inconsistent.
    """

    dimensions: dict[str, Any]
    description: _Description = eqx.field(static=True)

    def __init__(
        self,
        dimensions: Mapping[str, Any],
        unknowns: Mapping[str, float] | None = None,
        loops: Sequence[Any] = (),
        equations: Sequence[Any] = (),
        features: Mapping[str, Any] | None = None,
        units: Mapping[str, str] | None = None,
    ):
        unknowns, features, units = unknowns or {}, features or {}, units or {}
        _check_names(dimensions, unknowns, features, units)
        known = (*dimensions, *unknowns)
        self.dimensions = {name: _dimension(name, value) for name, value in dimensions.items()}
        self.description = _Description(
            guesses=tuple(
                (name, real(f"Assembly: the guess of '{name}'", value, "a finite number near its nominal value"))
                for name, value in unknowns.items()
            ),
            loops=tuple(
                _read_chain(loop, known, f"Assembly, loop {i + 1}")
                for i, loop in enumerate(members("Assembly: loops", loops, object))
            ),
            equations=tuple(
                _read_equation(one, known, f"Assembly, equation {i + 1}")
                for i, one in enumerate(members("Assembly: equations", equations, object))
            ),
            features=tuple(
                (name, (_read_chain if _is_chain(part) else _read_formula)(part, known, f"Assembly, feature '{name}'"))
                for name, part in features.items()
            ),
            units=tuple(units.items()),
        )
        _check_equations(self.description)

    @property
    def unknowns(self) -> tuple[str, ...]:  # type: ignore[override]
        """The names of the dependent numbers."""
        return tuple(name for name, _ in self.description.guesses)

    @property
    def units(self) -> dict[str, str]:  # type: ignore[override]
        """The units of outputs, as far as they are given."""
        return dict(self.description.units)

    @override
    def guess(self) -> dict[str, float]:
        return dict(self.description.guesses)

    def residual(self, rho: Any) -> list[Float[Array, "..."]]:
        """The resultant of each closed loop, then the residual of each further equation."""
        values = self._values(rho)
        closed = [loop.resultant(values) for loop in self.description.loops]
        return closed + [
            _evaluate(left, values) - _evaluate(right, values) for left, right in self.description.equations
        ]

    def outputs(self, rho: Any) -> dict[str, Float[Array, "..."]]:
        """The unknowns and the features."""
        values = self._values(rho)
        features = {
            name: one.resultant(values) if isinstance(one, Chain) else _evaluate(one, values)
            for name, one in self.description.features
        }
        return rho._asdict() | features

    def _values(self, rho: Any) -> dict[str, Any]:
        for name, value in self.dimensions.items():
            if jnp.shape(value) != ():
                raise ProblemError(f"Assembly: dimension '{name}' is one number; received shape {jnp.shape(value)}.")
        return self.dimensions | rho._asdict()


def _check_names(
    dimensions: Mapping[str, Any], unknowns: Mapping[str, Any], features: Mapping[str, Any], units: Mapping[str, str]
) -> None:
    seen: dict[str, str] = {}
    by_name = {"dimension": dimensions, "unknown": unknowns, "feature": features}
    for kind, named in {**by_name, "unit": units}.items():
        if not isinstance(named, Mapping):
            raise ProblemError(f"Assembly: expected each {kind} by name, in a dict; received {named!r}.")
    for kind, named in by_name.items():
        for name in named:
            _check_name(name, kind)
            if name in seen:
                raise ProblemError(f"Assembly: '{name}' names a {seen[name]} and a {kind}. Rename one of them.")
            seen[name] = kind
    stray = sorted(set(units) - set(unknowns) - set(features))
    if stray:
        raise ProblemError(f"Assembly: units are given for {stray}, which are not unknowns or features.")


def _dimension(name: str, value: Any) -> Any:
    """A number as a float, so that changing it causes no recompilation; distributions and decisions unchanged."""
    if isinstance(value, AbstractLeaf | jax.Array):
        return value
    return real(f"Assembly: dimension '{name}'", value, "a finite number, a distribution or a decision")


def _check_equations(description: _Description) -> None:
    """Refuse a wrong number of equations, and unknowns that no equation contains."""
    unknowns = [name for name, _ in description.guesses]
    closed = sum(loop.components for loop in description.loops)
    if closed + len(description.equations) != len(unknowns):
        raise ProblemError(
            f"Assembly: expected as many equations as unknowns, {len(unknowns)} for {unknowns}; received "
            f"{closed + len(description.equations)}: {closed} from {len(description.loops)} closed loops (two from a "
            f"plane loop, three from a spatial one) and {len(description.equations)} others. Add the missing "
            "equations, or turn unknowns into dimensions or dimensions into unknowns."
        )
    formulas = [formula for loop in description.loops for formula in loop.formulas]
    formulas += [side for equation in description.equations for side in equation]
    if any(callable(formula) for formula in formulas):
        return  # the names that a function uses are not known
    used = frozenset[str]().union(*(_expression(formula).names for formula in formulas if isinstance(formula, str)))
    for name in unknowns:
        if name not in used:
            raise ProblemError(f"Assembly: unknown '{name}' is in no loop and no equation. Drop it, or use it.")
