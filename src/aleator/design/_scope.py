"""What an expression is made of, and where it takes its numbers from."""

import abc
from collections.abc import Mapping
from typing import Any, NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.statistics import AbstractStatistic


class AbstractScope(abc.ABC):
    """Where an expression takes its numbers from."""

    @abc.abstractmethod
    def statistic(self, functionals: tuple[Any, ...], kind: AbstractStatistic) -> Float[Array, "..."]:
        """A statistic of a functional, or of several jointly (a covariance)."""

    def realised(self, functional: Any) -> Float[Array, "..."]:
        """A functional on single realisations, along a new last axis where there are several.

        Raises `ProblemError` where none are known: there, limits on the worst case are left out.
        """
        raise ProblemError(f"No single realisations are known here; received {functional.text()}.")

    @abc.abstractmethod
    def time_integral(self, expression: Any) -> Float[Array, ""]:
        """The integral over time of an expression of paths."""

    @abc.abstractmethod
    def value(self, name: str) -> Float[Array, ""]:
        """A number of the model itself, by name."""


class AbstractScopeOfInstants(AbstractScope):
    """Paths at instants `step` seconds apart, whose integrals over time are taken by the trapezoidal rule: for what is
    compared or counted, and not optimised.
    """

    step: Any

    @override
    def time_integral(self, expression: Any) -> Float[Array, "..."]:
        return self.step * jnp.trapezoid(expression.evaluate(self), axis=0)


class Units(NamedTuple):
    """The units of a problem as far as they are known, as text (see `_core.units`).

    - `outputs`: of outputs, by name;
    - `numbers`: of numbers of the model, by name (`k_s`, `k_s.half_width`), for those that expressions speak of.
    """

    outputs: Mapping[str, str]
    numbers: Mapping[str, str]


class AbstractAtom(eqx.Module):
    """A term of an expression that is no sum or multiple of others."""

    @abc.abstractmethod
    def evaluate(self, scope: AbstractScope) -> Float[Array, "..."]:
        """The term's value."""

    @abc.abstractmethod
    def text(self) -> str:
        """The term as mathematics."""

    @abc.abstractmethod
    def unit(self, units: Units) -> str:
        """The term's unit, from those of what it speaks of; empty where it does not follow from them."""

    @property
    @abc.abstractmethod
    def subjects(self) -> tuple[str, ...]:
        """The outputs or numbers of the model that it speaks of, by name."""

    @property
    def parts(self) -> "tuple[AbstractAtom, ...]":
        """Itself, or the atoms that it is made of, in the order in which it evaluates them."""
        return (self,)

    @property
    def inner(self) -> tuple[Any, ...]:
        """The expressions that it is made of."""
        return ()

    @property
    def integrated(self) -> "tuple[AbstractAtom, ...]":
        """Those of its parts that are integrated over time: their paths are asked for between the instants too."""
        return ()

    @property
    def measures(self) -> tuple[str, ...]:
        """The functionals that it speaks of, as mathematics."""
        return ()

    @property
    def is_path(self) -> bool:
        """Whether it is one number an instant instead of one number."""
        return False

    @property
    def is_spread(self) -> bool:
        """Whether it is a standard deviation, whose multiples are margins."""
        return False


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


class AbstractRandom(eqx.Module):
    """What differs from one realisation to the next: only its statistics can be added, compared and bounded."""

    @abc.abstractmethod
    def text(self) -> str:
        """It as mathematics."""

    def refuse(self, other: Any = None) -> Any:
        """What it answers to arithmetic and comparisons. Raises `ProblemError`."""
        del other
        raise ProblemError(
            f"'{self.text()}' differs from one realisation to the next: name a statistic of it, "
            "such as .mean, .std or .quantile(0.99), or use .at_most(...)."
        )

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __neg__ = refuse
    __lt__ = __le__ = __gt__ = __ge__ = refuse
