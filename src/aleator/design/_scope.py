"""What an expression is made of, and where it takes its numbers from."""

import abc
from typing import Any, final

import equinox as eqx
from jaxtyping import Array, Float


class AbstractScope(abc.ABC):
    """Where an expression takes its numbers from."""

    @abc.abstractmethod
    def statistic(self, functional: Any, kind: str) -> Float[Array, "..."]:
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
class Value(AbstractAtom):
    """A number of the model itself: a decision, a plain number, or a parameter of a distribution."""

    name: str = eqx.field(static=True)

    def evaluate(self, scope: AbstractScope) -> Array:
        """See `AbstractAtom.evaluate`."""
        return scope.value(self.name)

    def text(self) -> str:
        """See `AbstractAtom.text`."""
        return self.name
