"""The atoms of expressions, the numbers that stand in them, and the scopes in which expressions are evaluated."""

import abc
from collections.abc import Mapping
from typing import Any, NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Scalar, in_library, jax_array
from aleator._core.border import real_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.statistics import AbstractStatistic


class AbstractScope(abc.ABC):
    """The source of the numbers in an expression: an expansion, one system, a sample."""

    @abc.abstractmethod
    def statistic(self, functionals: tuple[Any, ...], kind: AbstractStatistic) -> Float[Any, "..."]:
        """A statistic of a functional, or of several jointly (a covariance)."""

    def realised(self, functional: Any) -> Float[Array, "..."]:
        """A functional on single realisations, along a new last axis where there are several.

        Raises `ProblemError` where none are known; limits on the worst case are omitted there.
        """
        raise ProblemError(f"No single realisations are known here; received {functional.text()}.")

    @abc.abstractmethod
    def time_integral(self, expression: Any) -> Float[Array, ""]:
        """The time integral of an expression of paths."""

    @abc.abstractmethod
    def value(self, name: str) -> Float[Array, ""]:
        """A number of the model itself, by name."""


class AbstractScopeOfInstants(AbstractScope):
    """A scope with paths at instants `step` seconds apart, integrated by the trapezoidal rule: for comparisons and
    counts, not for optimisation.
    """

    step: Any

    @override
    def time_integral(self, expression: Any) -> Float[Array, "..."]:
        library, step, values = in_library(self.step, expression.evaluate(self))
        return jax_array(step * library.trapezoid(values, axis=0))


class Units(NamedTuple):
    """The units of a problem as far as they are known, as text (see `statistics/_units.py`).

    - `outputs`: of outputs, by name;
    - `numbers`: of those numbers of the model that expressions use, by name (`k_s`, `k_s.half_width`).
    """

    outputs: Mapping[str, str]
    numbers: Mapping[str, str]


class AbstractAtom(Module):
    """An elementary term of an expression, not a sum or multiple of others."""

    @abc.abstractmethod
    def evaluate(self, scope: AbstractScope) -> Float[Array, "..."]:
        """The term's value."""

    @abc.abstractmethod
    def text(self) -> str:
        """The term as mathematics."""

    @abc.abstractmethod
    def unit(self, units: Units) -> str:
        """The term's unit, from those of its outputs or numbers; empty where it does not follow from them."""

    @property
    @abc.abstractmethod
    def subjects(self) -> tuple[str, ...]:
        """The outputs or numbers of the model in it, by name."""

    @property
    def parts(self) -> "tuple[AbstractAtom, ...]":
        """Itself, or the atoms that it consists of, in the order of evaluation."""
        return (self,)

    @property
    def inner(self) -> tuple[Any, ...]:
        """The expressions that it consists of."""
        return ()

    @property
    def measures(self) -> tuple[str, ...]:
        """The functionals in it, as mathematics."""
        return ()

    @property
    def is_path(self) -> bool:
        """Whether it is one number per instant instead of one number."""
        return False

    @property
    def is_spread(self) -> bool:
        """Whether it is a standard deviation, whose multiples are margins."""
        return False


class AbstractComposite(AbstractAtom):
    """An atom made of expressions: its parts, subjects and measures are theirs."""

    @property
    @override
    def parts(self) -> tuple[AbstractAtom, ...]:
        return tuple(part for one in self.inner for part in one.leaves)

    @property
    @override
    def subjects(self) -> tuple[str, ...]:
        return tuple(name for part in self.parts for name in part.subjects)

    @property
    @override
    def measures(self) -> tuple[str, ...]:
        return tuple(text for part in self.parts for text in part.measures)


@final
class Value(AbstractAtom):
    """A number of the model itself: a decision, a plain number, or a parameter of a distribution."""

    name: str = eqx.field(static=True)

    @override
    def evaluate(self, scope: AbstractScope) -> Array:
        return scope.value(self.name)

    @override
    def text(self) -> str:
        return self.name

    @override
    def unit(self, units: Units) -> str:
        return units.numbers.get(self.name, "")

    @property
    @override
    def subjects(self) -> tuple[str, ...]:
        return (self.name,)


class AbstractRandom(Module):
    """A quantity that differs between realisations: only its statistics can be added, compared and bounded."""

    @abc.abstractmethod
    def text(self) -> str:
        """The quantity as mathematics."""

    def refuse(self, other: Any = None) -> Any:
        """Raise `ProblemError`: arithmetic and comparisons need a statistic."""
        del other
        raise ProblemError(
            f"'{self.text()}' differs between realisations: take a statistic of it, such as .mean, .std or "
            ".quantile(0.99), or use .at_most(...)."
        )

    __add__ = __radd__ = __sub__ = __rsub__ = __neg__ = refuse
    __mul__ = __rmul__ = __truediv__ = __rtruediv__ = __pow__ = refuse
    __lt__ = __le__ = __gt__ = __ge__ = refuse


def ordered(name: str, lower: Scalar, upper: Scalar) -> tuple[float, float]:
    """The bounds as floats. Raises `ProblemError` if they are in the wrong order or NaN."""
    lower, upper = (real_array(f"Constraint '{name}'", bound, "numbers as bounds") for bound in (lower, upper))
    if lower.ndim or upper.ndim:
        raise ProblemError(f"Constraint '{name}': expected one number as a bound; received {lower} and {upper}.")
    lower, upper = float(lower), float(upper)
    if np.isnan(lower) or np.isnan(upper):
        raise ProblemError(f"Constraint '{name}': expected numbers as bounds; received lower={lower}, upper={upper}.")
    if lower > upper:
        raise ProblemError(
            f"Constraint '{name}': expected lower <= upper; received lower={lower:g}, upper={upper:g}. Swap them."
        )
    return lower, upper
