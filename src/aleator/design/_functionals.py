"""The functionals: integral, rms, terminal, path and peak of an output; an output without time."""

from collections.abc import Mapping
from typing import final

import jax.numpy as jnp
from jaxtyping import Array

from aleator._core.units import integrated
from aleator.design._expression import Constraint
from aleator.design._statistic import AbstractFunctional, functionals_of
from aleator.dynamics import AbstractGrid, History
from aleator.statistics import root


@final
class Integral(AbstractFunctional):
    """The time integral of an output, by the trapezoidal rule on the grid."""

    def evaluate(self, history: History, grid: AbstractGrid) -> Array:
        """See `AbstractFunctional.evaluate`."""
        return jnp.tensordot(grid.weights, history[self.output], axes=1)

    def text(self) -> str:
        """See `AbstractFunctional.text`."""
        return f"∫{self.output} dt"

    def unit(self, outputs: Mapping[str, str]) -> str:
        """See `AbstractFunctional.unit`."""
        return integrated(outputs.get(self.output, ""))


@final
class Rms(AbstractFunctional):
    """The root of an output's mean square over time, equations (109) and (110)."""

    def evaluate(self, history: History, grid: AbstractGrid) -> Array:
        """See `AbstractFunctional.evaluate`."""
        # An output that is zero throughout has rms zero, with derivative zero (its smallest subgradient).
        return root(jnp.tensordot(grid.weights, history[self.output] ** 2, axes=1) / jnp.sum(grid.weights))

    def text(self) -> str:
        """See `AbstractFunctional.text`."""
        return f"rms({self.output})"


@final
class Terminal(AbstractFunctional):
    """An output at the final time."""

    def evaluate(self, history: History, grid: AbstractGrid) -> Array:
        """See `AbstractFunctional.evaluate`."""
        del grid
        return history[self.output][-1]

    def text(self) -> str:
        """See `AbstractFunctional.text`."""
        return f"{self.output}(t_f)"


@final
class Path(AbstractFunctional):
    """An output at every instant of the grid."""

    @property
    def is_path(self) -> bool:
        """See `AbstractFunctional.is_path`."""
        return True

    def evaluate(self, history: History, grid: AbstractGrid) -> Array:
        """See `AbstractFunctional.evaluate`."""
        del grid
        return history[self.output]

    def text(self) -> str:
        """See `AbstractFunctional.text`."""
        return f"{self.output}(t)"


@final
class Peak(AbstractFunctional):
    """The largest magnitude of an output over time. Not smooth where the instant of the peak jumps: prefer `path`."""

    def evaluate(self, history: History, grid: AbstractGrid) -> Array:
        """See `AbstractFunctional.evaluate`."""
        del grid
        return jnp.max(jnp.abs(history[self.output]), axis=0)

    def text(self) -> str:
        """See `AbstractFunctional.text`."""
        return f"max|{self.output}(t)|"


@final
class Output(AbstractFunctional):
    """An output of an algebraic system."""

    @property
    def needs_time(self) -> bool:
        """See `AbstractFunctional.needs_time`."""
        return False

    def evaluate(self, history: History, grid: AbstractGrid) -> Array:
        """See `AbstractFunctional.evaluate`."""
        del grid
        return history[self.output][0]

    def text(self) -> str:
        """See `AbstractFunctional.text`."""
        return self.output


def integral(output: str) -> Integral:
    """The time integral of an output over the grid: `∫ y dt`."""
    return Integral((output,))


def rms(output: str) -> Rms:
    """The root mean square of an output over the grid."""
    return Rms((output,))


def terminal(output: str) -> Terminal:
    """An output at the final time."""
    return Terminal((output,))


def path(output: str) -> Path:
    """An output at every instant: its bounds hold at each of them."""
    return Path((output,))


def peak(output: str) -> Peak:
    """The largest magnitude of an output over time."""
    return Peak((output,))


def output(name: str) -> Output:
    """An output of an algebraic system, which has no time."""
    return Output((name,))


def is_over_time(constraint: Constraint) -> bool:
    """Whether a constraint limits a path, or the peak of one: the instants between those of the grid count too."""
    return constraint.is_path or any(isinstance(one, Peak) for one in functionals_of((constraint.expression,)))
