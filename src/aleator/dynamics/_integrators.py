"""Integrators: fixed-step Runge-Kutta for optimisation, adaptive ones (diffrax) for stiff and long simulations."""

import abc
from collections.abc import Callable
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator.dynamics._grid import Grid
from aleator.dynamics._system import System, derivative, initial_state, observation
from aleator.trajectories import AbstractSignal

Inputs = dict[str, AbstractSignal]
History = dict[str, Float[Array, "instants ..."]]
Observe = Callable[[System, Any, Any, dict[str, Array]], dict[str, Array]]


class AbstractIntegrator(eqx.Module):
    """How a system's states are carried from one instant of a grid to the next."""

    @abc.abstractmethod
    def outputs(self, system: System, grid: Grid, inputs: Inputs, observe: Observe = observation) -> History:
        """What `observe` takes of the system at every instant, its outputs by default: shape (instants, ...)."""


@final
class RungeKutta4(AbstractIntegrator):
    """The classical Runge-Kutta method of order 4, one step of it between two instants.

    Its steps do not depend on the numbers, so that derivatives of the result are exact and free of noise: the default
    inside optimisation.
    """

    def outputs(self, system: System, grid: Grid, inputs: Inputs, observe: Observe = observation) -> History:
        """See `AbstractIntegrator.outputs`."""
        times, fractions = grid.times, grid.fractions
        nodes = sampled(inputs, grid, fractions)
        middles = sampled(inputs, grid, fractions[:-1] + 0.5 / grid.steps)
        start = initial_state(system)

        def rate(t: Array, z: Pytree, u: dict[str, Array]) -> Pytree:
            return derivative(system, t, z, u)

        def advance(z: Pytree, now: tuple) -> tuple[Pytree, Pytree]:
            t, u_start, u_middle, u_end = now
            h = grid.step
            k1 = rate(t, z, u_start)
            k2 = rate(t + h / 2, _along(z, h / 2, k1), u_middle)
            k3 = rate(t + h / 2, _along(z, h / 2, k2), u_middle)
            k4 = rate(t + h, _along(z, h, k3), u_end)
            end = jax.tree.map(lambda x, a, b, c, d: x + h / 6 * (a + 2 * b + 2 * c + d), z, k1, k2, k3, k4)
            # Outputs are taken inside the loop, while the state is at hand: states need not be stored.
            return end, observe(system, t + h, end, u_end)

        spans = (times[:-1], _rows(nodes, slice(None, -1)), middles, _rows(nodes, slice(1, None)))
        _, rest = jax.lax.scan(advance, start, spans)
        first = observe(system, times[0], start, {name: values[0] for name, values in nodes.items()})
        return {name: jnp.concatenate([first[name][None], rest[name]]) for name in first}


def _along(z: Pytree, length: Any, rates: Pytree) -> Pytree:
    return jax.tree.map(lambda x, rate: x + length * rate, z, rates)


def sampled(inputs: Inputs, grid: Grid, fractions: Float[np.ndarray, " n"]) -> dict[str, Float[Array, "n ..."]]:
    """Every input at fixed fractions of a grid's duration."""
    return {name: signal.sampled(fractions, grid.t_start, grid.t_final) for name, signal in inputs.items()}


def _rows(signals: dict[str, Array], rows: slice) -> dict[str, Array]:
    return {name: values[rows] for name, values in signals.items()}


class AbstractAdaptive(AbstractIntegrator):
    """Adaptive integration by diffrax, to relative and absolute tolerances.

    Where the solver gives up (more than `max_steps` steps between start and end) the outputs are not a number, which
    the caller reports with the realisation at fault. Loose tolerances give wrong derivatives.
    """

    rtol: float = eqx.field(static=True)
    atol: float = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)

    def __init__(self, rtol: float = 1e-8, atol: float = 1e-10, max_steps: int = 100_000):
        if not (rtol > 0 and atol > 0 and max_steps > 0):
            raise ProblemError(
                f"{type(self).__name__}: tolerances and max_steps are positive; "
                f"received rtol={rtol}, atol={atol}, max_steps={max_steps}."
            )
        self.rtol, self.atol, self.max_steps = rtol, atol, max_steps

    @abc.abstractmethod
    def solver(self) -> Any:
        """The method of diffrax."""

    def outputs(self, system: System, grid: Grid, inputs: Inputs, observe: Observe = observation) -> History:
        """See `AbstractIntegrator.outputs`."""
        import diffrax  # late: it takes as long to import as all the rest

        stretched = {name: signal.over(grid.t_start, grid.t_final) for name, signal in inputs.items()}

        def now(t: Any) -> dict[str, Array]:
            return {name: signal(t) for name, signal in stretched.items()}

        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, z, _: derivative(system, t, z, now(t))),
            self.solver(),
            t0=grid.t_start,
            t1=grid.t_final,
            dt0=None,
            y0=initial_state(system),
            saveat=diffrax.SaveAt(ts=grid.times, fn=lambda t, z, _: observe(system, t, z, now(t))),
            stepsize_controller=diffrax.PIDController(rtol=self.rtol, atol=self.atol),
            # Forward sensitivities: few decisions, many outputs.
            adjoint=diffrax.ForwardMode(),
            max_steps=self.max_steps,
            throw=False,
        )
        arrived = solution.result == diffrax.RESULTS.successful
        return jax.tree.map(lambda values: jnp.where(arrived, values, jnp.nan), solution.ys)


@final
class Tsit5(AbstractAdaptive):
    """Adaptive explicit Runge-Kutta of order 5 (Tsitouras, 2011), for smooth systems that are not stiff."""

    def solver(self) -> Any:
        """See `AbstractAdaptive.solver`."""
        import diffrax

        return diffrax.Tsit5()


@final
class Kvaerno5(AbstractAdaptive):
    """Adaptive implicit Runge-Kutta of order 5 (Kvaerno, 2004), for stiff systems."""

    def solver(self) -> Any:
        """See `AbstractAdaptive.solver`."""
        import diffrax

        return diffrax.Kvaerno5()
