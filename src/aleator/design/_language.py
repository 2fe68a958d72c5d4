"""The problem language: functionals have statistics, these make expressions, and comparing them makes constraints.

All of it is data: an expression can be evaluated on any source of statistics (an expansion, a Monte Carlo sample),
differentiated, swept and printed as mathematics. The three refer to each other and therefore live together.
"""

import abc
from typing import Any, Self, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Scalar
from aleator._core.errors import ProblemError
from aleator.design._scope import AbstractAtom, AbstractScope, Value
from aleator.dynamics import Grid, History

SYMBOLS = {"mean": "μ", "std": "σ", "variance": "Var"}


class AbstractFunctional(eqx.Module):
    """A quantity of one output, taken on each realisation of the system. Made by `integral`, `rms`, `terminal`, ...

    `mean`, `std` and `variance` are its statistics over the uncertainty, to be added, multiplied by numbers and
    compared with bounds; `at_most`, `at_least` and `within` bound `mean +- sigmas * std`.
    """

    output: str = eqx.field(static=True)

    @abc.abstractmethod
    def evaluate(self, history: History, grid: Grid) -> Float[Array, "..."]:
        """The quantity on one realisation's history: a number, or for `path` one number an instant."""

    @abc.abstractmethod
    def text(self) -> str:
        """The quantity as mathematics."""

    @property
    def is_path(self) -> bool:
        """Whether it is one number an instant instead of one number."""
        return False

    @property
    def mean(self) -> "Expression":
        """The expected value, equation (98)."""
        return statistic(self, "mean")

    @property
    def std(self) -> "Expression":
        """The standard deviation, equation (99)."""
        return statistic(self, "std")

    @property
    def variance(self) -> "Expression":
        """The variance, equation (97)."""
        return statistic(self, "variance")

    def at_most(self, upper: float, *, sigmas: float = 0.0) -> "Constraint":
        """`mean + sigmas * std <= upper`."""
        return (self.mean + _margin(self, sigmas) * self.std) <= upper

    def at_least(self, lower: float, *, sigmas: float = 0.0) -> "Constraint":
        """`mean - sigmas * std >= lower`."""
        return (self.mean - _margin(self, sigmas) * self.std) >= lower

    def within(self, lower: float, upper: float, *, sigmas: float = 0.0) -> "tuple[Constraint, Constraint]":
        """Both `mean + sigmas * std <= upper` and `mean - sigmas * std >= lower`, under one name.

        Raises `ProblemError` for bounds in the wrong order.
        """
        lower, upper = ordered(self.output, lower, upper)
        return self.at_most(upper, sigmas=sigmas), self.at_least(lower, sigmas=sigmas)

    def _refuse(self, other: Any = None) -> Any:
        """What a functional answers to arithmetic and comparisons: it differs from one realisation to the next."""
        del other
        raise ProblemError(
            f"'{self.text()}' differs from one realisation to the next: name a statistic of it, "
            ".mean, .std or .variance, or use .at_most(...)."
        )

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __neg__ = _refuse
    __lt__ = __le__ = __gt__ = __ge__ = _refuse


@final
class Statistic(AbstractAtom):
    """A statistic of a functional."""

    functional: AbstractFunctional
    kind: str = eqx.field(static=True)

    def evaluate(self, scope: AbstractScope) -> Array:
        """See `AbstractAtom.evaluate`."""
        return scope.statistic(self.functional, self.kind)

    def text(self) -> str:
        """See `AbstractAtom.text`."""
        return f"{SYMBOLS[self.kind]}[{self.functional.text()}]"


@final
class Expression(eqx.Module):
    """`constant + sum of factor * atom`. The factors are data: changing them compiles nothing anew."""

    factors: tuple[Scalar, ...]
    atoms: tuple[AbstractAtom, ...]
    constant: Scalar = 0.0

    def evaluate(self, scope: AbstractScope) -> Float[Array, "..."]:
        """The value in a scope: a number, or one number an instant if a `path` stands in it."""
        terms = (factor * atom.evaluate(scope) for factor, atom in zip(self.factors, self.atoms, strict=True))
        return jnp.asarray(sum(terms, start=self.constant))

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

    def __lt__(self, other: Any) -> "Constraint":
        raise ProblemError(f"A bound holds up to and including its value: write <= or >= with '{self}', not < or >.")

    __gt__ = __lt__

    def __pow__(self, other: Any) -> "Expression":
        raise ProblemError(
            f"Expressions are sums and multiples; '{self}' has no power. Make it an output or a cost curve."
        )

    def equals(self, number: float) -> "Constraint":
        """The constraint that the expression equals a number."""
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


@final
class Constraint(eqx.Module):
    """`lower <= expression <= upper`, at every instant if a `path` stands in the expression.

    Constraints of one `name` belong together: a sweep moves their bounds together, evidence counts a system that
    violates any of them once. The bounds are data: changing them compiles nothing anew.

    Raises `ProblemError` for bounds in the wrong order or not a number.
    """

    expression: Expression
    lower: Scalar
    upper: Scalar
    name: str = eqx.field(static=True)
    has_own_name: bool = eqx.field(static=True)

    def __init__(
        self,
        expression: Expression,
        *,
        lower: Scalar = -np.inf,
        upper: Scalar = np.inf,
        name: str | None = None,
    ):
        self.expression = as_expression(expression)
        self.name = name or self.subject
        self.has_own_name = name is not None
        self.lower, self.upper = ordered(self.name, lower, upper)
        if np.isinf(self.lower) and np.isinf(self.upper):
            raise ProblemError(f"Constraint '{self.name}' bounds nothing; expected a finite bound.")

    @property
    def subject(self) -> str:
        """The outputs (or numbers) that it speaks of: its name, unless it was given one."""
        return ", ".join(dict.fromkeys(_subjects(self.expression))) or "constant"

    @property
    def measure(self) -> str:
        """The functionals that it speaks of: tells constraints on one output apart."""
        atoms = self.expression.atoms
        return ", ".join(dict.fromkeys(one.functional.text() for one in atoms if isinstance(one, Statistic)))

    def named(self, name: str) -> "Constraint":
        """The same constraint under a name of your own."""
        if not isinstance(name, str) or not name:
            raise ProblemError(f"A constraint's name is a text; received {name!r}.")
        return Constraint(self.expression, lower=self.lower, upper=self.upper, name=name)

    def with_bounds(self, lower: float, upper: float) -> Self:
        """The same constraint between other bounds. Raises `ProblemError` if they are in the wrong order."""
        return eqx.tree_at(lambda tree: (tree.lower, tree.upper), self, ordered(self.name, lower, upper))

    @property
    def is_path(self) -> bool:
        """Whether it holds at every instant."""
        return any(isinstance(atom, Statistic) and atom.functional.is_path for atom in self.expression.atoms)

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


def ordered(name: str, lower: Scalar, upper: Scalar) -> tuple[float, float]:
    """The bounds as floats. Raises `ProblemError` if they are in the wrong order or not a number."""
    lower, upper = float(lower), float(upper)
    if np.isnan(lower) or np.isnan(upper):
        raise ProblemError(f"Constraint '{name}': expected numbers as bounds; received lower={lower}, upper={upper}.")
    if lower > upper:
        raise ProblemError(
            f"Constraint '{name}': expected lower <= upper; received lower={lower:g}, upper={upper:g}. Swap them."
        )
    return lower, upper


def _subjects(expression: "Expression") -> list[str]:
    atoms = expression.atoms
    return [one.functional.output if isinstance(one, Statistic) else getattr(one, "name", "") for one in atoms]


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
    if isinstance(value, AbstractFunctional):
        return value + 0  # refused, in the functional's own words
    return Expression((), (), _number(value, "be added to or compared with an expression"))


def _compare(difference: Expression, *, upper: bool) -> "Constraint":
    """`difference <= 0` (or `>= 0`), with its constant brought to the right as the bound."""
    bound = -difference.constant + 0.0
    left = Expression(difference.factors, difference.atoms)
    return Constraint(left, upper=bound) if upper else Constraint(left, lower=bound)


def _margin(functional: AbstractFunctional, sigmas: Any) -> float:
    number = _number(sigmas, "multiply a standard deviation")
    if not (np.isfinite(number) and number >= 0):
        raise ProblemError(f"'{functional.text()}': sigmas must be finite and not negative; received {sigmas}.")
    return number


def statistic(functional: AbstractFunctional, kind: str) -> Expression:
    """A statistic of a functional as an expression."""
    return Expression((1.0,), (Statistic(functional, kind),))


def value(name: str) -> Expression:
    """A number of the model: a decision or plain number (`"k_s"`), or part of a distribution (`"k_s.half_width"`)."""
    return Expression((1.0,), (Value(name),))


def functionals_of(expressions: tuple[Expression, ...]) -> tuple[AbstractFunctional, ...]:
    """All functionals that stand in some expressions, each once, in order of appearance."""
    atoms = (atom for expression in expressions for atom in expression.atoms)
    return tuple(dict.fromkeys(atom.functional for atom in atoms if isinstance(atom, Statistic)))
