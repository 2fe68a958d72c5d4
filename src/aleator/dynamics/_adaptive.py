"""Adaptive integrators (diffrax), for stiff and long simulations."""

from collections.abc import Callable
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array
from typing_extensions import override

from aleator._core import border
from aleator.dynamics._evaluation import completed, derivative, explain_algebraic, explain_from, initial_state
from aleator.dynamics._grid import Grid, Inputs, inputs_on
from aleator.dynamics._integrators import AbstractIntegrator
from aleator.dynamics._record import Asked, Record
from aleator.dynamics._system import System
from aleator.trajectories import jumps_of

_RELATIVE, _ABSOLUTE, _STEPS = 1e-8, 1e-10, 100_000

# Smaller tolerances cannot be met in 64-bit arithmetic.
_TIGHTEST_RELATIVE, _TIGHTEST_ABSOLUTE = 1e-12, 1e-14

# If the second half of the steps advances time by less than this fraction, more steps would not help.
_STUCK = 0.01


class AbstractAdaptive(AbstractIntegrator):
    """Adaptive integration to relative and absolute tolerances, by the solver of diffrax that has the class's name.

    Steps are never longer than those of the grid: with smooth states, longer ones could pass over fast changes of
    outputs, integrands or loads.

    Where the solver gives up (after `max_steps` steps in all) the outputs are NaN, which the caller reports with the
    realisation at fault and the text of `explain`. Loose tolerances give inaccurate derivatives.
    """

    # Type checkers read the arguments of subclasses, which have no `__init__`, off the fields.
    rtol: float = eqx.field(static=True, default=_RELATIVE)
    atol: float = eqx.field(static=True, default=_ABSOLUTE)
    max_steps: int = eqx.field(static=True, default=_STEPS)

    def __init__(self, rtol: float = _RELATIVE, atol: float = _ABSOLUTE, max_steps: int = _STEPS):
        who = type(self).__name__
        self.rtol, self.atol = border.positive(f"{who}: rtol", rtol), border.positive(f"{who}: atol", atol)
        self.max_steps = border.whole(f"{who}: max_steps", max_steps)

    @override
    def record(self, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> Record:
        import diffrax  # late: its import takes as long as everything else

        now = inputs_on(grid, inputs)
        first = grid.times[0]
        start = initial_state(system, first, now(first))
        shapes = jax.eval_shape(lambda: asked.rates(system, first, start, now(first)))
        # diffrax accepts no empty containers, so states and saved values are lists of arrays.
        carried, structure = jax.tree.flatten((start, jax.tree.map(lambda one: jnp.zeros(one.shape), shapes)))

        def rates(t: Any, carried: list[Array], _: Any) -> list[Array]:
            u = now(t)
            z = completed(system, t, jax.tree.unflatten(structure, carried)[0], u)
            return jax.tree.leaves(asked.slopes(system, t, z, u))

        def observed(t: Any, carried: list[Array]) -> tuple[Any, Any, Any]:
            (z, integrals), u = jax.tree.unflatten(structure, carried), now(t)
            z = completed(system, t, z, u)
            halfway = asked.at_node(system, t, z, u) if asked.nodes else {}
            return asked.at_instant(system, t, z, u), halfway, integrals

        at = grid.node_times if asked.nodes else grid.times
        saved = diffrax.SaveAt(ts=at, fn=lambda t, carried, _: jax.tree.leaves(observed(t, carried)))
        solution = self._solved(rates, carried, grid, inputs, saved, self.max_steps)
        arrived = solution.result == diffrax.RESULTS.successful
        values_at = [jnp.where(arrived, values, jnp.nan) for values in solution.ys or []]
        structure_at = jax.tree.structure(jax.eval_shape(lambda: observed(first, carried)))
        history, nodes, integrals = jax.tree.unflatten(structure_at, values_at)
        if asked.nodes:
            history = {name: values[::2] for name, values in history.items()}
        return Record(history, nodes, tuple(one[-1] for one in integrals))

    @override
    def explain(self, system: System, grid: Grid, inputs: Inputs) -> str:
        import diffrax

        now = inputs_on(grid, inputs)

        def rates(t: Any, z: Any, _: Any) -> Any:
            return derivative(system, t, z, now(t))

        start = initial_state(system, grid.times[0], now(grid.times[0]))

        def tried(most: int) -> Any:
            return self._solved(rates, start, grid, inputs, diffrax.SaveAt(t1=True), most)

        solution = tried(self.max_steps)
        if bool(solution.result == diffrax.RESULTS.successful):
            return (
                explain_algebraic(system, grid, inputs, self.course(system, grid, inputs)) if system.algebraic else ""
            )
        name, first, reached = type(self).__name__, float(grid.t_start), float(solution.ts[-1])
        arrived = jax.tree.map(lambda one: one[-1], solution.ys)
        if system.algebraic and (failure := explain_from(system, reached, arrived, float(grid.step), now)):
            return failure
        halfway = float(tried(max(self.max_steps // 2, 1)).ts[-1])
        if bool(solution.result == diffrax.RESULTS.max_steps_reached) and reached - halfway > _STUCK * (
            reached - first
        ):
            return (
                f"{name} used up its {self.max_steps} steps at t = {reached:.4g} s of {float(grid.t_final):.4g} s. "
                f"Give it more, al.integrators.{name}(max_steps={10 * self.max_steps}), or larger tolerances."
            )
        return (
            f"{name} stops at t = {reached:.4g} s, where its steps become too short. Check for rates that jump, grow "
            "without bound or are not a number there (a root or logarithm of a negative number, a division by zero), "
            "or bound the distributions and decisions that lead there."
        )

    def _solved(
        self,
        rates: Callable[..., Any],
        start: Any,
        grid: Grid,
        inputs: Inputs,
        saved: Any,
        most: int,
    ) -> Any:
        import diffrax

        controller = diffrax.PIDController(rtol=self.rtol, atol=self.atol, dtmax=grid.step)
        if (jumps := jumps_of(inputs, grid.t_start, grid.t_final)).size:
            controller = diffrax.ClipStepSizeController(controller, jump_ts=jumps)
        return diffrax.diffeqsolve(
            diffrax.ODETerm(lambda *at: jax.tree.map(_slopes_of_numbers, rates(*at))),
            getattr(diffrax, type(self).__name__)(),
            t0=grid.t_start,
            t1=grid.t_final,
            dt0=None,
            y0=start,
            saveat=saved,
            stepsize_controller=controller,
            # Forward mode, for few decisions and many outputs.
            adjoint=diffrax.ForwardMode(),
            max_steps=most,
            throw=False,
        )

    @override
    def refined(self) -> AbstractIntegrator:
        return type(self)(**self.tighter())

    def tighter(self) -> dict[str, Any]:
        """Arguments for a hundredth of the tolerances, limited by 64-bit arithmetic."""
        return {
            "rtol": max(self.rtol / 100, _TIGHTEST_RELATIVE),
            "atol": max(self.atol / 100, _TIGHTEST_ABSOLUTE),
            "max_steps": 10 * self.max_steps,
        }


@jax.custom_jvp
def _slopes_of_numbers(rate: Array) -> Array:
    """The unchanged rate, with derivatives of zero where it is not finite.

    A stage with non-finite rates is rejected, and its derivatives with it. Until then these must be finite, or
    diffrax's linear solvers would raise an error for the whole program.
    """
    return rate


@_slopes_of_numbers.defjvp
def _slopes(rates: tuple[Array], slopes: tuple[Array]) -> tuple[Array, Array]:
    return _slopes_of_numbers(rates[0]), jnp.where(jnp.isfinite(rates[0]), slopes[0], 0.0)


@final
class Tsit5(AbstractAdaptive):
    """Adaptive explicit Runge-Kutta of order 5 (Tsitouras, 2011), for smooth, non-stiff systems."""

    @override
    def reference(self) -> AbstractIntegrator:
        return Dopri8(**self.tighter())


@final
class Dopri8(AbstractAdaptive):
    """Adaptive explicit Runge-Kutta of order 8 (Dormand and Prince, 1981)."""

    @override
    def reference(self) -> AbstractIntegrator:
        return Tsit5(**self.tighter())


@final
class Kvaerno5(AbstractAdaptive):
    """Adaptive implicit Runge-Kutta of order 5 (Kvaerno, 2004), for stiff systems."""

    @override
    def reference(self) -> AbstractIntegrator:
        """The method of order 4, at the same tolerances."""
        return Kvaerno4(**self.tighter())


@final
class Kvaerno4(AbstractAdaptive):
    """Adaptive implicit Runge-Kutta of order 4 (Kvaerno, 2004)."""

    @override
    def reference(self) -> AbstractIntegrator:
        return Kvaerno5(**self.tighter())
