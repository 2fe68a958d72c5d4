"""Adaptive integrators, for stiff and long simulations: a step of the grid is divided as its errors require."""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from aleator._core import border
from aleator._core.compilation import Use, evaluate
from aleator._core.dependence import dependence
from aleator._core.equations import as_time
from aleator.dynamics._closing import met_about
from aleator.dynamics._evaluation import (
    algebraic_residuals,
    completed,
    explain_from,
    guessed_algebraic,
    initial_state,
    variables_of,
)
from aleator.dynamics._explained import explain_end
from aleator.dynamics._grid import Grid, Inputs, inputs_on
from aleator.dynamics._integrators import AbstractIntegrator, on_grid
from aleator.dynamics._record import Asked, Record, zeros
from aleator.dynamics._sparse import Sparsity
from aleator.dynamics._steps import Steps, signals_within, steps_of
from aleator.dynamics._system import System, state_type
from aleator.dynamics._tableaux import RODAS_5P, TSITOURAS_5, Tableau, square

_RELATIVE, _ABSOLUTE, _STEPS = 1e-8, 1e-10, 100_000

# Smaller tolerances cannot be met in 64-bit arithmetic.
_TIGHTEST_RELATIVE, _TIGHTEST_ABSOLUTE = 1e-12, 1e-14

# The next step follows from the error of this one, with a margin, and is shorter where this one gave no number.
_MARGIN, _LEAST_CHANGE, _MOST_CHANGE, _AFTER_NO_NUMBER = 0.9, 0.2, 10.0, 0.1

# The shortest step, relative to the time.
_SHORTEST = 4 * float(np.finfo(float).eps)

# If the last step is so many times shorter than the mean of all, more steps are no remedy.
_HOPELESS = 1000

# Signals have corners at instants, up to rounding: their slopes are those this fraction of a grid's step later.
_LATER = 1e-9

Vector = Float[Array, " n"]
Rates = Callable[[Any, Vector], Vector]
"""The rates of a vector at a share of a step of the grid."""


class _State(NamedTuple):
    """How far the integration of one step of the grid is.

    - `share`: of the step; `vector`: all that is integrated, and the algebraic variables of implicit methods; `h`: the
      length to try next, s; `left`: how many more steps may be tried in all.
    """

    share: Float[Array, ""]
    vector: Vector
    h: Float[Array, ""]
    left: Int[Array, ""]


class _Sizes(NamedTuple):
    """How many of the numbers of a vector are states, algebraic variables and integrals, in this order."""

    states: int
    algebraic: int
    integrals: int

    @property
    def unknowns(self) -> int:
        """Those that rates depend on."""
        return self.states + self.algebraic

    @property
    def has_rate(self) -> Float[np.ndarray, " n"]:
        """1 for those with a rate, 0 for algebraic variables."""
        return np.repeat([1.0, 0.0, 1.0], self)


class _Course(NamedTuple):
    """The integration of all steps of a grid.

    - `shares`: how much of each was reached; `end`: where it ended; `places`: of the instants among the steps' ends.
    """

    record: Record
    steps: Steps
    shares: Float[Array, " steps"]
    end: _State
    places: Int[Any, " instants"]


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

    @override
    def record(self, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> Record:
        def along(fine: Grid, asked: Asked) -> tuple[Record, Any]:
            course = self._course(system, fine, inputs, asked)
            is_complete = jnp.all(course.shares == 1.0)
            return jax.tree.map(lambda one: jnp.where(is_complete, one, jnp.nan), course.record), course.places

        return on_grid(grid, asked, along)

    def _course(self, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> _Course:
        steps, places = steps_of(grid, inputs, [])
        t, now, count = (
            steps.t[0],
            {name: values[places[0]] for name, values in steps.first.items()},
            len(system.states),
        )
        start = initial_state(system, t, now)
        # Implicit methods carry algebraic variables along; explicit ones find them wherever they see states.
        carries_algebraic = system.algebraic and self.tableau.is_implicit
        guess = guessed_algebraic(system, t, start, now) if carries_algebraic else ()
        integrands = jax.eval_shape(lambda: asked.rates(system, t, start, now))
        vector, named = ravel_pytree(((*start, *guess), zeros(integrands)))
        states, algebraic = (sum(map(jnp.size, part)) for part in (start, guess))
        sizes = _Sizes(states, algebraic, vector.size - states - algebraic)

        def advance(state: _State, step: Steps) -> tuple[_State, tuple[Any, ...]]:
            signals = signals_within(grid, inputs, step)

            def rates(share: Any, vector: Vector) -> Vector:
                t, (numbers, _), u = as_time(step.t + share * step.h), named(vector), signals(share)
                z = completed(system, t, variables_of(system, numbers), u)
                slopes, growths = asked.slopes(system, t, z, u)
                residuals = algebraic_residuals(system, t, z, u) if carries_algebraic else ()
                return ravel_pytree((slopes, residuals, growths))[0]

            numbers, integrals = named(state.vector)
            z = state_type(system.states)(*numbers[:count])
            if carries_algebraic:
                # They jump with the inputs: the step begins with those on its own side.
                z = completed(system, step.t, z, step.first, state_type(system.algebraic)(*numbers[count:]))
            outputs = asked.at_instant(system, step.t, z, step.first)
            begin = state._replace(share=jnp.zeros(()), vector=ravel_pytree(((*z,), integrals))[0])
            end = self._within(rates, begin, step, sizes)
            return end, (outputs, end.share)

        # The first step is the grid's, if its error is small.
        begin = _State(jnp.zeros(()), vector, stop_gradient(jnp.asarray(grid.step)), jnp.asarray(self.max_steps))
        end, (history, shares) = jax.lax.scan(advance, begin, steps)
        return _Course(Record(history, {}, named(end.vector)[1]), steps, shares, end, places)

    def _within(self, rates: Rates, begin: _State, step: Steps, sizes: _Sizes) -> _State:
        """The integration of one step of the grid, as far as it goes."""
        length = stop_gradient(step.h)
        shortest = _SHORTEST * stop_gradient(jnp.maximum(jnp.abs(step.t), jnp.abs(step.t + step.h)))

        def is_on_the_way(state: _State) -> Bool[Array, ""]:
            return (state.share < 1) & (state.left > 0) & (state.h > shortest)

        def attempt(state: _State) -> _State:
            rest = 1 - state.share
            parts = jnp.maximum(jnp.ceil(rest * length / state.h), 1.0)
            share = rest / parts
            vector, difference = _step(self.tableau, rates, state.share, share, state.vector, step.h, sizes)
            size = jnp.maximum(jnp.abs(state.vector), jnp.abs(vector))
            error = stop_gradient(jnp.max(jnp.abs(difference) / (self.atol + self.rtol * size)))
            change = _MARGIN * error ** (-1 / self.tableau.order)
            change = jnp.where(error >= 0, jnp.clip(change, _LEAST_CHANGE, _MOST_CHANGE), _AFTER_NO_NUMBER)
            reached, is_close = jnp.where(parts == 1, 1.0, state.share + share), error <= 1
            return _State(
                # No time, between two jumps at once or after the end, passes whatever the rates, and tells nothing.
                jnp.where(is_close | (length == 0), reached, state.share),
                jnp.where(is_close, vector, state.vector),
                jnp.where(length > 0, share * length * change, state.h),
                state.left - 1,
            )

        return jax.lax.while_loop(is_on_the_way, attempt, begin)

    @override
    def explain(self, system: System, grid: Grid, inputs: Inputs, events: frozenset[str] = frozenset()) -> str:
        _, steps, shares, end, _ = evaluate(
            lambda: self._course(system, grid, inputs, Asked(frozenset())), use=Use.ONCE
        )
        if np.all(np.asarray(shares) == 1.0):
            why = super().explain(system, grid, inputs, events)
            if why or grid.until is None:
                return why
            about = evaluate(lambda: met_about(self.record, system, grid, inputs), use=Use.ONCE)
            return explain_end(system, grid, float(about))
        name, now = type(self).__name__, inputs_on(grid, inputs)
        reached, last = float(grid.t_start + np.asarray(shares) @ np.asarray(steps.h)), float(grid.t_final)
        states, named = ravel_pytree(initial_state(system, grid.times[0], now(grid.times[0])))
        arrived = named(end.vector[: states.size])
        if system.algebraic and (failure := explain_from(system, reached, arrived, float(grid.step), now)):
            return failure
        if self.rtol < _TIGHTEST_RELATIVE:
            return (
                f"{name} stops at t = {reached:.4g} s, where rounding is larger than its tolerances: give it "
                f"rtol={_TIGHTEST_RELATIVE:g} or more."
            )
        if int(end.left) == 0 and _HOPELESS * self.max_steps * float(end.h) > reached - float(grid.t_start):
            stiff = "" if self.tableau.is_implicit else "; or take al.integrators.Rodas5P(), if the system is stiff"
            return (
                f"{name} used up its {self.max_steps} steps at t = {reached:.4g} s of {last:.4g} s. "
                f"Give it more, al.integrators.{name}(max_steps={10 * self.max_steps}), or larger tolerances{stiff}."
            )
        return (
            f"{name} stops at t = {reached:.4g} s, where its steps become too short. Check for rates that jump, grow "
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
    tableau: Tableau, rates: Rates, begin: Any, share: Any, vector: Vector, length: Any, sizes: _Sizes
) -> tuple[Vector, Vector]:
    """The end of one step and its estimated error; NaN where a stage has no number.

    - `rates`: of the vector at a share of a step of the grid, of some length; zero at a solution where numbers have
      none;
    - `begin`, `share`: where the step begins, and how long it is, as shares of the grid's step.
    """
    couplings, nodes = jnp.asarray(square(tableau.couplings)), jnp.asarray(tableau.nodes)
    # Equations without rates are not multiplied by the length of the step, so that they hold over no time too.
    has_rate = sizes.has_rate
    multiples = share * length * has_rate + (1.0 - has_rate)
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

    stages, _ = jax.lax.scan(stage, jnp.zeros((nodes.size, vector.size)), rows)
    return vector + jnp.asarray(tableau.weights) @ stages, jnp.asarray(tableau.errors) @ stages


def _linearised(
    diagonal: float, rates: Rates, begin: Any, vector: Vector, multiples: Vector, sizes: _Sizes
) -> tuple[Vector, Callable[[Vector], Vector]]:
    """The change of the rates with time, and what solves the linear equations of a stage.

    Integrals follow from the unknowns: one derivative along these takes the place of their rows of the matrix, which
    may be full.
    """
    count = sizes.unknowns

    def of_unknowns(share: Array, unknowns: Vector) -> Vector:
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
