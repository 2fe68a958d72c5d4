"""Expressions of statistics and numbers, and the constraints made by comparing them.

All of it is data: an expression can be evaluated on any source of statistics (an expansion, a Monte Carlo sample),
differentiated, swept and printed as mathematics. The two classes refer to each other, hence one module.
"""

from typing import Any, ClassVar, NamedTuple, Self, final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Scalar, alike, in_library, quietly
from aleator._core.border import a_name, real
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.design._rules import AbstractRule, Norm, Power, Product
from aleator.design._scope import (
    AbstractAtom,
    AbstractComposite,
    AbstractRandom,
    AbstractScope,
    Units,
    Value,
    ordered,
)
from aleator.statistics import common


@final
class Expression(Module):
    """`constant + sum of factor * atom`. The factors are data: changing them causes no recompilation.

    Expressions may be added, multiplied, divided and raised to powers.
    """

    # Makes NumPy defer to this class in products with its own numbers.
    __array_ufunc__: ClassVar[None] = None

    factors: tuple[Scalar, ...]
    atoms: tuple[AbstractAtom, ...]
    constant: Scalar = 0.0

    @quietly
    def evaluate(self, scope: AbstractScope) -> Float[Any, "..."]:
        """The value in a scope: a number, or one number per instant if it contains a `path`."""
        values = [atom.evaluate(scope) for atom in self.atoms]
        _, factors, known, constant = in_library(self.factors, values, self.constant)
        return alike(sum((one * value for one, value in zip(factors, known, strict=True)), start=constant), values)

    def unit(self, units: Units) -> str:
        """The common unit of its terms; empty where they differ or one is unknown."""
        return common(atom.unit(units) for factor, atom in self._terms() if float(factor) != 0)

    def __add__(self, other: Any) -> "Expression":
        other = as_expression(other)
        return Expression(self.factors + other.factors, self.atoms + other.atoms, self.constant + other.constant)

    __radd__ = __add__

    def __mul__(self, other: Any) -> "Expression":
        if isinstance(other, Expression) and other.atoms:
            return composed(Product(), self, other) if self.atoms else other * self.constant
        number = real(f"'{self}' times", _plain(other))
        return Expression(tuple(number * factor for factor in self.factors), self.atoms, number * self.constant)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> "Expression":
        if isinstance(other, Expression) and other.atoms:
            return composed(Product(divides=True), self, other)
        number = real(f"'{self}' divided by", _plain(other))
        if number == 0:
            raise ProblemError(f"'{self}' cannot be divided by zero; received {number}.")
        return self * (1 / number)

    def __rtruediv__(self, other: Any) -> "Expression":
        return as_expression(other) / self

    def __pow__(self, exponent: Any) -> "Expression":
        return composed(Power(real(f"'{self}': an exponent", exponent)), self)

    def __abs__(self) -> "Expression":
        return composed(Norm(), self)

    def __neg__(self) -> "Expression":
        return self * -1.0

    def __sub__(self, other: Any) -> "Expression":
        return self + -as_expression(other)

    def __rsub__(self, other: Any) -> "Expression":
        return as_expression(other) + -self

    def __le__(self, other: Any) -> "Constraint":
        return _compare(self - other, "upper")

    def __ge__(self, other: Any) -> "Constraint":
        return _compare(self - other, "lower")

    def __lt__(self, other: Any) -> "Constraint":
        raise ProblemError(
            f"Bounds include their value: write <= or >= with '{self}', not < or >. The larger and the smaller of two "
            "are al.expressions.maximum and minimum."
        )

    __gt__ = __lt__

    def _no_number(self, *_: Any) -> Any:
        raise ProblemError(
            f"'{self}' has no value yet: it can be added, multiplied, divided and raised to a number. Any other "
            "function of it is al.expressions.function(jnp.sqrt, x), by a function of jax.numpy."
        )

    __float__ = __int__ = __round__ = __mod__ = __rmod__ = __floordiv__ = __rfloordiv__ = __rpow__ = _no_number

    def equals(self, other: "float | Expression") -> "Constraint":
        """The constraint that the expression equals a number, or another expression."""
        if isinstance(other, Expression):
            return _compare(self - other, "lower", "upper")
        return Constraint(self, lower=other, upper=other)

    def __bool__(self) -> bool:
        raise ProblemError(
            "An expression has no truth value: a chain such as 'lower <= y <= upper' does not work in Python. "
            "Write two comparisons, or use .within(lower, upper)."
        )

    @property
    def leaves(self) -> tuple[AbstractAtom, ...]:
        """All statistics and values in it, including those inside norms and integrals."""
        return tuple(part for atom in self.atoms for part in atom.parts)

    @property
    def is_path(self) -> bool:
        """Whether it is one number per instant instead of one number."""
        return any(atom.is_path for atom in self.atoms)

    @property
    def sigmas(self) -> float | None:
        """The largest multiple of a standard deviation in it; None if there is none."""
        multiples = [abs(float(factor)) for factor, atom in self._terms() if atom.is_spread]
        return max(multiples) if multiples else None

    def with_sigmas(self, sigmas: float) -> Self:
        """The expression with its largest multiple of a standard deviation set to `sigmas`, others in proportion."""
        largest = self.sigmas
        if not largest:
            raise ProblemError(f"There is no standard deviation to scale in '{self}'.")
        ratio = sigmas / largest
        factors = tuple(factor * ratio if atom.is_spread else factor for factor, atom in self._terms())
        return eqx.tree_at(lambda tree: tree.factors, self, factors)

    def _terms(self) -> zip:
        return zip(self.factors, self.atoms, strict=True)

    def __repr__(self) -> str:
        return f"Expression({self})"

    def __str__(self) -> str:
        parts = [(float(factor), atom.text()) for factor, atom in self._terms() if float(factor) != 0]
        if float(self.constant) != 0 or not parts:
            parts.append((float(self.constant), ""))
        text = " ".join(f"{'−' if factor < 0 else '+'} {_product(abs(factor), atom)}" for factor, atom in parts)
        return text.removeprefix("+ ").replace("− ", "−", 1) if text.startswith("−") else text.removeprefix("+ ")


@final
class Composed(AbstractComposite):
    """A function of the values of expressions."""

    rule: AbstractRule
    expressions: tuple[Expression, ...]

    @override
    @quietly
    def evaluate(self, scope: AbstractScope) -> Array:
        values = [one.evaluate(scope) for one in self.expressions]
        return alike(self.rule.of(*in_library(*values)[1:]), values)

    @override
    def text(self) -> str:
        return self.rule.text(*map(str, self.expressions))

    @override
    def unit(self, units: Units) -> str:
        return self.rule.unit(*(one.unit(units) if one.atoms else None for one in self.expressions))

    @property
    @override
    def inner(self) -> tuple[Expression, ...]:
        return self.expressions

    @property
    @override
    def is_path(self) -> bool:
        return any(one.is_path for one in self.expressions)


def composed(rule: AbstractRule, *expressions: Any) -> Expression:
    """A function of expressions as an expression. Raises `ProblemError` for what is none."""
    return Expression((1.0,), (Composed(rule, tuple(map(as_expression, expressions))),))


@final
class Constraint(Module):
    """`lower <= expression <= upper`, at every instant if the expression contains a `path`.

    Constraints with the same `name` belong together: a sweep moves their bounds together, and evidence counts a system
    that violates any of them once. The bounds are data: changing them causes no recompilation. `declared`: the limit
    that it stands for in a search, None for itself.

    Raises `ProblemError` for bounds in the wrong order or NaN.
    """

    expression: Expression
    lower: Scalar
    upper: Scalar
    name: str = eqx.field(static=True)
    has_own_name: bool = eqx.field(static=True)
    declared: "Constraint | None"

    def __init__(
        self,
        expression: Expression,
        *,
        lower: Scalar = -np.inf,
        upper: Scalar = np.inf,
        name: str | None = None,
    ):
        self.expression, self.declared = as_expression(expression), None
        self.name = self.subject if name is None else a_name("Constraint: name", name)
        self.has_own_name = name is not None
        self.lower, self.upper = ordered(self.name, lower, upper)
        if not np.isfinite(self.lower) and not np.isfinite(self.upper):
            raise ProblemError(
                f"Constraint '{self.name}' bounds nothing: expected a finite bound; received {self.lower} and "
                f"{self.upper}."
            )

    @property
    def subject(self) -> str:
        """The outputs (or numbers) in it: its name by default."""
        return ", ".join(dict.fromkeys(name for one in self.expression.atoms for name in one.subjects)) or "constant"

    @property
    def measure(self) -> str:
        """The functionals in it, which distinguish constraints on the same output."""
        return ", ".join(dict.fromkeys(text for one in self.expression.atoms for text in one.measures))

    def named(self, name: str) -> "Constraint":
        """The same constraint with another name."""
        return Constraint(self.expression, lower=self.lower, upper=self.upper, name=a_name("Constraint: name", name))

    def instead_of(self, declared: "Constraint") -> "Constraint":
        """The same constraint, which stands for another one in a search, under the name of that."""
        own = self.named(declared.name)
        object.__setattr__(own, "declared", declared)
        return own

    def with_bounds(self, lower: float, upper: float) -> Self:
        """The same constraint with other bounds. Raises `ProblemError` if they are in the wrong order."""
        return eqx.tree_at(lambda tree: (tree.lower, tree.upper), self, ordered(self.name, lower, upper))

    @property
    def is_path(self) -> bool:
        """Whether it holds at every instant."""
        return self.expression.is_path

    def __bool__(self) -> bool:
        raise ProblemError(
            "A constraint has no truth value: a chain such as 'lower <= y <= upper' does not work in Python and would "
            "lose its first half. Write two comparisons, or use .within(lower, upper)."
        )

    def __str__(self) -> str:
        lower, upper = float(self.lower), float(self.upper)
        if lower == upper:
            relation = f"{self.expression} = {upper:g}"
        else:
            below = f"{lower:g} ≤ " if np.isfinite(lower) and np.isfinite(upper) else ""
            above = f" ≤ {upper:g}" if np.isfinite(upper) else f" ≥ {lower:g}"
            relation = f"{below}{self.expression}{above}"
        return f"{relation} for all t" if self.is_path else relation


class Range(NamedTuple):
    """The two constraints of one range, which belong together."""

    at_most: Constraint
    at_least: Constraint

    def named(self, name: str) -> "Range":
        """The same range with another name."""
        return Range(self.at_most.named(name), self.at_least.named(name))

    def __str__(self) -> str:
        return f"{self.at_least} and {self.at_most}"


def _product(factor: float, atom: str) -> str:
    if not atom:
        return f"{factor:g}"
    return atom if factor == 1 else f"{factor:g} {atom}"


def as_expression(value: Any) -> Expression:
    """An expression unchanged, or a number as a constant. Raises `ProblemError` for anything else."""
    if isinstance(value, Expression):
        return value
    if isinstance(value, AbstractRandom):
        return value.refuse()
    return Expression((), (), real("in a sum or comparison with an expression", value))


def _plain(value: Any) -> Any:
    """The number of an expression without statistics; anything else unchanged. Refuses what has no statistic yet."""
    if isinstance(value, AbstractRandom):
        return value.refuse()
    return value.constant if isinstance(value, Expression) and not value.atoms else value


def _compare(difference: Expression, *sides: str) -> "Constraint":
    """`difference <= 0` ("upper"), `>= 0` ("lower") or both, with its constant as the bound on the right-hand side."""
    left, bound = Expression(difference.factors, difference.atoms), -difference.constant + 0.0
    bounds: dict[str, Any] = dict.fromkeys(sides, bound)
    return Constraint(left, **bounds)


def value(name: str) -> Expression:
    """A number of the model: a decision or plain number (`"k_s"`), or part of a distribution (`"k_s.half_width"`)."""
    return Expression((1.0,), (Value(a_name("value", name)),))
