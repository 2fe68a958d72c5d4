"""Expressions: sums and multiples of statistics, of the model's own numbers and of cost curves.

An expression is data: it can be evaluated on any source of statistics (an expansion, a Monte Carlo sample),
differentiated, swept and printed as mathematics.
"""

import abc
from typing import TYPE_CHECKING, Any, Self, final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Scalar
from aleator._core.errors import ProblemError
from aleator.design._functional import Functional

if TYPE_CHECKING:
    from aleator.design._constraint import Constraint

SYMBOLS = {"mean": "μ", "std": "σ", "variance": "Var"}


class AbstractScope(abc.ABC):
    """Where an expression takes its numbers from."""

    @abc.abstractmethod
    def statistic(self, functional: Functional, kind: str) -> Float[Array, "..."]:
        """A statistic (`mean`, `std` or `variance`) of a functional."""

    @abc.abstractmethod
    def value(self, name: str) -> Float[Array, ""]:
        """A number of the model itself, by name."""


class AbstractAtom(eqx.Module):
    """A term of an expression that is no sum or multiple of others."""

    @abc.abstractmethod
    def evaluate(self, scope: AbstractScope) -> Float[Array, "..."]:
        """The term's value."""

    @abc.abstractmethod
    def text(self) -> str:
        """The term as mathematics."""


@final
class Statistic(AbstractAtom):
    """A statistic of a functional."""

    functional: Functional
    kind: str = eqx.field(static=True)

    def evaluate(self, scope: AbstractScope) -> Array:
        """See `AbstractAtom.evaluate`."""
        return scope.statistic(self.functional, self.kind)

    def text(self) -> str:
        """See `AbstractAtom.text`."""
        return f"{SYMBOLS[self.kind]}[{self.functional.text()}]"


@final
class Value(AbstractAtom):
    """A number of the model itself: a decision, a plain number, or a parameter of a distribution."""

    name: str = eqx.field(static=True)

    def evaluate(self, scope: AbstractScope) -> Array:
        """See `AbstractAtom.evaluate`."""
        return scope.value(self.name)

    def text(self) -> str:
        """See `AbstractAtom.text`."""
        return self.name


@final
class Expression(eqx.Module):
    """`constant + sum of factor * atom`. The factors are data: changing them compiles nothing anew."""

    factors: tuple[Scalar, ...]
    atoms: tuple[AbstractAtom, ...]
    constant: Scalar = 0.0

    def evaluate(self, scope: AbstractScope) -> Float[Array, "..."]:
        """The value in a scope: a number, or one number an instant if a `path` stands in it."""
        terms = (factor * atom.evaluate(scope) for factor, atom in zip(self.factors, self.atoms, strict=True))
        return sum(terms, self.constant)  # type: ignore[return-value]

    def __add__(self, other: Any) -> "Expression":
        other = as_expression(other)
        return Expression(self.factors + other.factors, self.atoms + other.atoms, self.constant + other.constant)

    __radd__ = __add__

    def __mul__(self, number: Any) -> "Expression":
        number = _number(number, "multiply an expression by")
        return Expression(tuple(number * factor for factor in self.factors), self.atoms, number * self.constant)

    __rmul__ = __mul__

    def __truediv__(self, number: Any) -> "Expression":
        return self * (1 / _number(number, "divide an expression by"))

    def __neg__(self) -> "Expression":
        return self * -1.0

    def __sub__(self, other: Any) -> "Expression":
        return self + -as_expression(other)

    def __rsub__(self, other: Any) -> "Expression":
        return as_expression(other) + -self

    def __le__(self, other: Any) -> "Constraint":
        return _compare(self - other, upper=True)

    def __ge__(self, other: Any) -> "Constraint":
        return _compare(self - other, upper=False)

    def equals(self, number: float) -> "Constraint":
        """The constraint that the expression equals a number."""
        from aleator.design._constraint import Constraint  # the two classes refer to each other

        return Constraint(self, lower=number, upper=number)

    def __bool__(self) -> bool:
        raise ProblemError(
            "An expression has no truth value: a chain such as 'lower <= y <= upper' does not work in Python. "
            "Write two comparisons, or use .within(lower, upper)."
        )

    @property
    def sigmas(self) -> float | None:
        """The largest multiple of a standard deviation in it; None if there is none."""
        multiples = [abs(float(factor)) for factor, atom in self._terms() if _is_std(atom)]
        return max(multiples) if multiples else None

    def with_sigmas(self, sigmas: float) -> Self:
        """The same expression, its largest multiple of a standard deviation at `sigmas`, the others in proportion."""
        largest = self.sigmas
        if not largest:
            raise ProblemError(f"There is no standard deviation to scale in '{self}'.")
        ratio = sigmas / largest
        factors = tuple(factor * ratio if _is_std(atom) else factor for factor, atom in self._terms())
        return eqx.tree_at(lambda tree: tree.factors, self, factors)

    def _terms(self) -> zip:
        return zip(self.factors, self.atoms, strict=True)

    def __str__(self) -> str:
        parts = [(float(factor), atom.text()) for factor, atom in self._terms() if float(factor) != 0]
        if float(self.constant) != 0 or not parts:
            parts.append((float(self.constant), ""))
        text = " ".join(f"{'−' if factor < 0 else '+'} {_product(abs(factor), atom)}" for factor, atom in parts)
        return text.removeprefix("+ ").replace("− ", "−", 1) if text.startswith("−") else text.removeprefix("+ ")


def _is_std(atom: AbstractAtom) -> bool:
    return isinstance(atom, Statistic) and atom.kind == "std"


def _product(factor: float, atom: str) -> str:
    if not atom:
        return f"{factor:g}"
    return atom if factor == 1 else f"{factor:g} {atom}"


def _number(value: Any, action: str) -> float:
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return float(value)
    raise ProblemError(f"Only numbers can {action}; received {type(value).__name__} '{value}'.")


def as_expression(value: Any) -> Expression:
    """An expression as it is, a number as a constant. Raises `ProblemError` for anything else."""
    if isinstance(value, Expression):
        return value
    if isinstance(value, Functional):
        raise ProblemError(
            f"'{value.text()}' differs from one realisation to the next: name a statistic of it, "
            ".mean, .std or .variance, or use .at_most(...)."
        )
    return Expression((), (), _number(value, "be added to or compared with an expression:"))


def _compare(difference: Expression, *, upper: bool) -> "Constraint":
    """`difference <= 0` (or `>= 0`), with its constant brought to the right as the bound."""
    from aleator.design._constraint import Constraint  # the two classes refer to each other

    bound = -difference.constant + 0.0
    left = Expression(difference.factors, difference.atoms)
    return Constraint(left, upper=bound) if upper else Constraint(left, lower=bound)


def statistic(functional: Functional, kind: str) -> Expression:
    """A statistic of a functional as an expression."""
    return Expression((1.0,), (Statistic(functional, kind),))


def value(name: str) -> Expression:
    """A number of the model: a decision or plain number (`"k_s"`), or part of a distribution (`"k_s.half_width"`)."""
    return Expression((1.0,), (Value(name),))


def functionals_of(expressions: tuple[Expression, ...]) -> tuple[Functional, ...]:
    """All functionals that stand in some expressions, each once, in order of appearance."""
    atoms = (atom for expression in expressions for atom in expression.atoms)
    return tuple(dict.fromkeys(atom.functional for atom in atoms if isinstance(atom, Statistic)))
