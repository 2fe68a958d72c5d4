"""Functionals: what is measured on the time history of an output. Each has statistics, and bounds on them."""

import abc
from typing import TYPE_CHECKING, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator.dynamics import Grid, History

if TYPE_CHECKING:
    from aleator.design._constraint import Constraint
    from aleator.design._expression import Expression


class Functional(eqx.Module):
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
    def mean(self) -> "Expression":
        """The expected value, equation (98)."""
        return _statistic(self, "mean")

    @property
    def std(self) -> "Expression":
        """The standard deviation, equation (99)."""
        return _statistic(self, "std")

    @property
    def variance(self) -> "Expression":
        """The variance, equation (97)."""
        return _statistic(self, "variance")

    def at_most(self, upper: float, *, sigmas: float = 0.0) -> "Constraint":
        """`mean + sigmas * std <= upper`."""
        return ((self.mean + sigmas * self.std) <= upper).named(self.output)

    def at_least(self, lower: float, *, sigmas: float = 0.0) -> "Constraint":
        """`mean - sigmas * std >= lower`."""
        return ((self.mean - sigmas * self.std) >= lower).named(self.output)

    def within(self, lower: float, upper: float, *, sigmas: float = 0.0) -> "tuple[Constraint, Constraint]":
        """Both `mean + sigmas * std <= upper` and `mean - sigmas * std >= lower`, under one name.

        Raises `ProblemError` for bounds in the wrong order.
        """
        from aleator.design._constraint import ordered  # the two classes refer to each other

        lower, upper = ordered(self.output, lower, upper)
        return self.at_most(upper, sigmas=sigmas), self.at_least(lower, sigmas=sigmas)


def _statistic(functional: Functional, kind: str) -> "Expression":
    from aleator.design._expression import statistic  # the two classes refer to each other

    return statistic(functional, kind)


@final
class Integral(Functional):
    """The time integral of an output, by the trapezoidal rule on the grid."""

    def evaluate(self, history: History, grid: Grid) -> Array:
        """See `Functional.evaluate`."""
        return jnp.tensordot(grid.weights, history[self.output], axes=1)

    def text(self) -> str:
        """See `Functional.text`."""
        return f"∫{self.output} dt"


@final
class Rms(Functional):
    """The root of an output's mean square over time, equations (109) and (110)."""

    def evaluate(self, history: History, grid: Grid) -> Array:
        """See `Functional.evaluate`."""
        square = jnp.tensordot(grid.weights, history[self.output] ** 2, axes=1) / (grid.t_final - grid.t_start)
        positive = square > 0
        # An output that is zero throughout has rms zero, with derivative zero (its smallest subgradient).
        return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)

    def text(self) -> str:
        """See `Functional.text`."""
        return f"rms({self.output})"


@final
class Terminal(Functional):
    """An output at the final time."""

    def evaluate(self, history: History, grid: Grid) -> Array:
        """See `Functional.evaluate`."""
        del grid
        return history[self.output][-1]

    def text(self) -> str:
        """See `Functional.text`."""
        return f"{self.output}(t_f)"


@final
class Path(Functional):
    """An output at every instant of the grid."""

    def evaluate(self, history: History, grid: Grid) -> Array:
        """See `Functional.evaluate`."""
        del grid
        return history[self.output]

    def text(self) -> str:
        """See `Functional.text`."""
        return f"{self.output}(t)"


@final
class Peak(Functional):
    """The largest magnitude of an output over time. Not smooth where the instant of the peak jumps: prefer `path`."""

    def evaluate(self, history: History, grid: Grid) -> Array:
        """See `Functional.evaluate`."""
        del grid
        return jnp.max(jnp.abs(history[self.output]), axis=0)

    def text(self) -> str:
        """See `Functional.text`."""
        return f"max|{self.output}(t)|"


def integral(output: str) -> Integral:
    """The time integral of an output over the grid: `∫ y dt`."""
    return Integral(output)


def rms(output: str) -> Rms:
    """The root mean square of an output over the grid."""
    return Rms(output)


def terminal(output: str) -> Terminal:
    """An output at the final time."""
    return Terminal(output)


def path(output: str) -> Path:
    """An output at every instant: its bounds hold at each of them."""
    return Path(output)


def peak(output: str) -> Peak:
    """The largest magnitude of an output over time."""
    return Peak(output)
