"""Adaptive integrators (diffrax), for stiff and long simulations."""

import abc
from collections.abc import Callable
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array
from typing_extensions import override

from aleator._core import given
from aleator.dynamics._grid import Grid
from aleator.dynamics._integrators import AbstractIntegrator, Inputs
from aleator.dynamics._record import Asked, Record
from aleator.dynamics._system import System, derivative, initial_state

# Tolerances below these ask for more than 64-bit arithmetic gives.
_TIGHTEST_RELATIVE, _TIGHTEST_ABSOLUTE = 1e-12, 1e-14

# An integrator whose later half of steps adds less than this to the time it has covered is not short of steps.
_STUCK = 0.01


class AbstractAdaptive(AbstractIntegrator):
    """Adaptive integration by diffrax, to relative and absolute tolerances.

    No step is longer than one of the grid, for smooth states would carry it past whatever outputs, integrals and loads
    do meanwhile.

    Where the solver gives up (more than `max_steps` steps between start and end) the outputs are not a number, which
    the caller reports with the realisation at fault and what `explain` says of it. Loose tolerances give wrong
    derivatives.
    """

    rtol: float = eqx.field(static=True)
    atol: float = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)

    def __init__(self, rtol: float = 1e-8, atol: float = 1e-10, max_steps: int = 100_000):
        who = type(self).__name__
        self.rtol, self.atol = given.positive(f"{who}: rtol", rtol), given.positive(f"{who}: atol", atol)
        self.max_steps = given.whole(f"{who}: max_steps", max_steps)

    @abc.abstractmethod
    def solver(self) -> Any:
        """The method of diffrax."""

    @override
    def record(self, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> Record:
        import diffrax  # late: it takes as long to import as all the rest

        stretched = {name: signal.over(grid.t_start, grid.t_final) for name, signal in inputs.items()}

        def now(t: Any) -> dict[str, Array]:
            return {name: signal(t) for name, signal in stretched.items()}

        first = grid.times[0]
        start = initial_state(system)
        shapes = jax.eval_shape(lambda: asked.rates(system, first, start, now(first)))
        # diffrax takes no empty containers: what it carries and saves are lists of arrays.
        carried, structure = jax.tree.flatten((start, jax.tree.map(lambda one: jnp.zeros(one.shape), shapes)))

        def rates(t: Any, carried: list[Array], _: Any) -> list[Array]:
            z, u = jax.tree.unflatten(structure, carried)[0], now(t)
            return jax.tree.leaves((derivative(system, t, z, u), asked.rates(system, t, z, u)))

        def observed(t: Any, carried: list[Array]) -> tuple[Any, Any, Any]:
            (z, integrals), u = jax.tree.unflatten(structure, carried), now(t)
            halfway = asked.at_node(system, t, z, u) if asked.nodes else {}
            return asked.at_instant(system, t, z, u), halfway, integrals

        at = grid.node_times if asked.nodes else grid.times
        saved = diffrax.SaveAt(ts=at, fn=lambda t, carried, _: jax.tree.leaves(observed(t, carried)))
        solution = self._solved(rates, carried, grid, saved, self.max_steps)
        arrived = solution.result == diffrax.RESULTS.successful
        values_at = [jnp.where(arrived, values, jnp.nan) for values in solution.ys or []]
        found = jax.tree.structure(jax.eval_shape(lambda: observed(first, carried)))
        history, nodes, integrals = jax.tree.unflatten(found, values_at)
        if asked.nodes:
            history = {name: values[::2] for name, values in history.items()}
        return Record(history, nodes, tuple(one[-1] for one in integrals))

    @override
    def explain(self, system: System, grid: Grid, inputs: Inputs) -> str:
        import diffrax

        stretched = {name: signal.over(grid.t_start, grid.t_final) for name, signal in inputs.items()}

        def rates(t: Any, z: Any, _: Any) -> Any:
            return derivative(system, t, z, {name: signal(t) for name, signal in stretched.items()})

        def tried(most: int) -> Any:
            return self._solved(rates, initial_state(system), grid, diffrax.SaveAt(t1=True), most)

        solution = tried(self.max_steps)
        if bool(solution.result == diffrax.RESULTS.successful):
            return ""
        name, first, reached = type(self).__name__, float(grid.t_start), float(solution.ts[-1])
        halfway = float(tried(max(self.max_steps // 2, 1)).ts[-1])
        if bool(solution.result == diffrax.RESULTS.max_steps_reached) and reached - halfway > _STUCK * (
            reached - first
        ):
            return (
                f"{name} used up its {self.max_steps} steps at t = {reached:.4g} s of {float(grid.t_final):.4g} s. "
                f"Give it more, al.integrators.{name}(max_steps={10 * self.max_steps}), or larger tolerances."
            )
        return (
            f"{name} gets no further than t = {reached:.4g} s, where its steps become too short. Look for rates that "
            "jump, grow without bound or are not a number there (a root or logarithm of a negative number, a division "
            "by zero), or bound the distributions and decisions that lead there."
        )

    def _solved(self, rates: Callable[..., Any], start: Any, grid: Grid, saved: Any, most: int) -> Any:
        import diffrax

        return diffrax.diffeqsolve(
            diffrax.ODETerm(lambda *at: jax.tree.map(_slopes_of_numbers, rates(*at))),
            self.solver(),
            t0=grid.t_start,
            t1=grid.t_final,
            dt0=None,
            y0=start,
            saveat=saved,
            stepsize_controller=diffrax.PIDController(rtol=self.rtol, atol=self.atol, dtmax=grid.step),
            # Forward sensitivities: few decisions, many outputs.
            adjoint=diffrax.ForwardMode(),
            max_steps=most,
            throw=False,
        )

    @override
    def refined(self) -> AbstractIntegrator:
        return type(self)(**self.tighter())

    def tighter(self) -> dict[str, Any]:
        """Arguments for a hundredth of the tolerances, as far as arithmetic goes."""
        return {
            "rtol": max(self.rtol / 100, _TIGHTEST_RELATIVE),
            "atol": max(self.atol / 100, _TIGHTEST_ABSOLUTE),
            "max_steps": 10 * self.max_steps,
        }


@jax.custom_jvp
def _slopes_of_numbers(rate: Array) -> Array:
    """A rate as it is, its derivatives zero where it is not finite.

    A stage at which the rates are not finite is rejected, and its derivatives with it. Until then they must be numbers:
    diffrax's linear solvers raise an error of the whole program where they meet others.
    """
    return rate


@_slopes_of_numbers.defjvp
def _slopes(rates: tuple[Array], slopes: tuple[Array]) -> tuple[Array, Array]:
    return _slopes_of_numbers(rates[0]), jnp.where(jnp.isfinite(rates[0]), slopes[0], 0.0)


@final
class Tsit5(AbstractAdaptive):
    """Adaptive explicit Runge-Kutta of order 5 (Tsitouras, 2011), for smooth systems that are not stiff."""

    @override
    def solver(self) -> Any:
        import diffrax

        return diffrax.Tsit5()

    @override
    def reference(self) -> AbstractIntegrator:
        return Dopri8(**self.tighter())


@final
class Dopri8(AbstractAdaptive):
    """Adaptive explicit Runge-Kutta of order 8 (Dormand and Prince, 1981)."""

    @override
    def solver(self) -> Any:
        import diffrax

        return diffrax.Dopri8()

    @override
    def reference(self) -> AbstractIntegrator:
        return Tsit5(**self.tighter())


@final
class Kvaerno5(AbstractAdaptive):
    """Adaptive implicit Runge-Kutta of order 5 (Kvaerno, 2004), for stiff systems."""

    @override
    def solver(self) -> Any:
        import diffrax

        return diffrax.Kvaerno5()

    @override
    def reference(self) -> AbstractIntegrator:
        """The method of order 4, to tolerances that it is held to as well."""
        return Kvaerno4(**self.tighter())


@final
class Kvaerno4(AbstractAdaptive):
    """Adaptive implicit Runge-Kutta of order 4 (Kvaerno, 2004)."""

    @override
    def solver(self) -> Any:
        import diffrax

        return diffrax.Kvaerno4()

    @override
    def reference(self) -> AbstractIntegrator:
        return Kvaerno5(**self.tighter())
