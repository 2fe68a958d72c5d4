"""`residuals`: how far an output is from data that were measured at some times, for models that are fitted to them."""

from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library
from aleator._core.border import real_array, refusal, refuse_not_finite
from aleator._core.errors import ProblemError
from aleator._core.leaves import lowest
from aleator.design._expression import Expression, composed
from aleator.design._functionals import INTEGRATED, over
from aleator.design._rules import AbstractRule
from aleator.design._statistic import AbstractFunctional, Taken
from aleator.dynamics import AbstractGrid, Grid
from aleator.statistics import PURE, raised

# An output between instants is a polynomial through so many of them: one order more accurate than the most accurate
# integrator of fixed steps, so that data need not be at instants.
_NEIGHBOURS = 6
ROUNDED = 1e-9
"""What of the duration a measured time may lie outside of it by rounding."""


@final
class Measured(AbstractFunctional):
    """An output at some times, s: between instants by the polynomial through the nearest six."""

    order = INTEGRATED
    times: tuple[float, ...] = eqx.field(static=True)

    @override
    def evaluate(self, taken: Taken, grid: Any) -> Array:
        history = taken.history[self.output]
        count = min(_NEIGHBOURS, grid.steps + 1)
        steps = (jnp.asarray(self.times) - grid.t_start) / grid.step
        first = jnp.clip(jnp.floor(steps).astype(int) - (count - 1) // 2, 0, grid.steps + 1 - count)
        nodes = np.arange(count)
        away = (steps - first)[:, None] - nodes[None, :]
        others = [[other for other in nodes if other != node] for node in nodes]
        scales = np.array([np.prod([node - other for other in others[node]]) for node in nodes])
        # Lagrange's polynomials: ones and zeros at an instant.
        products = jnp.stack([jnp.prod(away[:, np.array(others[node])], axis=1) for node in nodes], axis=1)
        nearest = history[first[:, None] + nodes[None, :]]
        return jnp.einsum("mk,mk...->m...", products / scales[None, :], nearest)

    @override
    def refuse_on(self, grid: AbstractGrid) -> None:
        last = lowest(grid.t_final) if isinstance(grid, Grid) else None
        if not isinstance(grid, Grid) or last is None:
            return
        first = float(grid.t_start)
        rounding = ROUNDED * (last - first)
        for i, time in enumerate(self.times):
            if not first - rounding <= time <= last + rounding:
                raise ProblemError(
                    f"residuals of '{self.output}': expected times on the grid, from {first:g} to {last:g} s; received "
                    f"{time:g} s at index {i}. Let the grid reach there, or leave the datum out."
                )

    @override
    def text(self) -> str:
        times = [f"{time:g}" for time in self.times]
        listed = ", ".join(times) if len(times) < 5 else f"{times[0]}, {times[1]}, …, {times[-1]}; {len(times)} times"
        return f"{self.output}({listed})"


@final
class SquaredResiduals(AbstractRule):
    """The sum of the squares of `(value - data) / std`; a standard deviation of None divides by nothing."""

    is_never_negative = True
    data: Float[Array | np.ndarray, "times ..."]
    std: Float[Array | np.ndarray, "times ..."] | None

    def residuals(self, values: Float[Any, "times ..."]) -> Float[Any, "times ..."]:
        """The residuals themselves, in the shape of the values, which may have a last axis of several systems."""
        shape = self.data.shape
        if values.shape[: len(shape)] != shape:
            raise ProblemError(
                f"residuals: expected data of shape {values.shape}, one number for each time and each entry of the "
                f"output; received shape {shape}."
            )
        alike = shape + (1,) * (values.ndim - len(shape))
        library, values, data, std = in_library(values, self.data, self.std)
        away = values - library.reshape(data, alike)
        return away if std is None else away / library.reshape(std, alike)

    @override
    def of(self, *values: Array) -> Array:
        return (self.residuals(values[0]) ** 2).sum(axis=tuple(range(self.data.ndim)))

    @override
    def text(self, *texts: str) -> str:
        return f"Σ({texts[0]} − data)²" if self.std is None else f"Σ(({texts[0]} − data)/std)²"

    @override
    def unit(self, *units: str | None) -> str:
        return raised(units[0] or "", 2.0) if self.std is None else PURE


def residuals(output: str, times: Any, data: Any, *, std: Any = None, phase: str | None = None) -> Expression:
    """The sum of squared residuals of an output at measured times: what a model that fits its data minimises.

        problem = al.Problem(model, grid=al.Grid(5.0, 100), minimize=al.residuals("x", times, data, std=0.01))
        print(al.posterior(al.solve(problem)))

    - `output`: a name; several measured outputs are several terms of a sum;
    - `times`: s, within the grid and in any order, shape (times,); a time may stand there several times. Between the
      instants of the grid an output is the polynomial through the nearest six: more accurate than the integrator where
      it is smooth. One that jumps or has a kink wants instants at the measured times, where it is itself;
    - `data`: what was measured, in the output's unit, shape (times,), or (times, *shape) of an output that is an array,
      as where several experiments are the entries of its states;
    - `std`: the standard deviation of the measurement, by which residuals are divided: one number, one for each time,
      or one for each datum. Outputs of different units need it;
    - `phase`: in which it was measured, by default the last; times are those of the phase.

    The numbers to be identified are the model's decisions; where it is uncertain too, its mean is compared. Raises
    `ProblemError` for lengths that differ, for numbers that are not finite, with their index and time, and, once it is
    used in a problem, for times outside of the grid and an unknown output. Where an event ends the grid, an answer
    whose motion ends before the last datum is no solution.
    """
    who = f"residuals of '{output}'"
    at, measured = (real_array(f"{who}: {name}", one) for name, one in (("times", times), ("data", data)))
    if at.ndim != 1 or not at.size:
        raise refusal(f"{who}: times", "a list of times", times)
    refuse_not_finite(f"{who}: times", at)
    if measured.shape[:1] != at.shape:
        raise ProblemError(
            f"{who}: expected data for each of the {at.size} times; received data of shape {measured.shape}."
        )
    refuse_not_finite(f"{who}: data", measured, lambda place: f"index {place[0]}, t = {at[place[0]]:g} s")
    spread = None
    if std is not None:
        spread = real_array(f"{who}: std", std)
        if spread.shape not in ((), at.shape, measured.shape) or not (np.isfinite(spread) & (spread > 0)).all():
            raise refusal(f"{who}: std", "one positive number, one for each time, or one for each datum", std)
        spread = np.broadcast_to(spread.reshape(spread.shape + (1,) * (measured.ndim - spread.ndim)), measured.shape)
    functional = over(Measured((output,), tuple(at.tolist())), phase)
    return composed(SquaredResiduals(measured, spread), functional.mean)
