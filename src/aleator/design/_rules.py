"""Functions of the values of expressions: products, quotients, powers, norms, maxima, and a user's own."""

import abc
import itertools
import re
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library
from aleator._core.border import traceable
from aleator._core.compilation import Use, evaluate
from aleator._core.errors import ProblemError
from aleator._core.functions import OwnFunction
from aleator._core.leaves import Module, is_traced
from aleator.statistics import EXPONENTS, PURE, common, product, quotient, raised, root

# A name or number without an exponent, or a statistic of one.
_ELEMENTARY = re.compile(r"[\w.]*[^\W²³¹⁰⁴-⁹](\[[^\[\]]*\])?")


class AbstractRule(Module):
    """A function of the values of some expressions, of which each is one number, or one an instant.

    - `is_never_negative`: whether its value is never negative, whatever the expressions are.
    """

    is_never_negative: ClassVar[bool] = False

    @abc.abstractmethod
    def of(self, *values: Float[Array, "..."]) -> Float[Array, "..."]:
        """The function's value."""

    @abc.abstractmethod
    def text(self, *texts: str) -> str:
        """The function as mathematics; a text that is a sum stands in no brackets yet."""

    def unit(self, *units: str | None) -> str:
        """Its unit, from those of the expressions, None for plain numbers; empty where it is unknown, as by default."""
        del units
        return ""


@final
class Product(AbstractRule):
    """The product of two expressions, or their quotient; not finite where a divisor is zero, which `solve` reports."""

    divides: bool = eqx.field(static=True, default=False)

    @override
    def of(self, *values: Array) -> Array:
        first, second = values
        return first / second if self.divides else first * second

    @override
    def text(self, *texts: str) -> str:
        first, second = texts
        return _bracketed(first) + (f"/{_alone(second)}" if self.divides else f"·{_bracketed(second, also=' ')}")

    @override
    def unit(self, *units: str | None) -> str:
        return (quotient if self.divides else product)(*map(_of_factor, units))


@final
class Power(AbstractRule):
    """A power of an expression; with an exponent that is no whole number, of one that is never negative."""

    exponent: float = eqx.field(static=True)

    @property
    def is_never_negative(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.exponent % 2 == 0

    @override
    def of(self, *values: Array) -> Array:
        (base,) = values
        whole = int(self.exponent)
        return base**whole if whole == self.exponent else base**self.exponent

    @override
    def text(self, *texts: str) -> str:
        (base,) = texts
        shown = f"{self.exponent:g}"
        above = shown.translate(EXPONENTS) if shown.removeprefix("-").isdigit() else f"^{shown}"
        return f"{_alone(base)}{above}"

    @override
    def unit(self, *units: str | None) -> str:
        return raised(_of_factor(units[0]), self.exponent)


@final
class Pure(AbstractRule):
    """An expression whose unit is left to the factor before it, so that it can stand in a sum with any other."""

    @override
    def of(self, *values: Array) -> Array:
        (value,) = values
        return value

    @override
    def text(self, *texts: str) -> str:
        (text,) = texts
        return _bracketed(text)


class AbstractRounded(AbstractRule):
    """A rule with a kink, which a `smoothing` above zero rounds. Its expressions have one unit, which is its own."""

    smoothing: eqx.AbstractVar[float]

    @abc.abstractmethod
    def sharp(self, *texts: str) -> str:
        """The rule as mathematics, without smoothing."""

    @override
    def text(self, *texts: str) -> str:
        rounded = f" (smoothed by {self.smoothing:g})" if self.smoothing else ""
        return f"{self.sharp(*texts)}{rounded}"

    @override
    def unit(self, *units: str | None) -> str:
        """That of all; plain numbers are in the unit of the others."""
        return common(unit for unit in units if unit is not None)


@final
class Norm(AbstractRounded):
    """The Euclidean norm, with derivative zero where all expressions are zero.

    With a `smoothing` `s`, it is `sqrt(x² + y² + … + s²) - s`: smooth, and at most `s` below the norm.
    """

    is_never_negative = True
    smoothing: float = eqx.field(static=True, default=0.0)

    @override
    def of(self, *values: Array) -> Array:
        first, *others = (one**2 for one in values)
        _, size = in_library(root(sum(others, start=first + self.smoothing**2)))
        return size - self.smoothing

    @override
    def sharp(self, *texts: str) -> str:
        return f"‖{', '.join(texts)}‖"


@final
class Extremum(AbstractRounded):
    """The largest of several expressions (`side = 1`), or the smallest (-1).

    With a `smoothing` `s`, the largest is `s log(exp(x/s) + exp(y/s) + …)`: smooth, and at most `s log n` above that of
    `n`.
    """

    side: int = eqx.field(static=True)
    smoothing: float = eqx.field(static=True, default=0.0)

    @override
    def of(self, *values: Array) -> Array:
        library, values = in_library(values)
        every = self.side * library.stack(library.broadcast_arrays(*values))
        if not self.smoothing:
            return self.side * every.max(axis=0)
        sums = scipy.special.logsumexp if library is np else jax.nn.logsumexp
        return self.side * self.smoothing * sums(every / self.smoothing, axis=0)

    @override
    def sharp(self, *texts: str) -> str:
        return f"{'max' if self.side > 0 else 'min'}({', '.join(texts)})"


@final
class PositivePart(AbstractRounded):
    """An expression where it is positive, else zero.

    With a `smoothing` `s`, it is `(x + sqrt(x² + s²)) / 2`: smooth, positive, and at most `s/2` above.
    """

    is_never_negative = True
    smoothing: float = eqx.field(static=True, default=0.0)

    @override
    def of(self, *values: Array) -> Array:
        library, one = in_library(*values)
        if not self.smoothing:
            return library.maximum(one, 0.0)
        _, size = in_library(root(one**2 + self.smoothing**2))
        return (one + size) / 2

    @override
    def sharp(self, *texts: str) -> str:
        return f"max({texts[0]}, 0)"


@final
class Own(AbstractRule):
    """A user's own function of numbers, in JAX.

    It is traced for one instant: a function of several instants would change with the grid.
    """

    function: OwnFunction = eqx.field(static=True)

    def __init__(self, function: Callable[..., Any], count: int):
        who = f"The function '{_name(function)}'"
        self.function = OwnFunction(who, partial(_number, who, function), (0.0,) * count)

    @override
    def of(self, *values: Array) -> Array:
        # Of known numbers as one program: JAX would compile each operation by itself.
        each = jnp.vectorize(self.function.traced)
        return each(*values) if is_traced(values) else evaluate(each, *values, use=Use.BRIEF)

    @override
    def text(self, *texts: str) -> str:
        return f"{_name(self.function.given.args[-1])}({', '.join(texts)})"


def _name(function: Callable[..., Any]) -> str:
    name = getattr(function, "__name__", "")
    return name if name.isidentifier() else "f"


def _number(who: str, function: Callable[..., Any], *numbers: Array) -> Array:
    number = traceable(f"{who} of expressions", function(*numbers))
    if number.shape != ():
        raise ProblemError(
            f"{who} of expressions: expected one number from one number of each expression; received an array of "
            f"shape {number.shape}. It is called for one instant at a time; al.time_integral joins instants."
        )
    return number


def _of_factor(unit: str | None) -> str:
    """The unit of a factor: a plain number is pure."""
    return PURE if unit is None else unit


def _alone(text: str) -> str:
    """A base or a divisor: in brackets unless it is one name or number."""
    return text if _ELEMENTARY.fullmatch(text) else f"({text})"


def _bracketed(text: str, *, also: str = "") -> str:
    """A factor: in brackets if it is a sum, or holds any of some other signs outside of brackets."""
    depth, splits = 0, text.startswith("−")
    for before, sign in itertools.pairwise(text):
        depth += (sign in "([") - (sign in ")]")
        splits |= depth == 0 and ((before == " " and sign in "+−") or sign in also)
    return f"({text})" if splits else text
