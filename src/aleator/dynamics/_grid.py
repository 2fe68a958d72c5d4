"""The instants of a simulation, a `Grid` or, without time, one `Instant`; and signals at these instants."""

import abc
from collections.abc import Callable, Mapping
from copy import copy
from typing import Any, Self, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import NUMBER, Scalar, refuse_beyond_memory
from aleator._core.border import real, refusal, shown, whole
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf, Module, highest, lowest, stored_number
from aleator.dynamics._system import System, check_inputs
from aleator.trajectories import AbstractSignal, instants

Inputs = dict[str, AbstractSignal]


class AbstractGrid(Module):
    """The instants at which outputs are known, `steps` steps: the leading axis of every history."""

    steps: eqx.AbstractVar[int]

    @abc.abstractmethod
    def finer(self, factor: int) -> Self:
        """The same time span with `factor` times as many steps."""

    def divided(self, steps: int) -> Self:
        """The same time span with `steps` steps."""
        del steps
        return self

    def coarser(self, parts: int) -> Self:
        """The same time span with so many times fewer steps."""
        return self.divided(self.steps // parts)

    @property
    @abc.abstractmethod
    def step(self) -> Scalar:
        """Length of one step, s; 1 where there is no time, so that a sum over instants is the value itself."""

    @property
    @abc.abstractmethod
    def times(self) -> Float[Array, " instants"]:
        """All instants, in seconds."""

    def of(self, name: str) -> "AbstractGrid":
        """The grid of what has a name: that of its phase, where there are phases."""
        del name
        return self

    def where(self, name: str) -> slice:
        """Which of all instants are those of what has a name."""
        del name
        return slice(None)

    @property
    def times_told(self) -> dict[str, Float[Array, " instants"]]:
        """The instants by name, where nobody could know them else."""
        return {}


@final
class Grid(AbstractGrid):
    """Uniform instants from `t_start` to `t_final`, in seconds: `steps` steps, so `steps + 1` instants.

    `t_final` may be a `Decision`: a free final time. Trajectories among the inputs are stretched to the grid.

    `Grid(until="ground", at_most=10.0, steps=40)` ends in each realisation at the first event of that name of the
    system, at the latest at `at_most`, s: the instants of a realisation divide its own time into equal steps.
    Trajectories are stretched from `t_start` to `at_most`, and so are the same functions of time in all realisations.

    With `periodic=True` each realisation repeats: its states at the end, after the jump of the event there, are those
    at the start, which are sought by Newton's method from those of `initial()`.

    Raises `ProblemError` for times that are not finite or not in order, and for a final time beside `until`.
    """

    t_final: Any
    steps: int = eqx.field(static=True)
    t_start: Scalar
    until: str | None = eqx.field(static=True)
    at_most: float | None = eqx.field(static=True)
    periodic: bool = eqx.field(static=True)

    def __init__(
        self,
        t_final: Any = None,
        steps: Any = None,
        t_start: float = 0.0,
        *,
        until: str | None = None,
        at_most: float | None = None,
        periodic: bool = False,
    ):
        if not isinstance(periodic, bool):
            raise refusal("Grid: periodic", "True or False", periodic)
        self.periodic = periodic
        if until is not None or at_most is not None:
            at_most = t_final = _latest(t_final, until, at_most)
        self.until, self.at_most, self.steps = until, at_most, _steps(steps)
        self.t_start, t_final = real("Grid: t_start", t_start), stored_number("Grid: t_final", t_final)
        self.t_final = t_final = float(t_final) if isinstance(t_final, np.ndarray) else t_final
        earliest = lowest(t_final)  # None where it is traced, as inside a model's own equations
        is_uncertain = isinstance(t_final, AbstractLeaf) and t_final.is_uncertain
        if is_uncertain or not (earliest is None or self.t_start < earliest < np.inf):
            raise ProblemError(
                f"Grid: t_final: expected a number after t_start={self.t_start:g}, or a Decision that is at least one; "
                f"received {shown(t_final)}."
            )

    @property
    def latest(self) -> float:
        """The final time, or the largest that may be chosen or reached, s."""
        if self.at_most is not None:
            return self.at_most
        return float(self.t_final if (latest := highest(self.t_final)) is None else latest)

    @override
    def finer(self, factor: int) -> "Grid":
        return self.divided(factor * self.steps)

    @override
    def divided(self, steps: int) -> "Grid":
        return self._with("steps", _steps(steps))

    def ending(self, t_final: Scalar) -> "Grid":
        """The grid of a realisation that ends at this time by the event `until`."""
        return self._with("t_final", t_final)

    def ending_at(self, event: str) -> "Grid":
        """The same, ending at another event."""
        return self._with("until", event)

    def _with(self, field: str, value: Any) -> "Grid":
        grid = copy(self)  # its times may be traced, and were checked
        object.__setattr__(grid, field, value)
        return grid

    @property
    @override
    def step(self) -> Scalar:
        return (self.t_final - self.t_start) / self.steps

    @property
    def fractions(self) -> Float[np.ndarray, " instants"]:
        """All instants as fractions of the duration, which do not depend on the final time."""
        return np.linspace(0.0, 1.0, self.steps + 1)

    @property
    @override
    def times(self) -> Float[Array, " instants"]:
        return instants(self.fractions, self.t_start, self.t_final)

    @property
    @override
    def times_told(self) -> dict[str, Float[Array, " instants"]]:
        return {} if self.until is None else {"time": self.times}

    @property
    def duration(self) -> Scalar:
        """From the first instant to the last, s."""
        return self.t_final - self.t_start

    @property
    def node_fractions(self) -> Float[np.ndarray, " nodes"]:
        """The instants and the midpoints of the steps, as fractions of the duration."""
        return np.linspace(0.0, 1.0, 2 * self.steps + 1)

    @property
    def node_weights(self) -> Float[Array, " nodes"]:
        """Weights of Simpson's rule on instants and midpoints: of order 4, like the default integrator."""
        return jnp.asarray(self.duration * self.fraction_weights)

    @property
    def fraction_weights(self) -> Float[np.ndarray, " nodes"]:
        """The same by the fraction of the duration, which do not depend on the final time."""
        weights = np.tile([2.0, 4.0], self.steps + 1)[:-1]
        weights[[0, -1]] = 1.0
        return weights / (6 * self.steps)


@final
class Instant(AbstractGrid):
    """The single instant `t = 0` of an algebraic system, which has no time. A sum over it is the value itself."""

    steps: int = eqx.field(static=True, default=0, init=False)

    @override
    def finer(self, factor: int) -> "Instant":
        return self

    @property
    @override
    def step(self) -> Scalar:
        return 1.0

    @property
    @override
    def times(self) -> Float[Array, " instants"]:
        return jnp.zeros(1)


def _steps(steps: Any) -> int:
    """A number of steps of which the instants fit into memory, with the middles of the steps."""
    steps = whole("Grid: steps", steps)
    refuse_beyond_memory(f"Grid: {shown(steps)} steps", 3 * NUMBER * steps, "Take fewer steps.")
    return steps


def _latest(t_final: Any, until: Any, at_most: Any) -> float:
    """The final time of a grid that ends by an event, if this does not happen before."""
    if not (isinstance(until, str) and until):
        raise refusal("Grid: until", "the name of an event of the system, such as 'ground'", until)
    if t_final is not None:
        raise ProblemError(
            f"Grid: it ends at '{until}': expected the latest time as at_most; received t_final={t_final!r} too. Write "
            f"al.Grid(until='{until}', at_most=10.0, steps=40)."
        )
    return real(f"Grid: at_most, the latest time that '{until}' happens, s", at_most)


def sampled(inputs: Inputs, grid: Grid, fractions: Float[np.ndarray | Array, " n"]) -> dict[str, Float[Array, "n ..."]]:
    """Every input at some fractions of a grid's duration."""
    return {name: signal.sampled(fractions, grid.t_start, grid.t_final) for name, signal in inputs.items()}


def inputs_on(grid: Grid, inputs: dict[str, AbstractSignal]) -> Callable[[Any], dict[str, Array]]:
    """All inputs at a time on a grid."""
    stretched = {name: signal.over(grid.t_start, grid.t_final) for name, signal in inputs.items()}
    return lambda t: {name: signal(jnp.asarray(t, dtype=float)) for name, signal in stretched.items()}


def check_signals(system: System, grid: Grid, inputs: Mapping[str, Any]) -> None:
    """Refuse missing or unknown inputs, inputs that are not signals, and signals not known on the whole grid.

    The system's own signals are checked too. The grid extends to the largest final time that may be chosen; where its
    numbers are traced, the span is not checked.
    """
    check_inputs(system, inputs)
    for name, signal in inputs.items():
        if not isinstance(signal, AbstractSignal):
            raise ProblemError(
                f"Input '{name}' must be a signal, such as al.Tabulated(times, values); "
                f"received {type(signal).__name__}."
            )
    own = {f"Signal '{name}' of {system.title}": signal for name, signal in system.signals().items()}
    for who, signal in (own | {f"Input '{name}'": signal for name, signal in inputs.items()}).items():
        if not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((signal, grid))):
            check_span(who, signal, grid)


def check_span(who: str, signal: AbstractSignal, grid: Grid) -> None:
    """Refuse a signal that is not known on the whole grid; `who` it is, at the beginning of a sentence."""
    # These are known even while a function that simulates is traced.
    with jax.ensure_compile_time_eval():
        first, last = signal.span()
    start, end = float(grid.t_start), grid.latest
    if start < first or end > last:
        raise ProblemError(
            f"{who} is known from {first:g} to {last:g} s, but the grid runs from {start:g} to {end:g} s. Give it for "
            "the whole time, or change the grid."
        )
