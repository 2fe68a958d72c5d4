"""Adaptive integrators, for stiff and long simulations: a step of the grid is divided as its errors require."""

from collections.abc import Callable
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.lax import stop_gradient
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core import border
from aleator._core.compilation import Use, evaluate
from aleator._core.dependence import dependence
from aleator.dynamics._crossings import Course
from aleator.dynamics._evaluation import explain_from, initial_state
from aleator.dynamics._grid import Grid, Inputs, inputs_on
from aleator.dynamics._integrators import AbstractIntegrator
from aleator.dynamics._sparse import Sparsity
from aleator.dynamics._steps import Pace, Rates, Sizes, Step, Vector
from aleator.dynamics._system import System
from aleator.dynamics._tableaux import RODAS_5P, TSITOURAS_5, Tableau, square

_RELATIVE, _ABSOLUTE, _STEPS = 1e-8, 1e-10, 100_000

# Smaller tolerances cannot be met in 64-bit arithmetic.
_TIGHTEST_RELATIVE, _TIGHTEST_ABSOLUTE = 1e-12, 1e-14

# The next step follows from the error of this one, with a margin, and is shorter where this one gave no number.
_MARGIN, _LEAST_CHANGE, _MOST_CHANGE, _AFTER_NO_NUMBER = 0.9, 0.2, 10.0, 0.1

# If the last step is so many times shorter than the mean of all, more steps are no remedy.
_HOPELESS = 1000

# Signals have corners at instants, up to rounding: their slopes are those this fraction of a grid's step later.
_LATER = 1e-9


class AbstractAdaptive(AbstractIntegrator):
    """Adaptive integration: the error of each state in a step is at most `atol + rtol |state|`.

    A step ends at each instant of the grid, so that none passes over a fast change of outputs, integrands or loads, and
    at each declared jump. The states are one vector and the stages of a
    step are a loop, so that a system is compiled once for all of them, however many states it names.

    Where it gives up (after `max_steps` steps in all, or where steps become too short) the outputs are NaN, which the
    caller reports with the realisation at fault and the text of `explain`. Derivatives are those of the steps taken, as
    shares of the grid's steps: loose tolerances give inaccurate ones.
    """

    # Type checkers read the arguments of subclasses, which have no `__init__`, off the fields.
    rtol: float = eqx.field(static=True, default=_RELATIVE)
    atol: float = eqx.field(static=True, default=_ABSOLUTE)
    max_steps: int = eqx.field(static=True, default=_STEPS)

    tableau: ClassVar[Tableau]

    def __init__(self, rtol: float = _RELATIVE, atol: float = _ABSOLUTE, max_steps: int = _STEPS):
        who = type(self).__name__
        self.rtol, self.atol = border.positive(f"{who}: rtol", rtol), border.positive(f"{who}: atol", atol)
        self.max_steps = border.whole(f"{who}: max_steps", max_steps)

    @property
    @override
    def carries_algebraic(self) -> bool:
        return self.tableau.is_implicit

    @override
    def begun(self, grid: Grid) -> Pace:
        # The first step is the grid's, if its error is small.
        h = stop_gradient(jnp.asarray(grid.step))
        return Pace(h, jnp.asarray(self.max_steps), h, jnp.zeros(()))

    @override
    def step(self, rates: Rates, begin: Any, share: Any, vector: Vector, sizes: Sizes, pace: Pace | None) -> Step:
        assert pace is not None
        end, difference = _step(self.tableau, rates, begin, share, vector, sizes)
        size = jnp.maximum(jnp.abs(vector), jnp.abs(end))
        error = stop_gradient(jnp.max(jnp.abs(difference) / (self.atol + self.rtol * size)))
        change = _MARGIN * error ** (-1 / self.tableau.order)
        change = jnp.where(error >= 0, jnp.clip(change, _LEAST_CHANGE, _MOST_CHANGE), _AFTER_NO_NUMBER)
        h = stop_gradient(share) * pace.length * change
        return Step(end, None, error <= 1, pace._replace(h=h, left=pace.left - 1))

    @override
    def explain_given_up(self, system: System, grid: Grid, inputs: Inputs, one: Course, t: float) -> str:
        name, now, last = type(self).__name__, inputs_on(grid, inputs), float(grid.t_final)

        def arrived(end: Vector) -> Any:
            states, named = ravel_pytree(initial_state(system, grid.times[0], now(grid.times[0])))
            return named(end[: states.size])

        if system.algebraic:
            z = evaluate(arrived, one.end, use=Use.ONCE)
            if failure := explain_from(system, t, z, float(grid.step), now):
                return failure
        if self.rtol < _TIGHTEST_RELATIVE:
            return (
                f"{name} stops at t = {t:.4g} s, where rounding is larger than its tolerances: give it "
                f"rtol={_TIGHTEST_RELATIVE:g} or more."
            )
        assert one.pace is not None
        if int(one.pace.left) == 0 and _HOPELESS * self.max_steps * float(one.pace.h) > t - float(grid.t_start):
            stiff = "" if self.tableau.is_implicit else "; or take al.integrators.Rodas5P(), if the system is stiff"
            return (
                f"{name} used up its {self.max_steps} steps at t = {t:.4g} s of {last:.4g} s. "
                f"Give it more, al.integrators.{name}(max_steps={10 * self.max_steps}), or larger tolerances{stiff}."
            )
        return (
            f"{name} stops at t = {t:.4g} s, where its steps become too short. Check for rates that jump, grow "
            "without bound or are not a number there (a root or logarithm of a negative number, a division by zero), "
            "or bound the distributions and decisions that lead there."
        )

    @override
    def refined(self) -> AbstractIntegrator:
        return type(self)(
            max(self.rtol / 100, _TIGHTEST_RELATIVE), max(self.atol / 100, _TIGHTEST_ABSOLUTE), 10 * self.max_steps
        )

    @override
    def reference(self) -> AbstractIntegrator:
        """The same with smaller tolerances, and so with other steps."""
        return self.refined()


def _step(
    tableau: Tableau, rates: Rates, begin: Any, share: Any, vector: Vector, sizes: Sizes
) -> tuple[Vector, Vector]:
    """The end of one step and its estimated error; NaN where a stage has no number."""
    couplings, nodes = jnp.asarray(square(tableau.couplings)), jnp.asarray(tableau.nodes)
    # Equations without rates are not multiplied by the length of the step, so that they hold over no time too.
    has_rate = sizes.has_rate
    multiples = share * has_rate + (1.0 - has_rate)
    rows: tuple[Array, ...] = (jnp.arange(nodes.size, dtype=np.int32), nodes, couplings)

    def plain(row: tuple[Array, ...], stages: Array) -> Vector:
        _, node, coupling, *_ = row
        return multiples * rates(begin + node * share, vector + coupling @ stages)

    increment = plain
    if tableau.is_implicit:
        slope, solved = _linearised(tableau.diagonal, rates, begin + _LATER, vector, multiples, sizes)
        rows = (*rows, jnp.asarray(square(tableau.implicit_couplings)), jnp.asarray(tableau.slopes))

        def increment(row: tuple[Array, ...], stages: Array) -> Vector:
            coupling, multiple = row[3:]
            added = has_rate * (coupling @ stages) + multiple * share * slope
            return solved(tableau.diagonal * (plain(row, stages) + added))

    def stage(stages: Array, row: tuple[Array, ...]) -> tuple[Array, None]:
        return jax.lax.dynamic_update_index_in_dim(stages, increment(row, stages), row[0], 0), None

    stages, _ = jax.lax.scan(stage, jnp.outer(jnp.zeros(nodes.size), vector), rows)
    return vector + jnp.asarray(tableau.weights) @ stages, jnp.asarray(tableau.errors) @ stages


def _linearised(
    diagonal: float, rates: Rates, begin: Any, vector: Vector, multiples: Vector, sizes: Sizes
) -> tuple[Vector, Callable[[Vector], Vector]]:
    """The change of the rates with time, and what solves the linear equations of a stage.

    Integrals follow from the unknowns: one derivative along these takes the place of their rows of the matrix, which
    may be full.
    """
    count = sizes.unknowns

    def of_unknowns(share: Array, unknowns: Float[Array, " unknowns"]) -> Vector:
        return rates(share, jnp.concatenate([unknowns, vector[count:]]))

    pattern = dependence(lambda *at: of_unknowns(*at)[:count], [begin], [vector[:count]]).first
    sparsity = Sparsity.of(pattern)
    _, along = jax.linearize(of_unknowns, begin, vector[:count])
    slope = multiples * along(jnp.ones(()), jnp.zeros(count))
    images = jax.vmap(lambda seed: (multiples * along(jnp.zeros(()), seed))[:count])(jnp.asarray(sparsity.seeds))
    matrix = sparsity.diagonal(sizes.has_rate[:count]) - diagonal * sparsity.entries(images)
    solve = sparsity.solver(matrix)

    def solved(right: Vector) -> Vector:
        unknowns = solve(right[:count])
        if not sizes.integrals:
            return unknowns
        added = diagonal * multiples * along(jnp.zeros(()), unknowns)
        return jnp.concatenate([unknowns, (right + added)[count:]])

    return slope, solved


@final
class Tsit5(AbstractAdaptive):
    """Adaptive explicit Runge-Kutta of order 5 (Tsitouras, 2011), for smooth, non-stiff systems."""

    tableau: ClassVar[Tableau] = TSITOURAS_5


@final
class Rodas5P(AbstractAdaptive):
    """Adaptive and linearly implicit, of order 5, for stiff systems: a Rosenbrock method (Steinebach, 2023).

    A stage solves linear equations with one Jacobian for each step: no Newton iteration.
    """

    tableau: ClassVar[Tableau] = RODAS_5P
