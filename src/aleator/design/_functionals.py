"""The functionals: integrals of an output, rms, terminal, path and peak; an output without time."""

import abc
from collections.abc import Iterable, Mapping
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array
from typing_extensions import override

from aleator._core.border import a_name
from aleator._core.errors import ProblemError
from aleator.design._expression import Constraint, Expression
from aleator.design._statistic import AbstractFunctional, Taken, functionals_of, statistics_in
from aleator.dynamics import AbstractGrid, Grid
from aleator.statistics import integrated, product, root, squared

# The order of what the integrator carries, at the instants of its grid.
INTEGRATED = 4


class AbstractIntegral(AbstractFunctional):
    """A function of the time integral of outputs, which is computed as accurately as the states."""

    order = INTEGRATED

    @abc.abstractmethod
    def integrand(self, now: Mapping[str, Array]) -> Array:
        """The integrand, from the outputs at one time."""

    def total(self, integral: Array, grid: Grid) -> Array:
        """The functional, from the integral over the grid; the integral itself by default."""
        del grid
        return integral

    @override
    def evaluate(self, taken: Taken, grid: Any) -> Array:
        return self.total(taken.integrals[self], grid)

    @override
    def reach(self, peaks: Mapping[str, Array], grid: Any) -> Array:
        return self.total(grid.duration * jnp.abs(self.integrand(peaks)), grid)


@final
class Integral(AbstractIntegral):
    """The time integral of an output."""

    @override
    def integrand(self, now: Mapping[str, Array]) -> Array:
        return now[self.output]

    @override
    def text(self) -> str:
        return f"∫{self.output} dt"

    @override
    def unit(self, outputs: Mapping[str, str]) -> str:
        return integrated(outputs.get(self.output, ""))


@final
class Rms(AbstractIntegral):
    """The root mean square of an output over time, equations (109) and (110)."""

    @override
    def integrand(self, now: Mapping[str, Array]) -> Array:
        return now[self.output] ** 2

    @override
    def total(self, integral: Array, grid: Grid) -> Array:
        # An output that is zero throughout has rms zero and derivative zero (the smallest subgradient).
        return root(integral / grid.duration)

    @override
    def text(self) -> str:
        return f"rms({self.output})"


@final
class Terminal(AbstractFunctional):
    """An output at the final time."""

    order = INTEGRATED

    @override
    def evaluate(self, taken: Taken, grid: AbstractGrid) -> Array:
        del grid
        return taken.history[self.output][-1]

    @override
    def text(self) -> str:
        return f"{self.output}(t_f)"


@final
class Initial(AbstractFunctional):
    """An output at the first instant."""

    order = INTEGRATED

    @override
    def evaluate(self, taken: Taken, grid: AbstractGrid) -> Array:
        del grid
        return taken.history[self.output][0]

    @override
    def text(self) -> str:
        return f"{self.output}(t_0)"


@final
class FloquetMultiplier(AbstractFunctional):
    """The largest magnitude of the eigenvalues of a cycle's monodromy matrix."""

    order = INTEGRATED

    @property
    @override
    def output(self) -> str:
        return self.text()

    @override
    def evaluate(self, taken: Taken, grid: AbstractGrid) -> Array:
        del grid
        return jnp.max(jnp.abs(jnp.linalg.eigvals(taken.monodromy)))

    @override
    def reach(self, peaks: Mapping[str, Array], grid: AbstractGrid) -> Array:
        del peaks, grid
        return jnp.ones(())

    @override
    def refuse_on(self, grid: AbstractGrid) -> None:
        if not (isinstance(grid, Grid) and grid.periodic):
            raise ProblemError(
                "al.floquet_multiplier() is that of a cycle: expected a grid that repeats, al.Grid(..., periodic=True)."
            )

    @override
    def text(self) -> str:
        return "max|λ|"


@final
class At(AbstractFunctional):
    """An output at the first event of a name, before its jump; its time, s, without an output."""

    order = INTEGRATED
    event: str = eqx.field(static=True)

    @property
    @override
    def output(self) -> str:
        return self.outputs[0] if self.outputs else self.text()

    @override
    def evaluate(self, taken: Taken, grid: AbstractGrid) -> Array:
        del grid
        first = taken.events[self.event]
        return first.outputs[self.output] if self.outputs else first.t

    @override
    def reach(self, peaks: Mapping[str, Array], grid: Any) -> Array:
        return super().reach(peaks, grid) if self.outputs else jnp.asarray(grid.duration)

    @override
    def text(self) -> str:
        return f"{self.outputs[0]}(t_{self.event})" if self.outputs else f"t_{self.event}"

    @override
    def unit(self, outputs: Mapping[str, str]) -> str:
        return super().unit(outputs) if self.outputs else "s"


@final
class Path(AbstractFunctional):
    """An output at every instant of the grid."""

    is_path = True
    order = INTEGRATED

    @override
    def evaluate(self, taken: Taken, grid: AbstractGrid) -> Array:
        del grid
        return taken.history[self.output]

    @override
    def text(self) -> str:
        return f"{self.output}(t)"


@final
class Peak(AbstractFunctional):
    """The largest magnitude of an output over time. Not smooth where the instant of the peak jumps: prefer `path`."""

    @override
    def evaluate(self, taken: Taken, grid: AbstractGrid) -> Array:
        del grid
        return jnp.max(jnp.abs(taken.history[self.output]), axis=0)

    @override
    def text(self) -> str:
        return f"max|{self.output}(t)|"


@final
class Output(AbstractFunctional):
    """An output of an algebraic system."""

    needs_time = False

    @override
    def evaluate(self, taken: Taken, grid: AbstractGrid) -> Array:
        del grid
        return taken.history[self.output][0]

    @override
    def text(self) -> str:
        return self.output


def integral(output: str) -> Integral:
    """The time integral of an output over the grid: `∫ y dt`."""
    return Integral((output,))


def rms(output: str) -> Rms:
    """The root mean square of an output over the grid."""
    return Rms((output,))


def initial(output: str) -> Initial:
    """An output at the first instant, such as where the cycle of a grid with `periodic=True` begins."""
    return Initial((output,))


def floquet_multiplier() -> FloquetMultiplier:
    """The largest factor by which a small deviation from a cycle grows in one period: it decays if this is below 1.

    The largest magnitude of the eigenvalues of the monodromy matrix, the derivatives of the states after one cycle by
    those before it. Where an event ends the cycle, the matrix is that from event to event, which does not see a shift
    in time. Differentiable once, where one eigenvalue (or conjugate pair) is largest.
    """
    return FloquetMultiplier(())


def terminal(output: str) -> Terminal:
    """An output at the final time."""
    return Terminal((output,))


def at(event: str, output: str | None = None) -> At:
    """An output at the first event of that name (see `Event`), before its jump; the event's time, s, without an output.

    A realisation that never meets the event has no value: solving, expanding and validating then name its numbers.
    """
    return At(() if output is None else (output,), a_name("at: event", event))


def path(output: str) -> Path:
    """An output at every instant: bounds on it hold at each."""
    return Path((output,))


def peak(output: str) -> Peak:
    """The largest magnitude of an output over time."""
    return Peak((output,))


def output(name: str) -> Output:
    """An output of an algebraic system, which has no time."""
    return Output((name,))


def is_over_time(constraint: Constraint) -> bool:
    """Whether a constraint limits a path or a peak, so that times between the grid's instants count too."""
    return constraint.is_path or any(isinstance(one, Peak) for one in functionals_of((constraint.expression,)))


def events_of(functionals: Iterable[AbstractFunctional]) -> frozenset[str]:
    """The events whose first occurrence functionals need."""
    return frozenset(one.event for one in functionals if isinstance(one, At))


def expanded_functionals(expressions: tuple[Expression, ...]) -> tuple[AbstractFunctional, ...]:
    """The functionals in the expressions that need an expansion: those with a statistic, not only a worst case."""
    return tuple(dict.fromkeys(one for atom in statistics_in(expressions) for one in atom.functionals))


@final
class SquareIntegral(AbstractIntegral):
    """The time integral of an output's square."""

    @override
    def integrand(self, now: Mapping[str, Array]) -> Array:
        return now[self.output] ** 2

    @override
    def text(self) -> str:
        return f"∫{self.output}² dt"

    @override
    def unit(self, outputs: Mapping[str, str]) -> str:
        return integrated(squared(outputs.get(self.output, "")))


@final
class Work(AbstractIntegral):
    """The time integral of the magnitude of a product, such as torque times rate: the energy exchanged.

    With a `smoothing` `s`, the magnitude is `sqrt(x² + s²) - s`: smooth, and at most `s` below `|x|`.
    """

    smoothing: float = eqx.field(static=True, default=0.0)

    @override
    def integrand(self, now: Mapping[str, Array]) -> Array:
        force, rate = (now[name] for name in self.outputs)
        exchanged, s = force * rate, self.smoothing
        return jnp.sqrt(exchanged**2 + s**2) - s if s else jnp.abs(exchanged)

    @override
    def text(self) -> str:
        return f"∫|{' '.join(self.outputs)}| dt"

    @override
    def unit(self, outputs: Mapping[str, str]) -> str:
        return integrated(product(*(outputs.get(name, "") for name in self.outputs)))
