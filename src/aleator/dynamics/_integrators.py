"""Integrators: their abstract base, and fixed-step Runge-Kutta methods for optimisation.

Integrals over time are additional states whose rates are the integrands, so that they are as accurate as the states and
evaluated at the same instants.
"""

import abc
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from typing_extensions import override

from aleator._core.arrays import Pytree
from aleator._core.compilation import Use, evaluate
from aleator._core.equations import as_time
from aleator._core.leaves import Module
from aleator.dynamics._crossings import Course, course
from aleator.dynamics._equations import TracedSystem, moving
from aleator.dynamics._evaluation import completed, derivative, explain_algebraic, initial_state
from aleator.dynamics._explained import explain_course
from aleator.dynamics._grid import Grid, Inputs
from aleator.dynamics._record import ONLY_STATES, STATES, Asked, Record, nothing, zeros
from aleator.dynamics._steps import Pace, Rates, Sizes, Step, Steps, Vector, is_divided, needed, steps_of, watched
from aleator.dynamics._system import System
from aleator.dynamics._tableaux import DORMAND_PRINCE_5, RUNGE_KUTTA_4, Tableau, square

# Systems of more equations take longer to compile for each stage than a loop over the stages takes to run.
_LARGE = 500
# Whether each pass over a grid that ends at an event ends by its last step: the first one seeks it in all steps of
# the longest grid; the second one tells its time as accurately as the last one, whose steps are as long.
_PASSES = (False, True, True)


class AbstractIntegrator(Module):
    """How a system's states are advanced from one instant of a grid to the next: a `Method`, whose steps end at
    events.
    """

    @abc.abstractmethod
    def step(self, rates: Rates, begin: Any, share: Any, vector: Vector, sizes: Sizes, pace: Pace | None) -> Step:
        """See `Method`."""

    @property
    def carries_algebraic(self) -> bool:
        """Whether algebraic variables are among its unknowns: others find them wherever they see states."""
        return False

    def begun(self, grid: Grid) -> Pace | None:
        """The pace at first; None where steps are those of the grid."""
        del grid
        return None

    @abc.abstractmethod
    def reference(self) -> "AbstractIntegrator":
        """A more accurate integrator of another order, by which this one's error is estimated; one of smaller
        tolerances, if it has any.
        """

    def record(self, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> Record:
        """Simulate a realised system and record what is asked for; `inputs` include the system's own signals."""
        names = watched(system, grid, asked.events)
        return on_grid(grid, asked, lambda grid, asked: course(self, system, grid, inputs, asked, names)[:2])

    def ending(self, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> Record:
        """The record of a grid that ends at an event in each realisation, with its grid."""
        names = needed(system, grid, asked.events)

        def passed(t_final: Array, is_final: Array) -> tuple[Array, Record]:
            """The record up to about this time, and the time of the event, which is sought along the way at first."""
            record = on_grid(
                grid.ending(t_final),
                asked,
                lambda grid, asked: course(self, system, grid, inputs, asked, names, is_final)[:2],
            )
            return record.grid.t_final, record._replace(grid=None)

        zero, _ = nothing(moving(system), inputs, grid)
        t_final, records = jax.lax.scan(passed, grid.t_final + zero, jnp.asarray(_PASSES))
        last = jax.tree.map(lambda one: one[len(_PASSES) - 1], records)
        return last._replace(grid=grid.ending(t_final))

    def explain(self, system: System, grid: Grid, inputs: Inputs, events: frozenset[str] = frozenset()) -> str:
        """Why it fails on one realised system, with the remedy; empty if it does not fail, or cannot tell.

        - `events`: those without which nothing is known of the system.
        """
        given_up = partial(self.explain_given_up, system, grid, inputs)
        why = explain_course(self, system, grid, inputs, events, given_up)
        if why or not system.algebraic:
            return why
        rows = evaluate(lambda: self.record(system, grid, inputs, ONLY_STATES).history[STATES], use=Use.ONCE)
        return explain_algebraic(system, grid, inputs, np.asarray(rows))

    def explain_given_up(self, system: System, grid: Grid, inputs: Inputs, one: Course, t: float) -> str:
        """Why it came no further than this time, s; empty where steps are those of the grid."""
        del system, grid, inputs, one, t
        return ""

    def nodes(self, *, middles: bool) -> tuple[float, ...]:
        """The fractions of each step of a grid at which it sees signals; none if it chooses the times itself.

        - `middles`: whether outputs are recorded at the middles too.
        """
        del middles
        return ()

    def refined(self) -> "AbstractIntegrator":
        """The same integrator with smaller tolerances, if it has any: most follow the steps of the grid."""
        return self


class AbstractFixedStep(AbstractIntegrator):
    """An explicit Runge-Kutta method that takes one step between two instants.

    Its steps do not depend on the numbers, so derivatives of the result are exact and free of noise.
    """

    tableau: ClassVar[Tableau]

    @override
    def nodes(self, *, middles: bool) -> tuple[float, ...]:
        return tuple(sorted({0.0, 1.0, *self.tableau.nodes, *([0.5] if middles else [])}))

    @override
    def step(self, rates: Rates, begin: Any, share: Any, vector: Vector, sizes: Sizes, pace: Pace | None) -> Step:
        # The last stage is at the end, so that rates are compiled once.
        couplings = jnp.asarray(square((*self.tableau.couplings, self.tableau.weights)))
        rows = jnp.asarray([*self.tableau.nodes, 1.0]), couplings, jnp.eye(len(couplings))

        def stage(stages: Array, row: tuple[Array, Array, Array]) -> tuple[Array, None]:
            node, coupling, unit = row
            slope = rates(begin + node * share, vector + share * (coupling @ stages))
            return stages + jnp.outer(unit, slope), None

        stages, _ = jax.lax.scan(stage, jnp.outer(jnp.zeros(len(couplings)), vector), rows)
        return Step(vector + share * (couplings[-1] @ stages), stages[:: len(stages) - 1])

    @override
    def record(self, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> Record:
        if watched(system, grid, asked.events):
            return super().record(system, grid, inputs, asked)
        if not is_divided(grid, inputs):
            return self._taken(system, grid, inputs, asked)[0]
        # A step that a jump divides has its middle anywhere.
        return on_grid(grid, asked, lambda grid, asked: self._taken(system, grid, inputs, asked))

    def _taken(self, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> tuple[Record, Any]:
        """The record of all steps, divided by jumps, and where the instants are among their beginnings."""
        nodes, couplings, weights, *_ = self.tableau
        inner = self.nodes(middles=bool(asked.nodes))[1:-1]
        steps, places = steps_of(grid, inputs, inner)
        t_start, now = steps.t[0], {name: values[places[0]] for name, values in steps.first.items()}
        start = initial_state(system, t_start, now)
        is_large = isinstance(system, TracedSystem) and system.equations["instant"].size > _LARGE

        # Traced once for all stages.
        @jax.jit
        def rates(t: Array, z: Pytree, u: dict[str, Array]) -> tuple[Pytree, tuple[Array, ...]]:
            return asked.slopes(system, t, completed(system, t, z, u), u)

        def advance(carried: tuple[Pytree, ...], step: Steps) -> tuple[tuple[Pytree, ...], tuple[Any, ...]]:
            (z, integrals, folded), (t, h, first, middle, last, *_) = carried, step
            signals = {0.0: first, 1.0: last, **dict(zip(inner, middle, strict=True))}
            # The first stage and the outputs are at one time and follow from the same equations.
            slope, growth, outputs = asked.everything(system, as_time(t), completed(system, t, z, first), first)
            stages = [(slope, growth)]
            if is_large:
                stages = _stages_in_loop(self.tableau, rates, t, h, z, signals, stages[0])
            else:
                for node, coupling in zip(nodes[1:], couplings[1:], strict=True):
                    at = _moved(z, h, coupling, [slopes for slopes, _ in stages])
                    stages.append(rates(as_time(t + node * h), at, signals[node]))
            end, grown = _moved((z, integrals), h, weights, stages)
            # After the end comes a step of no length, whose rates need not be numbers.
            grown = jax.tree.map(lambda one, more: jnp.where(h == 0, one, more), integrals, grown)
            # Outputs are taken inside the loop, so that states need not be stored.
            folded, outputs = asked.folded(folded, outputs)
            halfway = {}
            if asked.nodes:
                arrived = derivative(system, t + h, end, last)
                # Cubic Hermite interpolation between both ends, as accurate as these are.
                centre = jax.tree.map(lambda a, b, da, db: (a + b) / 2 + h / 8 * (da - db), z, end, slope, arrived)
                halfway = asked.at_node(system, t + h / 2, centre, signals[0.5])
            return (end, grown, folded), (outputs, halfway)

        _, growth, outputs = jax.eval_shape(
            lambda: asked.everything(system, t_start, completed(system, t_start, start, now), now)
        )
        carried = start, zeros(growth), asked.unfolded(outputs)
        (_, integrals, folded), (history, middles) = jax.lax.scan(advance, carried, steps)
        middles = {name: _interleaved(history[name], inside) for name, inside in middles.items()}
        return Record(history, middles, integrals, folded and folded[1]), places


def on_grid(grid: Grid, asked: Asked, along: Callable[[Grid, Asked], tuple[Record, Any]]) -> Record:
    """What is asked for, from a record of steps that do not tell their middles: these are instants of a finer grid.

    - `along`: the record of all steps of a grid, and where its instants are among their beginnings.
    """
    parts = 2 if asked.nodes else 1
    every = asked._replace(instants=asked.instants and asked.instants | asked.nodes, nodes=frozenset(), fold=None)
    record, places = along(grid.finer(parts), every)
    is_divided = any(len(values) > len(places) for values in record.history.values())
    nodes = {name: values[places] if is_divided else values for name, values in record.history.items()}
    history = {name: values[::parts] for name, values in nodes.items()}
    if asked.fold is None:
        return record._replace(history=history, nodes={name: nodes[name] for name in asked.nodes})
    folded, history = jax.lax.scan(asked.folded, asked.unfolded({n: v[0] for n, v in history.items()}), history)
    return record._replace(history=history, nodes={}, folded=folded and folded[1])


def _stages_in_loop(
    tableau: Tableau,
    rates: Callable[..., Pytree],
    t: Array,
    h: Array,
    z: Pytree,
    signals: Mapping[float, dict[str, Array]],
    first: Pytree,
) -> list[Pytree]:
    """All stages, by one copy of the rates for those after the first."""
    count, nodes = len(tableau.nodes), tableau.nodes[1:]
    told = jax.tree.map(lambda *each: jnp.stack(each), *(signals[node] for node in nodes))
    rows = jnp.arange(1, count), jnp.asarray(nodes), jnp.asarray(square(tableau.couplings)[1:]), told

    def stage(stages: Pytree, row: tuple[Any, ...]) -> tuple[Pytree, None]:
        index, node, coupling, u = row
        at = jax.tree.map(lambda x, slopes: x + h * jnp.tensordot(coupling, slopes, 1), z, stages[0])
        own = rates(as_time(t + node * h), at, u)
        return jax.tree.map(lambda x, one: jax.lax.dynamic_update_index_in_dim(x, one, index, 0), stages, own), None

    begun = jax.tree.map(lambda one: jnp.zeros((count, *one.shape)).at[0].set(one), first)
    stages, _ = jax.lax.scan(stage, begun, rows)
    return [jax.tree.map(lambda one, i=i: one[i], stages) for i in range(count)]


def _moved(z: Pytree, h: Any, weights: tuple[float, ...], slopes: list[Pytree]) -> Pytree:
    """`z + h * sum of weight * slope`."""
    used = [(weight, slope) for weight, slope in zip(weights, slopes, strict=True) if weight != 0]
    if not used:
        return z
    return jax.tree.map(
        lambda x, *rates: x + h * sum(weight * rate for (weight, _), rate in zip(used, rates, strict=True)),
        z,
        *(slope for _, slope in used),
    )


def _interleaved(ends: Array, inside: Array) -> Array:
    """Values at the instants and at the midpoints of the steps, in order of time."""
    return jnp.stack([ends, inside], axis=1).reshape(2 * len(inside), *inside.shape[1:])[:-1]


@final
class RungeKutta4(AbstractFixedStep):
    """The classical Runge-Kutta method of order 4, the default."""

    tableau: ClassVar[Tableau] = RUNGE_KUTTA_4

    @override
    def reference(self) -> AbstractIntegrator:
        return DormandPrince5()


@final
class DormandPrince5(AbstractFixedStep):
    """The method of order 5 by Dormand and Prince (1980), with fixed steps.

    Its stages lie at other fractions of a step than those of `RungeKutta4`, so it sees what these miss.
    """

    tableau: ClassVar[Tableau] = DORMAND_PRINCE_5

    @override
    def reference(self) -> AbstractIntegrator:
        return RungeKutta4()
