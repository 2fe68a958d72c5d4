"""The functionals: integrals of an output, rms, terminal, path and peak; an output without time."""

import abc
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, ClassVar, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array
from typing_extensions import override

from aleator._core.border import a_name
from aleator._core.errors import ProblemError
from aleator.design._expression import Constraint, Expression
from aleator.design._statistic import AbstractFunctional, Taken, functionals_of, statistics_in
from aleator.dynamics import AbstractGrid, Grid, phase_of
from aleator.statistics import integrated, product, root, squared

Functional = TypeVar("Functional", bound=AbstractFunctional)

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
    def reach(self, peaks: Mapping[str, Any], grid: Any) -> Any:
        return self.total(grid.duration * abs(self.integrand(peaks)), grid)


@final
class Integral(AbstractIntegral):
    """The time integral of an output."""

    symbol = "∫{} dt"

    @override
    def integrand(self, now: Mapping[str, Array]) -> Array:
        return now[self.output]

    @override
    def unit(self, outputs: Mapping[str, str]) -> str:
        return integrated(outputs.get(self.output, ""))


@final
class SquareIntegral(AbstractIntegral):
    """The time integral of an output's square."""

    symbol = "∫{}² dt"

    @override
    def integrand(self, now: Mapping[str, Array]) -> Array:
        return now[self.output] ** 2

    @override
    def unit(self, outputs: Mapping[str, str]) -> str:
        return integrated(squared(outputs.get(self.output, "")))


@final
class Rms(AbstractIntegral):
    """The root mean square of an output over time, equations (109) and (110)."""

    symbol = "rms({})"

    @override
    def integrand(self, now: Mapping[str, Array]) -> Array:
        return now[self.output] ** 2

    @override
    def total(self, integral: Array, grid: Grid) -> Array:
        # An output that is zero throughout has rms zero and derivative zero (the smallest subgradient).
        return root(integral / grid.duration)


@final
class Work(AbstractIntegral):
    """The time integral of the magnitude of a product, such as torque times rate: the energy exchanged.

    With a `smoothing` `s`, the magnitude is `sqrt(x² + s²) - s`: smooth, and at most `s` below `|x|`.
    """

    symbol = "∫|{} {}| dt"
    smoothing: float = eqx.field(static=True, default=0.0)

    @override
    def integrand(self, now: Mapping[str, Array]) -> Array:
        force, rate = (now[name] for name in self.outputs)
        exchanged, s = force * rate, self.smoothing
        return jnp.sqrt(exchanged**2 + s**2) - s if s else abs(exchanged)

    @override
    def unit(self, outputs: Mapping[str, str]) -> str:
        return integrated(product(*(outputs.get(name, "") for name in self.outputs)))


class AbstractReading(AbstractFunctional):
    """A functional of one output's history, whose first axis is time, as accurate as the states unless said."""

    order = INTEGRATED
    read: ClassVar[Callable[[Array], Array]]

    @override
    def evaluate(self, taken: Taken, grid: AbstractGrid) -> Array:
        del grid
        return self.read(taken.history[self.output])


@final
class Terminal(AbstractReading):
    """An output at the final time."""

    symbol, read = "{}(t_f)", staticmethod(lambda history: history[-1])


@final
class Initial(AbstractReading):
    """An output at the first instant."""

    symbol, read = "{}(t_0)", staticmethod(lambda history: history[0])


@final
class Path(AbstractReading):
    """An output at every instant of the grid."""

    is_path = True
    symbol, read = "{}(t)", staticmethod(lambda history: history)


@final
class Peak(AbstractReading):
    """The largest magnitude of an output over time. Not smooth where the instant of the peak jumps: prefer `path`."""

    order = 2
    symbol, read = "max|{}(t)|", staticmethod(lambda history: jnp.max(jnp.abs(history), axis=0))


@final
class Output(AbstractReading):
    """An output of an algebraic system."""

    order, needs_time = 2, False
    symbol, read = "{}", staticmethod(lambda history: history[0])


@final
class FloquetMultiplier(AbstractFunctional):
    """The largest magnitude of the eigenvalues of a cycle's monodromy matrix."""

    order = INTEGRATED
    symbol = "max|λ|"

    @property
    @override
    def output(self) -> str:
        return self.text()

    @override
    def evaluate(self, taken: Taken, grid: AbstractGrid) -> Array:
        del grid
        return jnp.max(jnp.abs(jnp.linalg.eigvals(taken.monodromy)))

    @override
    def reach(self, peaks: Mapping[str, Any], grid: AbstractGrid) -> Any:
        del peaks, grid
        return 1.0

    @override
    def refuse_on(self, grid: AbstractGrid) -> None:
        if not (isinstance(grid, Grid) and grid.periodic):
            raise ProblemError(
                "al.floquet_multiplier() is that of a cycle: expected a grid that repeats, al.Grid(..., periodic=True)."
            )


@final
class At(AbstractFunctional):
    """An output at the first event of a name, before its jump; its time, s, without an output."""

    order = INTEGRATED
    event: str = eqx.field(static=True)

    @property
    @override
    def output(self) -> str:
        return self.outputs[0] if self.outputs else self.text()

    @property
    @override
    def place(self) -> str:
        return self.event

    @override
    def in_phase(self, phase: str) -> "At":
        return super().in_phase(phase)._with(event=f"{phase}.{self.event}")

    @override
    def evaluate(self, taken: Taken, grid: AbstractGrid) -> Array:
        del grid
        first = taken.events[self.event]
        return first.outputs[self.output] if self.outputs else first.t

    @override
    def reach(self, peaks: Mapping[str, Any], grid: Any) -> Any:
        return super().reach(peaks, grid) if self.outputs else grid.duration

    @override
    def text(self) -> str:
        return f"{self.outputs[0]}(t_{self.event})" if self.outputs else f"t_{self.event}"

    @override
    def unit(self, outputs: Mapping[str, str]) -> str:
        return super().unit(outputs) if self.outputs else "s"


def integral(output: str, phase: str | None = None) -> Integral:
    """The time integral of an output over the grid, or over a phase (see `Phases`), by default the last: `∫ y dt`."""
    return over(Integral((output,)), phase)


def rms(output: str, phase: str | None = None) -> Rms:
    """The root mean square of an output over the grid, or over a phase, by default the last."""
    return over(Rms((output,)), phase)


def initial(output: str, phase: str | None = None) -> Initial:
    """An output at the first instant, such as where the cycle of a grid with `periodic=True` begins; or at that of a
    phase, by default the last.
    """
    return over(Initial((output,)), phase)


def floquet_multiplier() -> FloquetMultiplier:
    """The largest factor by which a small deviation from a cycle grows in one period: it decays if this is below 1.

    The largest magnitude of the eigenvalues of the monodromy matrix, the derivatives of the states after one cycle by
    those before it. Where an event ends the cycle, the matrix is that from event to event, which does not see a shift
    in time. Differentiable once, where one eigenvalue (or conjugate pair) is largest.
    """
    return FloquetMultiplier(())


def terminal(output: str, phase: str | None = None) -> Terminal:
    """An output at the final time, or at the end of a phase, by default the last."""
    return over(Terminal((output,)), phase)


def at(event: str, output: str | None = None, phase: str | None = None) -> At:
    """An output at the first event of that name (see `Event`), before its jump; the event's time, s, without an output.

    - `phase`: in which it happens, by default the last; the time is that of the phase.

    A realisation that never meets the event has no value: solving, expanding and validating then name its numbers.
    """
    return over(At(() if output is None else (output,), a_name("at: event", event)), phase)


def path(output: str, phase: str | None = None) -> Path:
    """An output at every instant, or at those of a phase, by default the last: bounds on it hold at each."""
    return over(Path((output,)), phase)


def peak(output: str, phase: str | None = None) -> Peak:
    """The largest magnitude of an output over time, or over a phase, by default the last."""
    return over(Peak((output,)), phase)


def over(functional: Functional, phase: str | None) -> Functional:
    """A functional over a phase, or over the whole time, which is the last phase where there are some."""
    return functional if phase is None else functional.in_phase(a_name(f"'{functional.text()}': phase", phase))


def in_phases(expression: Expression, phases: Collection[str], own: str) -> Expression:
    """An expression whose functionals are those of one phase, where they name no other."""

    def placed(node: Any) -> Any:
        is_open = isinstance(node, AbstractFunctional) and phase_of(node.place) not in phases
        return node.in_phase(own) if is_open else node

    return jax.tree.map(placed, expression, is_leaf=lambda node: isinstance(node, AbstractFunctional))


def limit_in_phases(limit: Constraint, phases: Collection[str], own: str) -> Constraint:
    """The same of a constraint, which is named anew unless it has a name of its own."""
    name = limit.name if limit.has_own_name else None
    return Constraint(in_phases(limit.expression, phases, own), lower=limit.lower, upper=limit.upper, name=name)


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
